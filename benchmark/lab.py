# SPDX-License-Identifier: Apache-2.0
"""A private DDS domain with nodes as processes, and an arm that this process plays.

The arm keeps the last torque indefinitely, as ros2_control and libbarrett do, so only the
controller can stop it.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from benchmark.false_states import Falsifier, N, Reading
from benchmark.loop import MOMENTS, Outcome, Plant, outcome
from benchmark.nodes import JOINTS, PERIOD_NS, environment, node_command, taught
from wam_power_interfaces.action import ExecutePolicy, MoveToStart
from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros.cli.processes import Processes, Running
from wam_power_ros.client.actions import Action, Goal
from wam_power_ros.client.link import Data, Link
from wam_power_ros.learning.policy import Policy, to_json
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.domain import private_domain
from wam_power_ros.ros.guards import STAND_IN
from wam_power_ros.ros.outcomes import Answer

TIMEOUT = 90.0  # [s] for a node to start, to hold, to fault
ARM, CONTROLLER = 70, 60  # real-time priorities
WATCH_TIME = 1.2  # [s] of observation after false states began


class Lab:
    """A private DDS domain with an observing node.

    Attributes:
        torques: Reception times [ns, steady clock] and readings of the last torques.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.torques: list[tuple[int, joint_messages.TorqueReading]] = []

    @contextmanager
    def open(self) -> Iterator[Lab]:
        """Enter the domain; on leaving, end all processes."""
        with private_domain() as domain:
            reach = os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            given = environment(domain) | {"ROS_AUTOMATIC_DISCOVERY_RANGE": reach}
            self._context = rclpy.Context()
            rclpy.init(context=self._context, domain_id=domain)
            self._node = Node("observer", context=self._context)
            self._driver_node = Node(STAND_IN, context=self._context)
            self._link = Link(Node("person", context=self._context))
            self._actions = {
                "execute": Action(self._link, ExecutePolicy, interface.EXECUTE_POLICY),
                "move_to_start": Action(self._link, MoveToStart, interface.MOVE_TO_START),
            }
            self._threads = ThreadPoolExecutor()
            self._executor = EventsExecutor(context=self._context)
            self._executor.add_node(self._node)
            self._node.create_subscription(
                Float64MultiArray, interface.EFFORT_COMMANDS, self._on_torque, interface.COMMAND
            )
            try:
                with Processes(self.folder, given) as self._processes, self._link:
                    yield self
            finally:
                self._threads.shutdown()
                self._executor.shutdown()
                self._node.destroy_node()
                self._driver_node.destroy_node()
                rclpy.shutdown(context=self._context)

    def _on_torque(self, message: Float64MultiArray) -> None:
        self.torques.append((time.monotonic_ns(), joint_messages.torque(message, JOINTS)))
        del self.torques[:-20_000]

    @property
    def label(self) -> str:
        """Mode of the controller at the last torque."""
        return self.torques[-1][1].label if self.torques else ""

    def controller(self, priority: int = CONTROLLER) -> Running:
        """Start the controller."""
        command = node_command("torque_controller", "simulation", realtime_priority=priority)
        return self._processes.start("torque_controller", command)

    def end(self, running: Running) -> None:
        """Kill a process."""
        running.process.kill()
        running.process.wait()
        self._processes._running.remove(running)

    def spin(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Dispatch callbacks for a time [s] or until a condition holds; return whether it holds."""
        end = time.monotonic() + seconds
        while not (done := until()) and (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, 0.005))
        return done

    def ask(self, name: str, data: Data = None) -> Future[Answer | None]:
        """Call a service in another thread: this one may have to play the arm meanwhile."""
        return self._threads.submit(self._link.call, name, data)

    def request(self, do: str, policy: Policy) -> Future[Goal]:
        """Send a goal about a policy, in another thread; done once it is accepted."""
        message = PolicyMessage(id=policy.id, text=to_json(policy))
        return self._threads.submit(self._actions[do].send, policy=message)


class Driver:
    """An arm simulated in this process, in real time, as a driver in the lab's domain.

    Attributes:
        plant: The arm.
        falsify: Changes a state before it is published.
        relayed: States after which a second publisher repeats each one; 0 without a relay.
        speeds: Speed of the tool in every period [m/s].
        path: Position of the tool in every period [m].
        stamp_ns: Stamp of the last state.
        published_ns: Time at which it was published [ns, steady clock].
    """

    def __init__(self, lab: Lab, plant: Plant) -> None:
        self._lab, self.plant, self.policy = lab, plant, taught()
        self._write = joint_messages.JointStateWriter(JOINTS)
        self.falsify: Falsifier = lambda state: state
        self.speeds: list[float] = []
        self.path: list[np.ndarray] = []
        self.stamp_ns, self.published_ns = time.time_ns(), 0
        given = JointState, interface.JOINT_STATES, interface.STATE_OUT
        self._states, self._relay = (lab._driver_node.create_publisher(*given) for _ in range(2))
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
            self.stamp_ns += PERIOD_NS
            if (state := self.falsify(Reading(self.stamp_ns, q, qd))) is not None:
                self._publish(self._states, state)
                self._published.append(state)
            if self.relayed and len(self._published) > self.relayed:
                self._publish(self._relay, self._published[-1 - self.relayed])
            deadline += PERIOD_NS
            late = time.monotonic_ns() - deadline
            if late > 5 * PERIOD_NS:  # this process was delayed
                self.stamp_ns, deadline = self.stamp_ns + late, deadline + late
            while (left := deadline - time.monotonic_ns()) > 0:
                lab.spin(left * 1e-9)
        return done

    def _publish(self, publisher: Publisher, state: Reading) -> None:
        message = self._write(*state, np.zeros(N))
        self.published_ns = time.monotonic_ns()
        publisher.publish(message)

    def ready(self) -> None:
        """Bring the arm to the start of the policy and hold, resetting a fault."""
        self.falsify, self.relayed, lab = lambda state: state, 0, self._lab
        self.plant.let_go()
        while True:
            self.play(0.5)
            if lab.label == "fault":
                self.call(interface.RESET)
            elif lab.label == "gravity_compensation":
                self.call(interface.GRAVITY_COMPENSATION, False)
            elif lab.label == "hold" and self.request("move_to_start"):
                return

    def call(self, name: str, data: bool | None = None) -> bool:
        """Call a service while the arm keeps running; return True on success."""
        future = self._lab.ask(name, data)
        done = self.play(TIMEOUT, future.done)
        answer = future.result() if done else None
        return answer is not None and answer.success

    def request(self, do: str) -> bool:
        """Request something about the policy while the arm keeps running; True on success."""
        future = self._lab.request(do, self.policy)
        goal = future.result() if self.play(TIMEOUT, future.done) else None
        self.play(TIMEOUT, lambda: goal is None or goal.ended)
        return goal is not None and goal.answer is not None and goal.answer.success

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


def inject(
    driver: Driver,
    lab: Lab,
    phase: str,
    falsify: Falsifier,
    relayed: int = 0,
    seconds: float = WATCH_TIME,
) -> Outcome:
    """Publish false states, or each again some states later, in one phase and observe the arm."""
    driver.begin(phase)
    while lab.label == "fault":  # a busy machine has delayed a process
        driver.begin(phase)
    driver.falsify, driver.relayed = falsify, relayed
    return driver.observe(seconds)
