# SPDX-License-Identifier: Apache-2.0
"""Where faults are made: a domain of its own, the nodes as processes, and an arm.

Where the arm only needs to stand still we play it, 500 states a second on the wall clock; where it
must be able to fall, the stand-in does.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from wam_power_ros.cli.processes import Processes, Running, private_domain
from wam_power_ros.params.resources import share
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.ros import interface

ROOT = Path(__file__).resolve().parents[1]
NAMES = [f"wam_j{i}" for i in range(1, 8)]
HOME = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])
PERIOD_NS = 2_000_000
PATIENCE = 90.0  # for a node to start, to hold, to fault [s]
ARM, CONTROLLER, WATCHER = 70, 60, 50  # real-time priorities


def core() -> TorqueControllerParams:
    """The controller's parameters, as config/ sets them."""
    return TorqueControllerParams.of_file(
        share("config/torque_controller.yaml"), "torque_controller"
    )


class Lab:
    """A domain of its own with our node in it; the arm is ours or the stand-in's.

    Attributes:
        torques: (when received [ns, steady clock], reading), those of the last seconds.
        readings: States of the stand-in, when asked for.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.torques: list[tuple[int, interface.TorqueReading]] = []
        self.readings: list[interface.JointReading] = []
        self.stamp_ns = time.time_ns()
        self.published_ns = 0

    @contextmanager
    def open(self) -> Iterator[Lab]:
        """Enter the domain; leaving it ends everything."""
        with private_domain() as domain:
            environment = {
                "ROS_DOMAIN_ID": str(domain),
                "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
            }
            os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            self._context = rclpy.Context()
            rclpy.init(context=self._context, domain_id=domain)
            self.node = Node("faults", context=self._context)
            self._executor = EventsExecutor(context=self._context)
            self._executor.add_node(self.node)
            self.node.create_subscription(
                Float64MultiArray, interface.EFFORT_COMMANDS, self._on_torque, interface.COMMAND
            )
            self._write = interface.JointStateWriter(NAMES)
            self._services: dict[str, object] = {}
            try:
                with Processes(self.folder, environment) as self.processes:
                    yield self
            finally:
                self._executor.shutdown()
                self.node.destroy_node()
                rclpy.shutdown(context=self._context)

    def _on_torque(self, message: Float64MultiArray) -> None:
        self.torques.append((time.monotonic_ns(), interface.torque(message, NAMES)))
        del self.torques[:-20_000]

    @property
    def label(self) -> str:
        """What the last torque was for."""
        return self.torques[-1][1].label if self.torques else ""

    def controller(self, priority: int = CONTROLLER) -> Running:
        """Start the controller."""
        return self._start("torque_controller", [f"realtime_priority:={priority}"])

    def stand_in(self, priority: int = ARM) -> Running:
        """Start the stand-ins, in real time, and watch their states."""
        if not hasattr(self, "_reader"):
            self._reader = interface.JointStateReader(NAMES)
            self.node.create_subscription(
                JointState,
                interface.JOINT_STATES,
                lambda message: self.readings.append(self._reader(message)),
                interface.STATE_RECORD,
            )
        more = ["wam_sim:pace:=real_time", f"wam_sim:realtime_priority:={priority}"]
        return self._start("wam_sim", more, "optitrack_sim")

    def _start(self, node: str, parameters: list[str], *configs: str) -> Running:
        command = [sys.executable, "-m", "wam_power_ros.cli", "run", node, "--ros-args"]
        for config in (node, *configs):
            command += ["--params-file", f"{ROOT}/config/{config}.yaml"]
        for parameter in parameters:
            command += ["-p", parameter]
        return self.processes.start(node, command)

    def end(self, running: Running, how: int = signal.SIGKILL) -> None:
        """Send a process a signal and wait for its end."""
        running.process.send_signal(how)
        running.process.wait()
        self.processes._running.remove(running)

    def spin(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Listen for a while, at most until something is so; whether it is."""
        end = time.monotonic() + seconds
        while not (done := until()) and (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, 0.005))
        return done

    def wait(self, until: Callable[[], bool], what: str, play: bool = False) -> None:
        """Listen, or play the arm, until something is so."""
        if not (self.play if play else self.spin)(PATIENCE, until):
            raise TimeoutError(f"not within {PATIENCE:.0f} s: {what} (last torque: {self.label!r})")

    def held(self) -> None:
        """Listen until the controller holds, resetting the fault it may be in."""
        while self.label != "hold":
            if self.label == "fault":
                self.call(interface.RESET)
            self.spin(2.0, lambda: self.label == "hold")
            self.processes.check()

    def call(self, name: str, play: bool = False) -> bool:
        """Call a Trigger service and wait for its answer."""
        client = self._services.get(name)
        if client is None:
            client = self._services[name] = self.node.create_client(Trigger, name)
        self.wait(client.service_is_ready, name, play)
        future = client.call_async(Trigger.Request())
        self.wait(future.done, f"answer of {name}", play)
        return future.result().success

    # The arm as we play it: it never moves.

    def publish(self) -> None:
        """One state, stamped with the time by now."""
        if not hasattr(self, "_states"):
            self._states = self.node.create_publisher(
                JointState, interface.JOINT_STATES, interface.STATE_OUT
            )
        message = self._write(self.stamp_ns, HOME, np.zeros(7), np.zeros(7))
        self.published_ns = time.monotonic_ns()
        self._states.publish(message)

    def play(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Publish 500 states a second, at most until something is so; whether it is."""
        end = deadline = time.monotonic_ns()
        end += round(seconds * 1e9)
        while not (done := until()) and deadline < end:
            self.stamp_ns += PERIOD_NS
            self.publish()
            deadline += PERIOD_NS
            if time.monotonic_ns() - deadline > 5 * PERIOD_NS:  # we ourselves were held up
                self.stamp_ns += time.monotonic_ns() - deadline
                deadline = time.monotonic_ns()
            while (left := deadline - time.monotonic_ns()) > 0:
                self._executor.spin_once(timeout_sec=left * 1e-9)
        return done

    def played(self) -> None:
        """Play until the controller holds, resetting the fault it may be in."""

        def holds() -> bool:
            return self.label == "hold"

        while not holds():
            if self.label == "fault":
                self.play(0.1)
                self.call(interface.RESET, play=True)
            self.play(5.0, holds)
