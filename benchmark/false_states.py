# SPDX-License-Identifier: Apache-2.0
"""A driver that publishes well-formed but false joint states.

The arm is simulated in this process in real time. It keeps the last torque indefinitely, as
ros2_control and libbarrett do, so only the controller can stop it.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import JointState

from benchmark.hidden_arm import NOMINAL, world
from benchmark.lab import TIMEOUT, Lab
from benchmark.nodes import JOINTS, PERIOD_NS
from benchmark.soak import taught
from hardware_sim.demonstrator import Demonstrator
from hardware_sim.hidden_arm import HiddenArm
from hardware_sim.scenes.flip import wrist_flick
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.safety import REST_SPEED
from wam_power_ros.ros import interface
from wam_power_ros.ros.joint_messages import JointStateWriter

SPEED_MARGIN = 0.5  # [m/s] allowed increase of the tool's peak speed by false states
REST_TICKS = 250  # [periods] from the fault to rest: 0.5 s
WATCH_TICKS = 600  # [periods] of observation after false states began


class Reading(NamedTuple):
    """One joint state."""

    stamp_ns: int
    q: np.ndarray
    qd: np.ndarray


Falsifier = Callable[[Reading], Reading | None]  # None: nothing is published


def frozen(*joints: int, still: bool = False) -> Falsifier:
    """Freeze position and velocity of joints.

    Args:
        joints: Indices of the joints; all joints if none is given.
        still: Set the velocity to zero instead of freezing it.
    """
    at, kept = list(joints) or list(range(7)), []

    def falsify(state: Reading) -> Reading:
        kept.append(state)
        q, qd = state.q.copy(), state.qd.copy()
        q[at], qd[at] = kept[0].q[at], 0.0 if still else kept[0].qd[at]
        return Reading(state.stamp_ns, q, qd)

    return falsify


def velocities(change: Callable[[np.ndarray], np.ndarray]) -> Falsifier:
    """Change the velocities."""
    return lambda state: state._replace(qd=change(state.qd))


def two_drivers() -> Falsifier:
    """Replace every other state by that of an arm 0.02 rad away."""
    count = [0]

    def falsify(state: Reading) -> Reading:
        count[0] += 1
        return state._replace(q=state.q + 0.02 * (count[0] % 2))

    return falsify


def stamps(rate: float) -> Falsifier:
    """Let stamps advance at another rate; at rate 0 repeat the first state."""
    kept: list[Reading] = []

    def falsify(state: Reading) -> Reading:
        kept.append(state)
        first = kept[0]
        late = round(rate * (state.stamp_ns - first.stamp_ns))
        return state._replace(stamp_ns=first.stamp_ns + late) if rate else first

    return falsify


FALSE_STATES: dict[str, Callable[[], Falsifier]] = {
    "silence": lambda: lambda state: None,
    "the same state again and again": lambda: stamps(0.0),
    "stamps at a tenth of the speed": lambda: stamps(0.1),
    "frozen": frozen,
    "frozen, velocities zero": lambda: frozen(still=True),
    "joint 2 frozen": lambda: frozen(1),
    "joint 4 frozen, its velocity zero": lambda: frozen(3, still=True),
    "velocities zero": lambda: velocities(np.zeros_like),
    "velocities negated": lambda: velocities(np.negative),
    "velocities doubled": lambda: velocities(lambda qd: 2.0 * qd),
    "velocities permuted": lambda: velocities(lambda qd: np.roll(qd, 1)),
    "two drivers": two_drivers,
}
PHASES = ("early", "upwards", "late", "move", "hold", "teaching")
MOMENTS = {"early": 0.10, "upwards": 0.25, "late": 0.40}  # as shares of the rollout's movement


class Driver:
    """The simulated arm as a driver in the lab's domain.

    Attributes:
        falsify: Changes a state before it is published.
        relayed: States after which a second publisher repeats each one; 0 without a relay.
        speeds: Speed of the tool in every period [m/s].
        path: Position of the tool in every period [m].

    Args:
        lab: The lab.
        hidden: Deviations of the arm from its model.
    """

    def __init__(self, lab: Lab, hidden: HiddenArm | None = None) -> None:
        self._lab = lab
        hidden = hidden or NOMINAL
        self._world, self._zeros = world(hidden), hidden.zeros
        self._arm = Arm(self._world.urdf, JOINTS)
        self._write = JointStateWriter(JOINTS)
        self.falsify: Falsifier = lambda state: state
        self.speeds: list[float] = []
        self.path: list[np.ndarray] = []
        self._stamp_ns = time.time_ns()
        self.policy = taught()
        self._states, self._relay = (
            lab.driver_node.create_publisher(
                JointState, interface.JOINT_STATES, interface.STATE_OUT
            )
            for _ in range(2)
        )
        self.relayed = 0
        self._published: deque[Reading] = deque(maxlen=100)
        self._world.reset("lies", self.policy.q_start)
        self._world.release()

    def gravity(self) -> np.ndarray:
        """g(q) at the arm's present posture [N m]. Shape (7,)."""
        return self._arm.gravity(self._world.joint_state().q)

    def play(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Run the arm for a time [s] or until a condition holds; return whether it holds."""
        lab, deadline = self._lab, time.monotonic_ns()
        end = deadline + round(seconds * 1e9)
        while not (done := until()) and deadline < end:
            torques = lab.torques
            self._world.step(torques[-1][1].tau if torques else None)
            sample = self._world.joint_state()
            self.speeds.append(self._arm.speeds(sample.q - self._zeros, sample.qd).tool_speed)
            self.path.append(self._world.tool_pose[0])
            self._stamp_ns += PERIOD_NS
            state = self.falsify(Reading(self._stamp_ns, sample.q, sample.qd))
            if state is not None:
                still = np.zeros(7)
                self._states.publish(self._write(state.stamp_ns, state.q, state.qd, still))
                self._published.append(state)
            if self.relayed and len(self._published) > self.relayed:
                old = self._published[-1 - self.relayed]
                self._relay.publish(self._write(old.stamp_ns, old.q, old.qd, np.zeros(7)))
            deadline += PERIOD_NS
            late = time.monotonic_ns() - deadline
            if late > 5 * PERIOD_NS:  # this process was delayed
                self._stamp_ns, deadline = self._stamp_ns + late, deadline + late
            while (left := deadline - time.monotonic_ns()) > 0:
                lab.spin(left * 1e-9)
        return done

    def ready(self, enough: Callable[[], bool] = lambda: False) -> bool:
        """Bring the arm to the start of the policy and hold, resetting a fault.

        Returns:
            True; False if it was `enough` before that.
        """
        self.falsify, self.relayed, lab = lambda state: state, 0, self._lab
        self.release()
        while not enough():
            self.play(0.5)
            if lab.label == "fault":
                self.call(interface.RESET)
            elif lab.label == "gravity_compensation":
                self.call(interface.GRAVITY_COMPENSATION, False)
            elif lab.label == "hold":
                if self.request("move_to_start"):
                    return True
        return False

    def call(self, name: str, data: bool | None = None) -> bool:
        """Call a service while the arm keeps running; return True on success."""
        future = self._lab.ask(name, data)
        done = self.play(TIMEOUT, future.done)
        answer = future.result() if done else None
        return answer is not None and answer.success

    def request(self, do: str) -> bool:
        """Request something about the policy while the arm keeps running; True on success."""
        future = self._lab.request(do, self.policy)
        asked = future.result() if self.play(TIMEOUT, future.done) else None
        self.play(TIMEOUT, lambda: asked is None or asked.answer or not asked.answers)
        return asked is not None and asked.answer is not None and asked.answer.success

    def begin(self, phase: str) -> None:
        """Bring the arm into a phase, to the moment at which false states begin."""
        self.ready()
        self.play(0.3)  # held so long, whatever comes
        lab, moment = self._lab, MOMENTS.get(phase)
        if moment is not None:
            lab.request("execute", self.policy)
            self.play(5.0, lambda: lab.label.startswith("rollout"))
            self.play(moment * self.policy.basis.duration)
        elif phase in ("move", "teaching"):
            self.call(interface.GRAVITY_COMPENSATION, True)
            self._world.attach(self._demonstrator())
            self.play(0.4)
        if phase == "move":
            self.release()
            self.call(interface.GRAVITY_COMPENSATION, False)
            self.play(1.0)
            lab.request("move_to_start", self.policy)
            self.play(5.0, lambda: lab.label == "move_to_start")
            self.play(0.2)

    def release(self) -> None:
        """Detach the demonstrator from the pan."""
        self._world.attach(None)

    def _demonstrator(self) -> Demonstrator:
        return Demonstrator(wrist_flick(np.random.default_rng(0)), *self._world.tool_pose)


class Outcome(NamedTuple):
    """Reaction to false states.

    Attributes:
        faulted: Periods from their beginning to the first torque of a fault; None without a fault.
        peak: Largest speed of the tool after they began [m/s].
        rest: Largest speed of the tool from 0.5 s after the fault on [m/s].
    """

    faulted: int | None
    peak: float
    rest: float


def inject(driver: Driver, lab: Lab, phase: str, falsify: Falsifier, relayed: int = 0) -> Outcome:
    """Publish false states, or each again some states later, in one phase and observe the arm."""
    driver.begin(phase)
    while lab.label == "fault":  # a busy machine has delayed a process
        driver.begin(phase)
    driver.speeds.clear()
    driver.falsify, driver.relayed = falsify, relayed
    faulted: list[int] = []

    def watch() -> bool:
        if not faulted and lab.label == "fault":
            faulted.append(len(driver.speeds))
            driver.release()
        return len(driver.speeds) >= WATCH_TICKS

    driver.play(WATCH_TICKS * 0.002 * 2.0, watch)
    calm = driver.speeds[(faulted[0] if faulted else 0) + REST_TICKS :]
    return Outcome(faulted[0] if faulted else None, max(driver.speeds), max(calm, default=0.0))


def acceptable(outcome: Outcome, peak: float) -> bool:
    """Return True if the tool stayed slow and, after a fault, the arm came to rest."""
    rested = outcome.faulted is None or outcome.rest < REST_SPEED
    return outcome.peak <= peak + SPEED_MARGIN and rested
