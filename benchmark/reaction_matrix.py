# SPDX-License-Identifier: Apache-2.0
"""What an arm does before and after a fault: false states, and true ones of an arm that changes.

    python -m benchmark.reaction_matrix [--modes hold ...] [--kinds ...] [--arms model ...] [--bad]
    python -m benchmark.reaction_matrix --cells 400 --seed 1     # draws some; 0: all

Controller and arm are in one process. The arm is a plant of this file's own: MuJoCo's reading of
the URDF, which keeps the last torque, and on which a torque acts after 4 ms. Each cell is a kind of
false state (or a change of the arm in true states), a joint, a mode and an arm. It is compared with
the same run without it, and with a fault of true states at the same moment.
"""

from __future__ import annotations

import itertools
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from typing import NamedTuple
from xml.etree import ElementTree

import joblib
import mujoco
import numpy as np

from benchmark.false_states import FALSIFIED, NO_JOINT, OF_JOINT, PERIOD, N
from benchmark.loop import A_FAULT, AFTER, Loop, Outcome
from benchmark.nodes import JOINTS
from benchmark.terminal import options, table_head, table_row
from hardware_sim.hidden_arm import HiddenArm
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_references import interpolated
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.safety import limits_of
from wam_power_ros.params.resources import share

SUBSTEPS, DELAY = 2, 2  # physics steps, periods until a torque acts
TOOL = "pan"
FILTER = 180.0  # [rad/s] of the reported speeds, as of libbarrett
RESOLUTION = 1e-5  # [rad] of the encoders
UNFOUND = 15.0  # [s] of observation without a fault
SPEED_MARGIN, WAY_MARGIN, WAY_BEFORE = 0.1, 0.02, 0.3  # [m/s], [m], [m]
HAND = 35.0  # [N] of a hand that presses and lets go at the fault
HOME = np.array([0.0, 0.349, 0.0, 2.129, 0.0, -0.471, 0.0])  # [rad]


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
    "model": HiddenArm(),
    "+0.5 kg": HiddenArm(payload=0.5),
    "-0.5 kg": HiddenArm(payload=-0.5),
    "motor 2 at 70 %": HiddenArm(motors=np.array([1.0, 0.7] + [1.0] * 5)),
    "friction halved": HiddenArm(friction=0.5),
    **{f"drawn {k}": drawn(k) for k in range(6)},
}


class Plant:
    """The arm: MuJoCo's own reading of the URDF.

    Attributes:
        model: MuJoCo's model; may be changed while it runs.
        motors: True torque over commanded one. Shape (n,).
        hand: Force on the tool [N] by time [s] and position of the tool [m]; None: no hand.
        seconds: Time since the beginning [s].
        driver: Share of g(q) that the driver adds.
    """

    def __init__(self, hidden: HiddenArm) -> None:
        tree = ElementTree.fromstring(share("urdf/wam7.urdf").read_text())
        compiler = ElementTree.SubElement(ElementTree.SubElement(tree, "mujoco"), "compiler")
        compiler.set("fusestatic", "false")
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(tree, encoding="unicode"))
        links, friction, motors = (
            np.ones(N) * share for share in (hidden.links, hidden.friction, hidden.motors)
        )
        for row, name in enumerate(JOINTS):
            joint, dynamics = spec.joint(name), tree.find(f"./joint[@name='{name}']/dynamics")
            joint.armature = float(dynamics.get("armature"))
            joint.frictionloss = float(dynamics.get("friction")) * friction[row]
            joint.solimp_friction = [0.99, 0.999, 0.001, 0.5, 2.0]
            joint.parent.mass *= links[row]
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0
            geom.mass = 0.0
        spec.option.timestep = PERIOD / SUBSTEPS
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.tool = self.model.body(TOOL).id
        self.model.body_mass[self.tool] += hidden.payload
        self.motors = motors
        self.hand: Callable[[float, np.ndarray], np.ndarray] | None = None
        self.seconds = 0.0
        self.driver = 0.0
        self._zeros = hidden.zeros
        self._acting = deque([np.zeros(N)] * DELAY)
        self.place(HOME)

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
        force = np.zeros(3) if hand is None else hand(self.seconds, self.tool_position())
        for _ in range(SUBSTEPS):
            data.qfrc_applied[:] = self.motors * self._acting[0] + self.driver * data.qfrc_bias
            data.xfrc_applied[self.tool, :3] = force
            mujoco.mj_step(self.model, data)
        q, before = self._read(), self._reported
        keep = np.exp(-FILTER * PERIOD)
        self._speed = keep * self._speed + (1.0 - keep) * (q - before) / PERIOD
        self._speed[np.abs(self._speed) < 1e-4] = 0.0
        self._reported = q
        self.seconds += PERIOD
        return q.copy(), self._speed.copy()

    def let_go(self) -> None:
        """See `loop.Plant`."""
        self.hand = None

    def tool_position(self) -> np.ndarray:
        """Position of the tool [m]. Shape (3,)."""
        return self.data.xpos[self.tool].copy()

    def tool_speed(self) -> float:
        """Speed of the tool [m/s]."""
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(
            self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, self.tool, velocity, 0
        )
        return float(np.linalg.norm(velocity[3:]))


