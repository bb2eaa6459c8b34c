# SPDX-License-Identifier: Apache-2.0
"""WAM stand-in: torques in, joint states out, as the driver of the arm.

In lockstep the world steps when the torque for the published state arrives; in real time it steps
once a control period with the newest torque. `main` keeps the pace.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from hardware_sim.barrett_services import BarrettServices
from hardware_sim.scene_services import SceneServices
from hardware_sim.sensors import MocapFrame
from hardware_sim.settings import ArmSimParams
from hardware_sim.world import World
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.diagnostics import Diagnostics

CLOCK_PERIOD_NS = 10_000_000  # [ns] of /clock, which every node in lockstep reads and records
IDLE_TIME = 5.0  # [s] without motion and requests, longer than any wait of a session
IDLE_LABELS = ("", "inactive", "hold", "gravity_compensation", "fault")
TORQUE_PER_CURRENT = 12.0  # [N m/A] of a motor and its gear, where effort is its current


def _sent(values: np.ndarray, how: str) -> Sequence[float] | np.ndarray:
    """Values of a joint state as a driver sends them: see config/wam_sim.yaml."""
    if how == "current":
        return values / TORQUE_PER_CURRENT
    if how in ("filled", "external"):
        return values
    return np.full(len(values), np.nan) if how == "nan" else ()


class ArmSim(Node):
    """Driver of the simulated arm.

    Attributes:
        on_torque: Callback for every valid torque command.
        counters: Events since the start, by name.
        world: World to step, see `attach`.
        stamp_offset_ns: Offset of the stamps from the time of the world [ns].
    """

    def __init__(self) -> None:
        super().__init__("wam_sim", automatically_declare_parameters_from_overrides=True)
        self.params = ArmSimParams.from_node(self)
        self.on_torque: Callable[[joint_messages.TorqueReading], None] = lambda reading: None
        self.counters: Counter[str] = Counter()
        self._still_ticks = 0  # without motion and requests

    def attach(self, world: World, on_frame: Callable[[MocapFrame, int, int], None]) -> None:
        """Attach a world and create the topics and services of the driver.

        `on_frame` gets each motion-capture frame, the stamp offset [ns] and the time [ns].
        """
        self.world, self._on_frame = world, on_frame
        self._connect()
        # in real time the stamps are of the system clock, like those of a real driver
        self.stamp_offset_ns = 0 if self.params.lockstep else time.time_ns() - world.time_ns
        self._barrett = BarrettServices(self, world, self.params)
        self._scene = SceneServices(self, world, self.params)
        self._description.publish(String(data=world.urdf))

    def _connect(self) -> None:
        """Create the topics of the driver."""
        params = self.params
        qos = interface.DEEP
        self._states = self.create_publisher(JointState, params.state_topic, qos)
        self._velocities = None
        if params.velocity_topic:
            self._velocities = self.create_publisher(JointState, params.velocity_topic, qos)
        others = [name for name in params.other_joints if name]
        self._others = joint_messages.JointStateWriter(others) if others else None
        if self.params.lockstep:
            self._clock_ns = self._state_ns = -CLOCK_PERIOD_NS  # when last published
            self._clocks = self.create_publisher(Clock, interface.CLOCK, interface.NEWEST)
        self._description = self.create_publisher(
            String, interface.ROBOT_DESCRIPTION, interface.LATCHED
        )
        self._diagnostics = Diagnostics(self, "loop", "stand-in")
        is_sorted = params.state_order == "sorted"
        names = sorted(params.joint_names) if is_sorted else list(params.joint_names)
        self._write = joint_messages.JointStateWriter(names)
        self._order = np.array([params.joint_names.index(name) for name in names])
        if params.output == "pose":  # like the controller cartesian_motion_controller
            self.declare_parameter("robot_base_link", params.base_frame)
            self.declare_parameter("end_effector_link", params.tool_frame)
        elif params.deactivates:  # like a forwarder of ros2_control, which has these parameters
            self.declare_parameter("joints", list(params.joint_names))
            kind = "effort" if params.output == "torque" else "position"
            self.declare_parameter("interface_name", kind)
        kind = params.output if params.output in ("trajectory", "pose") else params.command_type
        message_type = joint_messages.COMMAND_TYPES[kind]
        self.create_subscription(
            message_type, params.command_topic, self._on_torque, interface.COMMAND
        )

    # The tick

    @property
    def idle(self) -> bool:
        """Whether nothing has moved or been requested for long, and nothing is requested now."""
        return self._still_ticks * self.params.period > IDLE_TIME and not self._scene.busy

    @property
    def stamp_ns(self) -> int:
        """Stamp of the current state [ns]."""
        return self.world.time_ns + self.stamp_offset_ns

    def tick(self, reading: joint_messages.TorqueReading | None) -> JointState:
        """Step the world with the newest torque, None if there is no new one; see `state`."""
        world = self.world
        if reading is not None and reading.label != self._scene.label:
            if (self._scene.label, reading.label) == ("fault", "hold"):
                world.idle = False  # the controller was reset: the arm is active again
            self._still_ticks = 0
            self._scene.change(reading.label, self.stamp_ns)
        world.guided = self._scene.label == "gravity_compensation"  # its button is held
        world.step(self._barrett.torque(None if reading is None else reading.tau))
        self._scene.update()
        moves = self._scene.busy or world.moving or self._scene.label not in IDLE_LABELS
        self._still_ticks = 0 if moves else self._still_ticks + 1
        for frame in world.mocap_frames():
            if not self._scene.covered:
                self._on_frame(frame, self.stamp_offset_ns, world.time_ns)
        return self.state()

    def state(self) -> JointState:
        """Current state as a message: the same object every time."""
        sample, order = self.world.joint_state(), self._order
        qd = _sent(sample.qd[order], self.params.velocity)
        tau = sample.tau
        if self.params.effort == "external":
            tau = tau - self.world.arm.gravity(sample.q)
        tau = _sent(tau[order], self.params.effort)
        return self._write(self.stamp_ns, sample.q[order], qd, tau)

    def publish(self, message: JointState) -> None:
        """Publish a state, those of other devices, and in lockstep the clock if it is due."""
        if self._others is not None:
            still = np.zeros(len(self._others.joint_names))
            self._states.publish(self._others(self.stamp_ns, still, still, still))
        if self._velocities is not None:  # nameless, as Barrett's own node sends them
            qd, write = self.world.joint_state().qd, joint_messages.JointStateWriter(())
            self._velocities.publish(write(self.stamp_ns, (), qd, ()))
        self._states.publish(message)
        self.counters["states published"] += 1
        if self.params.lockstep:
            self._publish_clock(message)

    def _publish_clock(self, message: JointState) -> None:
        """Publish the stamp of a state as the time, every CLOCK_PERIOD_NS and if it is repeated."""
        stamp_ns = self.stamp_ns
        if stamp_ns - self._clock_ns >= CLOCK_PERIOD_NS or stamp_ns == self._state_ns:
            self._clocks.publish(Clock(clock=message.header.stamp))
            self._clock_ns = stamp_ns
        self._state_ns = stamp_ns

    def _on_torque(self, message: joint_messages.Command) -> None:
        try:
            params = self.params
            reading = joint_messages.torque(message, params.joint_names, params.base_frame)
        except ValueError as error:
            self.counters["torques refused"] += 1
            self.get_logger().warning(f"torque refused: {error}", throttle_duration_sec=1.0)
            fields = [getattr(message, field, ()) for field in ("data", "effort")]
            wrong = params.output != "pose" and self.world.n not in map(len, fields)
            if params.deactivates and wrong:
                self._barrett.deactivated = True
                self.get_logger().error("deactivated: the arm receives zero torques from now on")
            return
        self.on_torque(reading)

    def report(self, values: dict[str, object]) -> None:
        """Publish diagnostics with the `values` of the loop; called once a second."""
        world = self.world
        state = "idle" if world.idle else "commanded"
        state = "deactivated" if self._barrett.deactivated else state
        values |= {"frozen": world.frozen, "label": self._scene.label, **self.counters}
        values["stamp of the last [ns]"] = self.stamp_ns
        self._diagnostics.publish("ok", state, values)
