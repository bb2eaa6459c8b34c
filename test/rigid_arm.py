# SPDX-License-Identifier: Apache-2.0
"""The controller against a rigid-body arm: semi-implicit Euler, 1 ms, no contact."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.control import replay_trajectory, safety
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.policy import Basis, Policy
from wam_power_ros.params.resources import share

URDF = share("urdf/wam7.urdf").read_text()
NAMES = [f"wam_j{i}" for i in range(1, 8)]
MODEL = Arm(URDF, NAMES)  # of the plant; each controller has its own
LIMITS = safety.limits_of(MODEL)
HOME = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])
PERIOD_NS = 2_000_000
A_TEST = Fault(FaultKind.SOFTWARE, "a test")
ENCODER = np.array([3.65, 2.72, 4.56, 8.52, 7.91, 7.91, 10.27]) * 1e-5  # [rad] a count


def make_policy(
    id: str = "trial-0001", q_start: np.ndarray = HOME, size: float = 1.0, pitch: float = 0.3
) -> Policy:
    """A dip, an upward throw with the pan's edge up, and back: 8 primitives in 0.8 s."""
    position, rotation = MODEL.tool_pose(q_start)
    shape = np.array([0.0, -0.3, -1.0, 0.6, 1.0, 0.4, 0.1, 0.0]) * size
    attractors = position + shape[:, None] * np.array([0.03, 0.02, 0.12])
    turning = np.zeros((8, 3))
    turning[:, 1] = -pitch * shape
    skew = np.array([[0.0, 40.0, 0.0], [-40.0, 0.0, 20.0], [0.0, -20.0, 0.0]])
    return Policy(
        id=id,
        basis=Basis(8, 0.8, 0.0025),
        stiffness=np.tile(np.diag([200.0, 300.0, 400.0]) + skew, (8, 1, 1)),
        attractors=attractors,
        damping=32.0,
        orientation_reference=rotations.quat_xyzw(rotation),
        rotation_attractors=turning,
        rotation_stiffness=400.0,
        rotation_damping=36.0,
        q_start=q_start,
    )


POLICY = make_policy()


@dataclass
class Plant:
    """An arm that obeys torques; with `sensing`, through encoders and a 180 rad/s velocity filter.

    `delay` counts periods between a state and the torque that answers it taking effect.
    """

    q: np.ndarray
    delay: int = 0
    sensing: bool = False
    friction: float = 0.0
    push: Callable[[float, np.ndarray, np.ndarray], np.ndarray] | None = None
    adds_gravity: bool = False

    def __post_init__(self) -> None:
        self.q, self.qd, self.stamp = self.q.copy(), np.zeros(7), 10**12
        carried = np.zeros(7) if self.adds_gravity else MODEL.gravity(self.q)
        self._pending = [carried] * self.delay
        self._filtered, self._last = np.zeros(7), self._read()

    def _read(self) -> np.ndarray:
        return np.round(self.q / ENCODER) * ENCODER if self.sensing else self.q.copy()

    def state(self) -> tuple[int, np.ndarray, np.ndarray]:
        """Stamp, q, qd as the driver would publish them."""
        q = self._read()
        if not self.sensing:
            return self.stamp, q, self.qd.copy()
        share = 1.0 - math.exp(-180.0 * 0.002)
        self._filtered = self._filtered + share * ((q - self._last) / 0.002 - self._filtered)
        self._last = q
        return self.stamp, q, self._filtered.copy()

    def step(self, tau: np.ndarray) -> None:
        """One period under a torque."""
        self._pending.append(tau)
        tau = self._pending.pop(0)
        for _ in range(2):
            total = tau - self.friction * (
                MODEL.friction * np.tanh(self.qd / 0.01) + MODEL.damping * self.qd
            )
            if self.adds_gravity:
                total = total + MODEL.gravity(self.q)
            if self.push is not None:
                total = total + self.push((self.stamp - 10**12) * 1e-9, self.q, self.qd)
            qdd = MODEL.resisted_dynamics(self.q, self.qd, total, np.zeros(7), 0.0)
            self.qd = self.qd + 0.001 * qdd
            self.q = self.q + 0.001 * self.qd
        self.stamp += PERIOD_NS


def make(
    policy: Policy | None = POLICY, contact_share: float = 0.05, **choices: object
) -> Controller:
    """A controller with a policy; a contact share above 0.5, which no user may set, is no check."""
    settings = ControllerSettings(**choices).model_copy(update={"contact_share": contact_share})
    controller = Controller(Arm(URDF, NAMES), settings)
    if policy is not None:
        controller.load(policy)
    return controller


def begin(q: np.ndarray = HOME, controller: Controller | None = None, **plant: object) -> tuple:
    """A controller that has held for 0.2 s, and its plant."""
    controller, plant = controller or make(), Plant(q, **plant)
    controller.step(*plant.state())
    controller.hold()
    run(controller, plant, 0.2)
    return controller, plant


def executing(seconds: float, controller: Controller | None = None, **plant: object) -> tuple:
    """A controller that has executed its policy for a time, its plant, and the last torque."""
    controller, plant = begin(controller=controller, **plant)
    controller.execute()
    return controller, plant, run(controller, plant, seconds)[-1]


def refusal_of(request: Callable[[], object]) -> Refusal:
    """Code with which a request is refused."""
    with pytest.raises(ControllerError) as refused:
        request()
    return refused.value.refusal


def start_replay(controller: Controller, t: np.ndarray, q: np.ndarray, speed: float = 1.0) -> None:
    period, limits = controller.settings.period, controller.limits
    controller.start_replay(replay_trajectory.sampled(t / speed, q, period, limits))


def speed(plant: Plant) -> float:
    """Highest speed of tool and guarded points [m/s]."""
    guarded, tool_speed = MODEL.speeds(plant.q, plant.qd)
    return max(*guarded, tool_speed)


def run(
    controller: Controller,
    plant: Plant,
    seconds: float,
    until: Callable[[], bool] | None = None,
    elapsed: float | None = None,
) -> list[np.ndarray]:
    """Close the loop; every torque is checked. Returns the torques.

    `elapsed` is the time between two states by the controller's own clock; None for lockstep.
    """
    torques = []
    for _ in range(round(seconds / 0.002)):
        if until is not None and until():
            break
        tau = controller.step(*plant.state(), elapsed)
        check(tau, torques[-1] if torques else tau)
        torques.append(tau)
        plant.step(tau)
    return torques


def check(tau: np.ndarray, previous: np.ndarray, dt: float = 0.002) -> None:
    assert np.isfinite(tau).all()
    assert np.all(np.abs(tau) <= LIMITS.torque)
    assert np.all(np.abs(tau - previous) <= LIMITS.torque_rate * dt + 1e-9)


def tool(plant: Plant) -> np.ndarray:
    return MODEL.tool_pose(plant.q)[0]