def loop_of(arm: str) -> Loop:
    """An arm of `ARMS` with its controller."""
    model = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
    controller = Controller(model, ControllerSettings(limits=limits_of(model)))
    return Loop(Plant(ARMS[arm]), controller)


def _guide(plant: Plant) -> None:
    """A hand that moves the tool back and forth, 0.3 m/s at most."""
    begun, start = plant.seconds, plant.tool_position()
    last = [start]

    def hand(t: float, position: np.ndarray) -> np.ndarray:
        way = 0.12 * (1.0 - np.cos(2.5 * (t - begun)))
        velocity, last[0] = (position - last[0]) / PERIOD, position
        pull = 600.0 * (start + way * np.array([0.3, 0.5, 1.0]) - position) - 30.0 * velocity
        return pull * min(1.0, 80.0 / max(float(np.linalg.norm(pull)), 1e-9))

    plant.hand = hand


def _press(loop: Loop) -> None:
    """A hand that presses the tool down, rising within 0.3 s."""
    begun = loop.plant.seconds
    loop.plant.hand = lambda t, _: np.array([0.0, 0.0, -HAND]) * min((t - begun) / 0.3, 1.0)


def _waves(loop: Loop, rate: float, size: float) -> None:
    """Replay of a smooth movement of joints 2, 4 and 6."""
    t = np.arange(0.0, 14.0, 0.02)
    wave = size * np.sin(rate * t) * np.minimum(t / 1.0, 1.0) ** 2
    q = HOME + np.outer(wave, [0.3, 0.6, 0.2, 1.0, 0.3, 0.8, 0.3])
    loop.controller.start_replay(interpolated(t, q, PERIOD))


def hold(loop: Loop, q: np.ndarray) -> None:
    """Hold a posture."""
    loop.plant.place(q)
    loop.hold(0.7)


def begin(loop: Loop, mode: str) -> None:
    """Bring the arm to a mode."""
    core = loop.controller
    start = loop.policy.q_start
    if mode in ("move", "hold after move"):
        hold(loop, start + np.array([0.2, -0.2, 0.1, 0.3, 0.0, -0.3, 0.0]))
        core.move_to_start()
        loop.play(0.8)
        if mode != "move":
            loop.play(4.0, lambda: core.mode is Mode.HOLD)
            loop.play(0.3)
        return
    if mode.startswith("rollout"):
        hold(loop, start)
        core.move_to_start()
        loop.play(1.0)
        core.execute()
        loop.play({"rollout early": 0.1, "rollout late": 0.4}[mode] * loop.policy.basis.duration)
        return
    hold(loop, HOME)
    if mode == "fault":
        core.fault(A_FAULT)
    elif mode in ("untouched", "guided"):
        core.set_gravity_compensation(True)
        if mode == "guided":
            _guide(loop.plant)
    elif mode in ("replay", "sweep"):
        _waves(loop, *{"replay": (2.0, 0.3), "sweep": (0.6, 0.1)}[mode])
        loop.play(1.4)
    if mode != "hold":
        loop.play(1.0)


