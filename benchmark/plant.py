# SPDX-License-Identifier: Apache-2.0
"""The arm of the benchmarks: MuJoCo's reading of the URDF, which keeps the last torque."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import mujoco
import numpy as np

from benchmark.false_states import PERIOD, N
from benchmark.nodes import JOINTS
from hardware_sim import scene
from hardware_sim.demonstrator import Demonstrator
from hardware_sim.hidden_arm import HiddenArm
from hardware_sim.scenes.flip import wrist_flick
from wam_power_ros.params.resources import share

SUBSTEPS, DELAY = 2, 2  # physics steps, periods until a torque acts
TOOL = "pan"
FILTER = 180.0  # [rad/s] of the reported speeds, as of libbarrett
RESOLUTION = 1e-5  # [rad] of the encoders
HOME = np.array([0.0, 0.349, 0.0, 2.129, 0.0, -0.471, 0.0])  # [rad]
NOMINAL = HiddenArm()


def drawn(seed: int) -> HiddenArm:
    """Deviations of a laboratory's first day."""
    rng = np.random.default_rng([seed, 0x5AFE])
    return HiddenArm(
        payload=0.6 * rng.uniform(-0.2, 0.2),
        motors=rng.uniform(0.95, 1.05, N),
        friction=2.0 ** rng.uniform(-1.0, 1.0, N),
        links=rng.uniform(0.95, 1.05, N),
        zeros=np.deg2rad(rng.uniform(1.0, 3.0, N)) * rng.choice([-1.0, 1.0], N),
    )


ARMS = {
    "model": NOMINAL,
    "+0.5 kg": HiddenArm(payload=0.5),
    "-0.5 kg": HiddenArm(payload=-0.5),
    "motor 2 at 70 %": HiddenArm(motors=np.array([1.0, 0.7] + [1.0] * 5)),
    "friction halved": HiddenArm(friction=0.5),
    **{f"drawn {k}": drawn(k) for k in range(6)},
}


class Plant:
    """An arm, which may differ from its model, with zero velocity at a posture that it reports.

    Attributes:
        model: MuJoCo's model; may be changed while it runs.
        motors: True torque over commanded one. Shape (n,).
        hand: Force [N] and moment [N m] (6,) on the tool's centre of mass, by time [s] and position
            of the tool [m]; None: no hand.
        seconds: Time since the beginning [s].
        driver: Share of g(q) that the driver adds.
    """

    def __init__(self, hidden: HiddenArm = NOMINAL, q: np.ndarray = HOME) -> None:
        spec = scene.arm(share("urdf/wam7.urdf").read_text())
        links, friction, self.motors = (
            np.ones(N) * share for share in (hidden.links, hidden.friction, hidden.motors)
        )
        for row, name in enumerate(JOINTS):
            spec.joint(name).frictionloss *= friction[row]
            spec.joint(name).parent.mass *= links[row]
        spec.option.gravity = hidden.gravity
        spec.option.timestep = PERIOD / SUBSTEPS
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.tool = self.model.body(TOOL).id
        self.model.body_mass[self.tool] += hidden.payload
        self.hand: Callable[[float, np.ndarray], np.ndarray | None] | None = None
        self.seconds = 0.0
        self.driver = 0.0
        self._zeros = hidden.zeros
        self._acting = deque([np.zeros(N)] * DELAY)
        self.place(q)

    def place(self, q: np.ndarray) -> None:
        """Put the resting arm to a reported posture, carried by what holds it."""
        self.data.qpos[:], self.data.qvel[:] = q - self._zeros, 0.0
        mujoco.mj_forward(self.model, self.data)
        self._acting = deque([self.data.qfrc_bias / self.motors] * DELAY)
        self._reported = self._read()
        self._speed = np.zeros(N)

    def _read(self) -> np.ndarray:
        q = self.data.qpos + self._zeros
        return np.round(q / RESOLUTION) * RESOLUTION

    def step(self, tau: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Let a torque act, two periods later, for a period; returns reported q and qd."""
        if tau is not None:
            self._acting.append(np.array(tau))
            self._acting.popleft()
        data, hand = self.data, self.hand
        wrench = np.zeros(6) if hand is None else hand(self.seconds, self.tool_position())
        for _ in range(SUBSTEPS):
            data.qfrc_applied[:] = self.motors * self._acting[0] + self.driver * data.qfrc_bias
            data.xfrc_applied[self.tool] = wrench
            mujoco.mj_step(self.model, data)
        q, before = self._read(), self._reported
        keep = np.exp(-FILTER * PERIOD)
        self._speed = keep * self._speed + (1.0 - keep) * (q - before) / PERIOD
        self._speed[np.abs(self._speed) < 1e-4] = 0.0
        self._reported = q
        self.seconds += PERIOD
        return q.copy(), self._speed.copy()

    def guide(self, seed: int) -> None:
        """Let the stand-in's demonstrator, drawn from a seed, guide the tool through a toss."""
        begun, tool, data = self.seconds, self.tool, self.data
        flick = wrist_flick(np.random.default_rng(seed))
        person = Demonstrator(flick, self.tool_position(), data.xmat[tool].reshape(3, 3).copy())

        def hand(t: float, position: np.ndarray) -> np.ndarray:
            turn, twist = data.xmat[tool].reshape(3, 3), self._tool_twist()
            wrench = person.wrench(t - begun, position, turn, twist)
            if wrench is None:
                self.let_go()
                return np.zeros(6)
            wrench[3:] += np.cross(position - data.xipos[tool], wrench[:3])
            return wrench

        self.hand = hand

    def let_go(self) -> None:
        """Whoever guides or pushes the tool lets it go."""
        self.hand = None

    def gravity(self) -> np.ndarray:
        """Torque that carries the arm where it is at rest [N m]. Shape (7,)."""
        return self.data.qfrc_bias / self.motors

    def tool_position(self) -> np.ndarray:
        """Position of the tool [m]. Shape (3,)."""
        return self.data.xpos[self.tool].copy()

    def tool_speed(self) -> float:
        """Speed of the tool [m/s]."""
        return float(np.linalg.norm(self._tool_twist()[:3]))

    def _tool_twist(self) -> np.ndarray:
        """Velocity [m/s] and angular velocity [rad/s] of the tool. Shape (6,)."""
        velocity = np.zeros(6)
        frame = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self.model, self.data, frame, self.tool, velocity, 0)
        return np.roll(velocity, 3)
