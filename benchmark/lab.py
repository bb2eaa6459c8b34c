# SPDX-License-Identifier: Apache-2.0
"""Set-up for fault injection: a private DDS domain, the nodes as processes, and an arm.

If the arm only stands still, this process publishes its states, 500 a second on the wall clock. If
it must be able to fall, the stand-in does.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from benchmark.nodes import HOME, JOINTS, PERIOD_NS, environment, node_command
from wam_power_ros.cli.processes import Processes, Running
from wam_power_ros.client.link import Data, Link
from wam_power_ros.client.requests import Asked, Requests
from wam_power_ros.control.controller import Controller
from wam_power_ros.learning.policy import Policy, to_json
from wam_power_ros.params.resources import share
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.answers import Answer
from wam_power_ros.ros.domain import private_domain
from wam_power_ros.ros.simulation_guard import STAND_IN

TIMEOUT = 90.0  # [s] for a node to start, to hold, to fault
ARM, CONTROLLER, WATCHER = 70, 60, 50  # real-time priorities


def new_controller() -> Controller:
    """A controller with the parameters of config/ and the shipped URDF."""
    params = TorqueControllerParams.of_file(
        share("config/torque_controller.yaml"), "torque_controller", share("config/simulation.yaml")
    )
    return params.controller(share("urdf/wam7.urdf").read_text())


class Lab:
    """A private DDS domain with an observing node; this process or the stand-in plays the arm.

    Attributes:
        domain: Number of the domain; set by `open`.
        link: Link of a node beside the observing one; set by `open`.
        torques: Reception times [ns, steady clock] and readings of the last torques.
        readings: States of the stand-in, if it plays the arm.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.torques: list[tuple[int, joint_messages.TorqueReading]] = []
        self.readings: list[joint_messages.JointReading] = []
        self.stamp_ns = time.time_ns()
        self.published_ns = 0

    @contextmanager
    def open(self) -> Iterator[Lab]:
        """Enter the domain; on leaving, end all processes."""
        with private_domain() as domain:
            self.domain = domain
            reach = os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            given = environment(domain) | {"ROS_AUTOMATIC_DISCOVERY_RANGE": reach}
            self._context = rclpy.Context()
            rclpy.init(context=self._context, domain_id=domain)
            self.node = Node("faults", context=self._context)
            self.driver_node = Node(STAND_IN, context=self._context)
            self.link = Link(Node("person", context=self._context))
            self._requests = Requests(
                self.link, interface.CONTROLLER_REQUEST, interface.CONTROLLER_ANSWER
            )
            self._threads = ThreadPoolExecutor()
            self._executor = EventsExecutor(context=self._context)
            self._executor.add_node(self.node)
            self.node.create_subscription(
                Float64MultiArray, interface.EFFORT_COMMANDS, self._on_torque, interface.COMMAND
            )
            self._write = joint_messages.JointStateWriter(JOINTS)
            try:
                with Processes(self.folder, given) as self.processes, self.link:
                    yield self
            finally:
                self._threads.shutdown()
                self._executor.shutdown()
                self.node.destroy_node()
                self.driver_node.destroy_node()
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
        name = "torque_controller"
        return self.processes.start(
            name, node_command(name, "simulation", realtime_priority=priority)
        )

    def stand_in(self, priority: int = ARM) -> Running:
        """Start the stand-ins in real time and subscribe to their states."""
        if not hasattr(self, "_reader"):
            self._reader = joint_messages.JointStateReader(JOINTS)
            self.node.create_subscription(
                JointState,
                interface.JOINT_STATES,
                lambda message: self.readings.append(self._reader(message)),
                interface.STATE_RECORD,
            )
        given = {"pace": "real_time", "realtime_priority": priority, "listeners": ["faults"]}
        return self.processes.start("wam_sim", node_command("wam_sim", "optitrack_sim", **given))

    def end(self, running: Running, how: int = signal.SIGKILL) -> None:
        """Send a signal to a process and wait for its end."""
        running.process.send_signal(how)
        running.process.wait()
        self.processes._running.remove(running)

    def spin(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Dispatch callbacks for a time [s] or until a condition holds; return whether it holds."""
        end = time.monotonic() + seconds
        while not (done := until()) and (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, 0.005))
        return done

    def wait(self, until: Callable[[], bool], what: str, play: bool = False) -> None:
        """Dispatch callbacks, or play the arm, until a condition holds.

        Raises:
            TimeoutError: If it does not hold within `TIMEOUT`.
        """
        if not (self.play if play else self.spin)(TIMEOUT, until):
            raise TimeoutError(f"no {what} within {TIMEOUT:.0f} s (last torque: {self.label!r})")

    def held(self) -> None:
        """Wait until the controller holds, resetting a fault."""
        while self.label != "hold":
            if self.label == "fault":
                self.call(interface.RESET)
            self.spin(2.0, lambda: self.label == "hold")
            self.processes.check()

    def ask(self, name: str, data: Data = None) -> Future[Answer | None]:
        """Call a service in another thread: this one may have to play the arm meanwhile."""
        return self._threads.submit(self.link.call, name, data)

    def request(self, do: str, policy: Policy) -> Future[Asked]:
        """Send a request about a policy, in another thread; done once it has begun or not."""
        return self._threads.submit(self._requests.begin, do, policy=to_json(policy))

    def call(self, name: str, play: bool = False) -> bool:
        """Call a Trigger service and wait for its response; return True on success."""
        future = self.ask(name)
        self.wait(future.done, f"response of {name}", play)
        answer = future.result()
        return answer is not None and answer.success

    # The arm played by this process; it never moves.

    def publish(self) -> None:
        """Publish one state with the present stamp."""
        if not hasattr(self, "_states"):
            self._states = self.driver_node.create_publisher(
                JointState, interface.JOINT_STATES, interface.STATE_OUT
            )
        message = self._write(self.stamp_ns, HOME, np.zeros(7), np.zeros(7))
        self.published_ns = time.monotonic_ns()
        self._states.publish(message)

    def play(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Publish 500 states a second until a condition holds; return whether it holds in time."""
        end = deadline = time.monotonic_ns()
        end += round(seconds * 1e9)
        while not (done := until()) and deadline < end:
            self.stamp_ns += PERIOD_NS
            self.publish()
            deadline += PERIOD_NS
            if time.monotonic_ns() - deadline > 5 * PERIOD_NS:  # this process was delayed
                self.stamp_ns += time.monotonic_ns() - deadline
                deadline = time.monotonic_ns()
            while (left := deadline - time.monotonic_ns()) > 0:
                self._executor.spin_once(timeout_sec=left * 1e-9)
        return done

    def played(self) -> None:
        """Play until the controller holds, resetting a fault."""

        def holds() -> bool:
            return self.label == "hold"

        while not holds():
            if self.label == "fault":
                self.play(0.1)
                self.call(interface.RESET, play=True)
            self.play(5.0, holds)