MODES = (
    *("hold", "move", "hold after move", "untouched", "guided", "replay", "sweep"),
    *("rollout early", "rollout late", "fault"),
)


def _loaded(loop: Loop, mass: float) -> None:
    loop.plant.model.body_mass[loop.plant.tool] += mass


def _weak(loop: Loop) -> None:
    loop.plant.motors[1] *= 0.7


def _pressed(loop: Loop) -> None:
    """A hand presses for 0.6 s; then, or when a fault is found before, it lets go at the fault."""
    _press(loop)
    loop.play(0.6, lambda: loop.controller.mode is Mode.FAULT)
    loop.controller.fault(A_FAULT)
    loop.plant.let_go()


CHANGES: dict[str, Callable[[Loop], None]] = {  # with true states
    "-0.55 kg": partial(_loaded, mass=-0.55),
    "+0.5 kg": partial(_loaded, mass=0.5),
    "+2 kg": partial(_loaded, mass=2.0),
    "motor 2 to 70 %": _weak,
    "gravity twice": lambda loop: setattr(loop.plant, "driver", 1.0),
    "pressed, fault": _pressed,
    "pressed": _press,
    "fault": lambda loop: loop.controller.fault(A_FAULT),
}


class Cell(NamedTuple):
    """What is done to which arm in which mode; `joint` counts from 0, -1 for none."""

    kind: str
    joint: int
    mode: str
    arm: str


def good(found: Outcome) -> bool:
    """Whether no bound is exceeded."""
    if found.noticed is None:
        return found.peak <= found.nominal + 0.2 and found.before <= WAY_BEFORE
    return found.peak <= found.nominal + SPEED_MARGIN and found.way <= WAY_MARGIN


@cache
def nominal(mode: str, arm: str) -> tuple[np.ndarray, np.ndarray, str]:
    """Path (k, 3) [m] and speeds (k,) [m/s] of the tool in a mode; why it was not reached."""
    loop, why = loop_of(arm), ""
    try:
        begin(loop, mode)
    except ControllerError as error:
        why = str(error)
    if loop.controller.latched and mode != "fault":
        why = why or loop.controller.latched.text
    if not why:
        loop.play(UNFOUND)
    return np.array(loop.path[:-1]), np.array(loop.speeds[:-1]), why


def run(cell: Cell) -> Outcome:
    """Run one cell; its peak is that after the fault, if there is one."""
    nominal_path, nominal_speeds, why = nominal(cell.mode, cell.arm)
    if why:
        return Outcome(None, None, 0.0, 0.0, 0.0, 0.0, unreached=f"not reached: {why}")
    loop = loop_of(cell.arm)
    begin(loop, cell.mode)
    if cell.kind in OF_JOINT:
        loop.falsify = OF_JOINT[cell.kind](cell.joint)
    else:
        CHANGES[cell.kind](loop)

    def enough(at: int | None) -> bool:
        return (len(loop.path) - (at or 0)) * PERIOD >= (UNFOUND if at is None else AFTER)

    found = loop.observe(UNFOUND + AFTER, enough)
    at, path, speeds = found.noticed, np.array(loop.path), np.array(loop.speeds)
    shared = min(len(path) if at is None else at + 1, len(nominal_path))
    before = float(np.linalg.norm(path[:shared] - nominal_path[:shared], axis=1).max())
    if at is None:
        found = found._replace(fault=None, peak=float(speeds.max()), before=before)
        return found._replace(nominal=float(nominal_speeds.max()))
    stop = float(np.linalg.norm(path[at:] - path[at], axis=1).max())
    usual = float(nominal_speeds[: at + 1].max())
    if cell.kind in CHANGES:
        usual = max(usual, float(speeds[: at + 1].max()))
    way = max(0.0, stop - _true_stop(cell.mode, cell.arm, at))
    peak = float(speeds[at:].max())
    reset = loop.reset()
    return found._replace(peak=peak, nominal=usual, before=before, way=way, reset=reset)


