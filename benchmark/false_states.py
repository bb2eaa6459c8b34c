# SPDX-License-Identifier: Apache-2.0
"""A driver over DDS that publishes the false joint states of `lies`.

The arm is simulated in this process in real time. It keeps the last torque indefinitely, as
ros2_control and libbarrett do, so only the controller can stop it.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import numpy as np
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from benchmark.hidden_arm import StandIn
from benchmark.lab import TIMEOUT, Lab
from benchmark.lies import Falsifier, N, Reading
from benchmark.loop import MOMENTS, Outcome, outcome
from benchmark.nodes import JOINTS, PERIOD_NS, taught
from hardware_sim.hidden_arm import HiddenArm
from wam_power_ros.ros import interface
from wam_power_ros.ros.joint_messages import JointStateWriter

WATCH_TIME = 1.2  # [s] of observation after false states began


class Driver:
    """The simulated arm as a driver in the lab's domain.

    Attributes:
        plant: The arm.
        falsify: Changes a state before it is published.
        relayed: States after which a second publisher repeats each one; 0 without a relay.
        speeds: Speed of the tool in every period [m/s].
        path: Position of the tool in every period [m].

    Args:
        lab: The lab.
        hidden: Deviations of the arm from its model.
    """

    def __init__(self, lab: Lab, hidden: HiddenArm | None = None) -> None:
        self._lab, self.plant = lab, StandIn(hidden)
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

    def play(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Run the arm for a time [s] or until a condition holds; return whether it holds."""
        lab, deadline = self._lab, time.monotonic_ns()
        end = deadline + round(seconds * 1e9)
        while not (done := until()) and deadline < end:
            torques = lab.torques
            q, qd = self.plant.step(torques[-1][1].tau if torques else None)
            self.speeds.append(self.plant.tool_speed())
            self.path.append(self.plant.tool_position())
            self._stamp_ns += PERIOD_NS
            if (state := self.falsify(Reading(self._stamp_ns, q, qd))) is not None:
                self._publish(self._states, state)
                self._published.append(state)
            if self.relayed and len(self._published) > self.relayed:
                self._publish(self._relay, self._published[-1 - self.relayed])
            deadline += PERIOD_NS
            late = time.monotonic_ns() - deadline
            if late > 5 * PERIOD_NS:  # this process was delayed
                self._stamp_ns, deadline = self._stamp_ns + late, deadline + late
            while (left := deadline - time.monotonic_ns()) > 0:
                lab.spin(left * 1e-9)
        return done

    def _publish(self, publisher: Publisher, state: Reading) -> None:
        publisher.publish(self._write(*state, np.zeros(N)))

    def ready(self, enough: Callable[[], bool] = lambda: False) -> bool:
        """Bring the arm to the start of the policy and hold, resetting a fault.

        Returns:
            True; False if it was `enough` before that.
        """
        self.falsify, self.relayed, lab = lambda state: state, 0, self._lab
        self.plant.let_go()
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
            self.plant.guide(0)
            self.play(0.4)
        if phase == "move":
            self.plant.let_go()
            self.call(interface.GRAVITY_COMPENSATION, False)
            self.play(1.0)
            lab.request("move_to_start", self.policy)
            self.play(5.0, lambda: lab.label == "move_to_start")
            self.play(0.2)

    def observe(self, seconds: float) -> Outcome:
        """Watch the arm for some time [s]; the person lets go at a fault.

        The torques do not say of which kind it is, and `reset` is not known.
        """
        self.speeds.clear()
        self.path.clear()
        noticed: list[int] = []

        def watch() -> bool:
            if not noticed and self._lab.label == "fault":
                noticed.append(len(self.speeds))
                self.plant.let_go()
            return len(self.speeds) * PERIOD_NS * 1e-9 >= seconds

        self.play(2.0 * seconds, watch)
        return outcome(None, noticed[0] if noticed else None, self.speeds, self.path)


def inject(driver: Driver, lab: Lab, phase: str, falsify: Falsifier, relayed: int = 0) -> Outcome:
    """Publish false states, or each again some states later, in one phase and observe the arm."""
    driver.begin(phase)
    while lab.label == "fault":  # a busy machine has delayed a process
        driver.begin(phase)
    driver.falsify, driver.relayed = falsify, relayed
    return driver.observe(WATCH_TIME)
