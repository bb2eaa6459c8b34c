# SPDX-License-Identifier: Apache-2.0
"""Driver of a Franka robot: torques in, joint states out, by its maker's library at 1 kHz.

The robot adds gravity. One thread does all, because the library keeps the interpreter's lock while
it waits for the robot. A reflex shows as a gap in the states, so that the controller is in a fault.
The robot's errors are cleared, which moves nothing; torques wait until the controller is reset.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import numpy as np
import pylibfranka as franka
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from wam_power_ros.nodes import franka_errors
from wam_power_ros.params.driver_params import FrankaDriverParams
from wam_power_ros.ros import interface, joint_messages, node_runner, scheduling
from wam_power_ros.ros.diagnostics import Diagnostics

STEP_MAX = 0.9  # [N m] in a cycle of 1 ms, of the 1 that the robot allows
TAU_MAX = np.array([87.0] * 4 + [12.0] * 3)  # [N m]
BRAKE = np.array([20.0] * 4 + [3.0] * 3)  # [N m s/rad] while no torque comes
REST, BRAKE_TIME = 0.02, 0.5  # [rad/s], [s] until the robot is asked to hold the arm by itself
LATE_STATES = 100  # late ones in a row show that the system's clock was set
GAP, AGAIN = 0.2, 1.0  # [s] without states after an error; between two attempts to connect
ABLE = (franka.RobotMode.Idle, franka.RobotMode.Move, franka.RobotMode.Guiding)
ERRORS = (  # no class is above all, but RuntimeError, which ROS raises, too
    franka.FrankaException,  # also of its protocol, and of a robot of another version
    franka.CommandException,
    franka.InvalidOperationException,
    franka.NetworkException,
    franka.RealtimeException,
)


class FrankaDriver(Node):
    """Passes the newest torque on to the robot while there is one, and the robot's states to ROS.

    `fault` says why the robot was stopped, and what clears it; empty while nothing did.
    """

    def __init__(self) -> None:
        super().__init__("franka_driver", automatically_declare_parameters_from_overrides=True)
        self._params = params = FrankaDriverParams.from_node(self)
        if not params.address:
            raise ValueError("address of franka_driver is empty: give that of the robot")
        self._robot: franka.Robot | None = None
        self._control: franka.ActiveControlBase | None = None  # while torques are passed on
        self._torque = joint_messages.TorqueReading(None, "", np.zeros(7))
        self._came = self._silent_until = self._reported = 0.0  # [s], steady clock
        self._offset_ns, self._sent_ns, self._late = 0, 0, LATE_STATES  # see `_publish`
        self.fault, self._refused, self._stopped, self._rates = "", 0, False, []
        self._write = joint_messages.JointStateWriter(params.joint_names)
        self._states = self.create_publisher(JointState, params.state_topic, interface.STATE_OUT)
        command = params.command_topic, self._on_torque, interface.COMMAND
        self.create_subscription(Float64MultiArray, *command)
        self._diagnostics = Diagnostics(self, "robot", params.address)
        self._granted = scheduling.request(params.realtime_priority)

    def serve(self, ended: Callable[[], bool]) -> None:
        """Exchange states and torques with the robot until `ended()`, then let it hold the arm."""
        executor = node_runner.executor_for(self)
        while not (over := ended()) or self._control is not None:
            try:
                state = self._state()
                if self._able(state) and not self._silent:
                    self._publish(state)
                if not over:
                    executor.spin_once(timeout_sec=0.0)
                self._answer(state)
            except franka.ControlException:
                self._control, self._stopped = None, True
            except ERRORS as error:
                lost, self._control = isinstance(error, franka.NetworkException), None
                self._robot = None if lost else self._robot
                text = f"{error}; cable, address {self._params.address}, FCI and joints in Desk"
                self._blame(text if lost else self.fault or text)
                time.sleep(AGAIN)
            self._report()

    @property
    def _silent(self) -> bool:
        """Whether the controller is to lose the states, which latches its fault."""
        return time.monotonic() < self._silent_until

    def _state(self) -> franka.RobotState:
        """The next state of the robot, which sends one each millisecond."""
        if self._control is not None:
            return self._control.readOnce()[0]
        if self._robot is None:
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            self._robot = franka.Robot(self._params.address, franka.RealtimeConfig.kIgnore)
            os.sched_setscheduler(0, *before)  # it takes 99, which kernel threads need
            torque, force = self._params.collision_torque, self._params.collision_force
            self._robot.set_collision_behavior(*[[torque] * 7] * 2, *[[force] * 6] * 2)
            self._sent_ns, self._late = 0, LATE_STATES
        return self._robot.read_once()

    def _able(self, state: franka.RobotState) -> bool:
        """Whether the robot takes torques; its errors are cleared, but torques wait for a reset."""
        if self._stopped or state.robot_mode not in ABLE:
            errors = state.current_errors or state.last_motion_errors
            self._blame(franka_errors.described(errors, state.robot_mode.name))
        self._stopped = False
        if state.robot_mode == franka.RobotMode.Reflex:
            self._robot.automatic_error_recovery()
        return state.robot_mode in ABLE

    def _blame(self, text: str) -> None:
        self._silent_until = time.monotonic() + GAP
        if text != self.fault:
            self.get_logger().error(text)
        self.fault = text

    def _publish(self, state: franka.RobotState) -> None:
        """Send a state, if one is due, stamped when it was measured."""
        time_ns = round(state.time.to_sec() * 1e9)
        if 0 <= time_ns - self._sent_ns < round(self._params.period * 1e9):
            return
        late_ns = time.time_ns() - time_ns - self._offset_ns  # least delay, and slow drift
        self._late = self._late + 1 if late_ns > 5_000_000 else 0  # a pause, or another clock
        self._offset_ns += late_ns if self._late > LATE_STATES else min(late_ns, 2000)
        self._sent_ns = time_ns
        q, qd, tau = map(np.array, (state.q, state.dq, state.tau_J))
        self._states.publish(self._write(time_ns + self._offset_ns, q, qd, tau))

    def _on_torque(self, message: Float64MultiArray) -> None:
        try:
            self._torque = joint_messages.torque(message, self._params.joint_names)
            self._came = time.monotonic()
        except ValueError as error:
            self._refused += 1
            self.get_logger().warning(f"torque refused: {error}", throttle_duration_sec=1.0)

    def _answer(self, state: franka.RobotState) -> None:
        """Answer a state with the newest torque, else with a brake and then the robot's own hold.

        After an error only the torque of a controller that was reset is passed on.
        """
        waited = time.monotonic() - self._came
        label, lost = self._torque.label, waited > self._params.watchdog
        if self._control is None:
            allowed = label != "fault" and bool(label or not self.fault) and not self._silent
            if allowed and not lost and state.robot_mode == franka.RobotMode.Idle:
                self._control, self.fault = self._robot.start_torque_control(), ""
            return
        speeds, sent = np.array(state.dq), np.array(state.tau_J_d)
        tau = np.clip(-BRAKE * speeds if lost else self._torque.tau, -TAU_MAX, TAU_MAX)
        torques = franka.Torques((sent + np.clip(tau - sent, -STEP_MAX, STEP_MAX)).tolist())
        slow = np.abs(speeds).max() < REST
        torques.motion_finished = done = bool(lost and (slow or waited > BRAKE_TIME))
        self._control.writeOnce(torques)
        if rate := state.control_command_success_rate:  # 0 before the first answer
            self._rates.append(rate)
        if done:
            self._control = None

    def _report(self) -> None:
        if time.monotonic() - self._reported < 1.0:
            return
        self._reported, rates, self._rates = time.monotonic(), self._rates or [0.0], []
        values = {"torques": "passed on" if self._control else "not passed on", "fault": self.fault}
        values |= {"success rate": f"{np.mean(rates):.4f}", "least": f"{min(rates):.2f}"}
        values |= {"torques refused": self._refused, "real time": self._granted.scheduling}
        level = "error" if self.fault else "ok"
        self._diagnostics.publish(level, self.fault or values["torques"], values)


def main() -> int:
    """Entry point of `ros2 run wam_power_ros franka_driver`."""
    return node_runner.run(FrankaDriver, FrankaDriver.serve)