@cache
def _true_stop(mode: str, arm: str, at: int) -> float:
    """Way of the tool after a fault of true states, so many periods into a mode [m]."""
    loop = loop_of(arm)
    begin(loop, mode)
    loop.play(at * PERIOD)
    loop.controller.fault(A_FAULT)
    loop.plant.let_go()
    loop.play(1.0)
    return float(np.linalg.norm(np.array(loop.path[:-1]) - loop.path[0], axis=1).max())


def cells(kinds: Sequence[str], modes: Sequence[str], arms: Sequence[str]) -> Iterator[Cell]:
    """All cells of these kinds, modes and arms."""
    for kind, mode, arm in itertools.product(kinds, modes, arms):
        if kind == "gravity twice" and mode != "hold":  # a set-up is wrong from the beginning
            continue
        if kind == "-0.55 kg" and arm == "-0.5 kg":  # the tool has 0.6 kg
            continue
        joints = FALSIFIED if kind in OF_JOINT and kind not in NO_JOINT else (-1,)
        for joint in joints:
            yield Cell(kind, joint, mode, arm)


def line(cell: Cell, found: Outcome) -> str:
    """Line of the table."""
    return table_row(
        cell.kind,
        f"joint {cell.joint + 1}" if cell.joint >= 0 else "",
        cell.mode,
        cell.arm,
        found.fault.value if found.fault else found.unreached or "none",
        "-" if found.noticed is None else f"{1e3 * PERIOD * found.noticed:.0f}",
        f"{100 * found.before:.1f}",
        f"{found.peak:.2f} ({found.nominal:.2f})",
        f"{100 * found.way:.1f}",
        "yes" if found.reset else "no",
        "" if good(found) else "**bad**",
    )


def main() -> int:
    """Print a row for each cell, then the worst; return 1 if a bound was exceeded."""
    given = options(
        __doc__,
        kinds=[*OF_JOINT, *CHANGES],
        modes=[*MODES],
        arms=[*ARMS],
        cells=0,
        seed=0,
        jobs=2,
        bad=False,
    )
    chosen = list(cells(given.kinds, given.modes, given.arms))
    if given.cells:
        rows = np.random.default_rng(given.seed).permutation(len(chosen))[: given.cells]
        chosen = [chosen[k] for k in sorted(rows)]
    titles = ("cause", "", "mode", "arm", "fault", "after [ms]", "before [cm]")
    print(table_head(*titles, "peak (nominal) [m/s]", "way after [cm]", "reset", ""))
    found = []
    runs = joblib.Parallel(n_jobs=given.jobs, return_as="generator")(
        joblib.delayed(run)(cell) for cell in chosen
    )
    for cell, outcome in zip(chosen, runs, strict=True):
        found.append(outcome)
        if not (given.bad and good(outcome)):
            print(line(cell, outcome), flush=True)
    bad = sum(not good(each) for each in found)
    over = [each.peak - each.nominal for each in found if each.noticed is not None]
    print(
        f"{len(found)} cells, {bad} beyond a bound; worst: {max(over, default=0.0):.2f} m/s above "
        f"nominal, {100 * max(each.way for each in found):.1f} cm after a fault, "
        f"{100 * max(each.before for each in found):.1f} cm before one"
    )
    return int(bad > 0)


if __name__ == "__main__":
    from benchmark import reaction_matrix  # workers can import this module, not "__main__"

    sys.exit(reaction_matrix.main())
