# SPDX-License-Identifier: Apache-2.0
"""WAM stand-in: torques in, joint states out, with Barrett's services and the bench around the arm.

In lockstep the world steps when the torque for the published state has come; in real time it steps
500 times a second with whatever has come (see `standins`, which keeps the pace).
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from pydantic import Field
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from hardware_sim.barrett_services import FOLDED, Driver
from hardware_sim.demonstrator import Demonstrator
from hardware_sim.scenes.flip import Flip
from hardware_sim.scenes.reach import Reach
from hardware_sim.sensors import MocapFrame, MocapSettings
from hardware_sim.settings import PERIOD, ArmSettings, SceneSettings, WorldSettings
from hardware_sim.world import World
from wam_power_ros.control.arm import Arm, Guarded
from wam_power_ros.learning import policy as policies
from wam_power_ros.params.node_params import Params
from wam_power_ros.ros import interface
from wam_power_ros.ros.deferred_service import LateTrigger

BODY = "pancake"  # that is tracked
STILL_TICKS = 50
START_TOLERANCE = 0.05  # [rad] of the arm from q_start for a reset


class WamSimParams(Params):
    """What config/wam_sim.yaml says; ranges of the world's are those of `WorldSettings`."""

    pace: Literal["lockstep", "real_time"]
    seed: int = Field(ge=0)
    realtime_priority: int = Field(ge=0, le=98)
    joint_names: tuple[str, ...] = Field(min_length=7, max_length=7)
    other_joints: tuple[str, ...]
    state_topic: str
    velocity: Literal["filled", "empty", "nan"]
    velocity_topic: str
    command_topic: str
    command_type: Literal["multiarray", "joint_state"]
    watchdog: bool
    deactivates: bool
    state_latency: float = Field(ge=0.0)
    state_jitter: float = Field(ge=0.0)
    state_loss: float = Field(ge=0.0, le=1.0)
    command_latency: float = Field(ge=0.0)
    command_jitter: float = Field(ge=0.0)
    command_loss: float = Field(ge=0.0, le=1.0)
    urdf: str
    model_joint_names: tuple[str, ...]
    tool_frame: str
    guarded_names: tuple[str, ...]
    guarded_links: tuple[str, ...]
    guarded_points: tuple[float, ...]
    home: tuple[float, ...]
    drives: Literal["wam", "direct"]
    bus_voltage: float
    command_delay_ticks: int
    driver_compensates_gravity: bool
    hand: Literal["flip", "reach"]
    friction: float
    pancake_offset_sd: float
    wind_sd: float
    torque_scale_sd: float
    friction_sd: float

    def world(self, mocap: MocapSettings) -> WorldSettings:
        """The part that concerns the world."""
        own = {field.name for field in dataclasses.fields(WorldSettings)} & set(self.model_fields)
        return WorldSettings(
            **{name: getattr(self, name) for name in own},
            scene=SceneSettings(self.friction, self.pancake_offset_sd),
            mocap=mocap,
            arm=ArmSettings(
                self.urdf,
                self.model_joint_names,
                self.tool_frame,
                self._guarded(),
                self.home,
                self.drives,
            ),
        )

    def _guarded(self) -> tuple[Guarded, ...]:
        if self.guarded_names == ("",):  # none: the tool stands for them
            return (Guarded("tool", self.tool_frame, (0.0, 0.0, 0.0)),)
        offsets = np.reshape(self.guarded_points, (-1, 3)).tolist()
        points = zip(self.guarded_names, self.guarded_links, offsets, strict=True)
        return tuple(Guarded(*point) for point in points)


class WamSim(Node):
    """The arm as its driver shows it."""

    def __init__(self) -> None:
        super().__init__("wam_sim", automatically_declare_parameters_from_overrides=True)
        self.params = params = WamSimParams.of(self)
        self.on_torque: Callable[[interface.TorqueReading], None] = lambda reading: None
        self.counters: Counter[str] = Counter()
        self._skill = {"flip": Flip, "reach": Reach}[params.hand](SceneSettings())
        self._label = ""
        self._policy: policies.Policy | None = None
        self._demonstrations = 0
        self._pulling = False
        self._ticks_left = 0  # until a service may be answered
        self._deactivated = False  # as a ros2_control controller after a command it cannot take
        self._settling: Iterator[None] = iter(())  # of the world that is being put back
        self._settled = True

        qos = interface.STATE_OUT_DEEP
        self._states = self.create_publisher(JointState, params.state_topic, qos)
        self._velocities = None
        if params.velocity_topic:
            self._velocities = self.create_publisher(JointState, params.velocity_topic, qos)
        others = [name for name in params.other_joints if name]
        self._others = interface.JointStateWriter(others) if others else None
        self._clocks = self.create_publisher(Clock, interface.CLOCK, interface.CLOCK_QOS)
        self._truth = self.create_publisher(
            String, interface.body_topic(BODY, "truth"), interface.LATCHED
        )
        self._description = self.create_publisher(
            String, interface.ROBOT_DESCRIPTION, interface.LATCHED
        )
        self._diagnostics = self.create_publisher(
            DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS
        )
        self._write = interface.JointStateWriter(params.joint_names)
        message_type = interface.COMMAND_TYPES[params.command_type]
        self.create_subscription(
            message_type, params.command_topic, self._on_torque, interface.COMMAND
        )
        self.create_subscription(String, interface.POLICY, self._on_policy, interface.LATCHED)

    def attach(self, world: World, on_frame: Callable[[MocapFrame, int, int], None]) -> None:
        """Take charge of a world; `on_frame` gets its frames, the stamp offset and the time."""
        self.world, self._on_frame = world, on_frame
        lockstep = self.params.pace == "lockstep"
        # in real time the stamps are those of the system clock, as a driver's are
        self.stamp_offset_ns = 0 if lockstep else time.time_ns() - world.time_ns
        self.lockstep = lockstep
        self._is_wam = self.params.drives == "wam"
        compensates = self.params.driver_compensates_gravity
        self._driver = Driver(
            Arm(world.urdf, self.params.model_joint_names, self.params.tool_frame, guarded=()),
            compensates,
            PERIOD,
        )
        self._description.publish(String(data=world.urdf))
        serve = self.create_service
        serve(SetBool, interface.WAM_GRAVITY_COMPENSATE, self._on_gravity_compensate)
        serve(SetBool, interface.WAM_HOLD, self._on_hold)
        serve(Trigger, interface.WAM_IDLE, self._on_idle)
        serve(Trigger, interface.body_topic(BODY, "drop"), self._on_drop)
        self._home = LateTrigger(self, interface.WAM_MOVE_HOME, self._begin_home)
        self._reset = LateTrigger(self, interface.body_topic(BODY, "reset"), self._begin_reset)
        self._hand = LateTrigger(self, interface.HAND_DEMONSTRATE, self._begin_demonstration)

    # The tick

    @property
    def stamp_ns(self) -> int:
        """Stamp of the present state [ns]."""
        return self.world.time_ns + self.stamp_offset_ns

    def tick(self, reading: interface.TorqueReading | None) -> JointState:
        """Step the world with the newest torque, None if nothing new has come.

        Returns:
            The state after it: the same message object every time.
        """
        world = self.world
        if reading is not None and reading.label != self._label:
            self._change(reading.label)
        tau = None if reading is None else reading.tau
        if self._deactivated:
            tau = np.zeros(len(self.params.joint_names))
        if self._driver.engaged:
            sample = world.joint_state()
            tau = self._driver.torque(sample.q, sample.qd)
        world.step(tau)
        self._attend()
        for frame in world.mocap_frames():
            self._on_frame(frame, self.stamp_offset_ns, world.time_ns)
        return self.state()

    def state(self) -> JointState:
        """The present state as a message: the same object every time."""
        sample, how = self.world.joint_state(), self.params.velocity
        qd = sample.qd if how == "filled" else np.full(7, np.nan) if how == "nan" else ()
        return self._write(self.stamp_ns, sample.q, qd, sample.tau)

    def publish(self, message: JointState) -> None:
        """Send a state and what comes beside it, and in lockstep the clock."""
        if self._others is not None:
            still = np.zeros(len(self._others.joint_names))
            self._states.publish(self._others(self.stamp_ns, still, still, still))
        if self._velocities is not None:  # nameless, as Barrett's own node sends them
            qd = self.world.joint_state().qd
            self._velocities.publish(interface.nameless_velocities(self.stamp_ns, qd))
        self._states.publish(message)
        self.counters["states published"] += 1
        if self.lockstep:
            self._clocks.publish(Clock(clock=message.header.stamp))

    def _change(self, label: str) -> None:
        """The controller does something else: a rollout begins or ends with that very tick."""
        was, self._label = self._label, label
        if was == "fault" and label == "hold":  # who resets the controller has activated the arm
            self.world.idle = False
        if self.world.frozen and self._settled and label not in ("hold", "inactive"):
            self.world.release()
        if was.startswith("rollout "):
            truth = json.dumps(self.world.truth())
            self._truth.publish(String(data=truth))

    def _on_torque(self, message: Float64MultiArray | JointState) -> None:
        try:
            reading = interface.torque(message, self.params.joint_names)
        except ValueError as error:
            self.counters["torques refused"] += 1
            self.get_logger().warning(f"refused: {error}", throttle_duration_sec=1.0)
            sized = len(getattr(message, "data", self.params.joint_names))
            if self.params.deactivates and sized != len(self.params.joint_names):
                self._deactivated = True
                self.get_logger().error("deactivated: only zeros reach the arm now")
            return
        self.on_torque(reading)

    # The bench

    def _on_policy(self, message: String) -> None:
        try:
            self._policy = policies.from_json(message.data)
        except ValueError as error:
            self.counters["policies refused"] += 1
            self.get_logger().warning(f"policy refused: {error}")

    def _begin_reset(self) -> str | None:
        """Pancake into the pan; in lockstep the world then waits, frozen, for what comes next.

        While teaching, the arm is led back to where demonstrations begin as well.
        """
        policy, world = self._policy, self.world
        if self._label == "gravity_compensation" and not world.pulled and self._is_wam:
            self._put_back(*self._next_demonstration())
            return None
        if policy is None or len(policy.q_start) != 7:
            return "refused: no policy for this arm has come"
        if world.pulled or self._label not in ("", "inactive", "hold", "move_to_start"):
            return f"refused: the arm is in use (mode {self._label!r})"
        far = np.abs(world.joint_state().q - policy.q_start).max()
        if far > START_TOLERANCE:
            return f"refused: the arm is {far:.3f} rad from the start of {policy.id}"
        self._put_back(policy.id, policy.q_start)
        return None

    def _on_drop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = not (self.lockstep or self.world.pulled)
        if response.success:
            self.world.drop()
        else:
            response.message = "refused: only in real time, and while nobody leads the arm"
        return response

    def _put_back(self, name: str, q: np.ndarray) -> None:
        """At once in lockstep; else the clock goes on, and with it the states."""
        if self.lockstep:
            self.world.reset(name, q)
        else:
            self._settling, self._settled = self.world.resetting(name, q), False
        self._ticks_left = STILL_TICKS

    def _begin_demonstration(self) -> str | None:
        self._ticks_left = STILL_TICKS
        if not self._is_wam:
            return "refused: the hand knows the WAM's postures only"
        return "refused: the hand is at work" if self.world.pulled else None

    def _attend(self) -> None:
        """Go on with what a service has asked for, once a tick."""
        world, waited = self.world, self._ticks_left == 0
        self._ticks_left = max(0, self._ticks_left - 1)
        if not self._settled and next(self._settling, self) is self:
            self._settled = True
            world.release()
        if self._home.pending and (self._driver.arrived or not self._driver.engaged):
            arrived = self._driver.arrived
            self._home.finish(arrived, "at home" if arrived else "interrupted")
        if self._reset.pending and waited and self._settled:  # the controller is at rest by now
            self._reset.finish(True, world.rollout_id)
        if self._hand.pending and not self._pulling:
            free = self._label == "gravity_compensation" and not self._driver.engaged
            if free:
                if self._settled:
                    self._take_pan()
            elif waited:
                self._hand.finish(False, f"refused: the arm is not free (mode {self._label!r})")
        elif self._pulling and not world.pulled:
            self._pulling = False
            self._demonstrations += 1
            self._hand.finish(True, world.rollout_id)

    def _take_pan(self) -> None:
        """The hand, another one each time, begins its demonstration."""
        world = self.world
        name, home = self._next_demonstration()
        if world.rollout_id != name:  # the jump back to the start is for /pancake/reset to make
            world.reset(name, home)
        rng = np.random.default_rng((self.params.seed, self._demonstrations))
        if world.frozen:
            world.release()
        world.attach(Demonstrator(self._skill.script(rng), *world.pan_pose))
        self._pulling = True

    def _next_demonstration(self) -> tuple[str, np.ndarray]:
        """Name and first posture (7,) [rad] of the demonstration that is to come."""
        skill, number = self._skill, self._demonstrations
        rng = np.random.default_rng((self.params.seed, number, 1))
        home = skill.home + skill.home_sd * rng.standard_normal(len(skill.home))
        return f"demonstration-{number}", home

    # Barrett's services

    def _on_gravity_compensate(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        """On: torque commands reach the arm. Off: as idle."""
        self._driver.release()
        self._deactivated = False
        self.world.idle = not request.data
        response.success = True
        return response

    def _on_hold(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        q = self.world.joint_state().q
        self.world.idle = False
        self._driver.move(q, q) if request.data else self._driver.release()
        response.success = True
        return response

    def _on_idle(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._driver.release()
        self.world.idle = True
        response.success = True
        return response

    def _begin_home(self) -> str | None:
        if not self._settled:
            return "refused: the pancake is being put back"
        if self.world.frozen:  # between rollouts in lockstep
            self.world.release()
        self.world.idle = False
        folded = FOLDED if self._is_wam else np.array(self.params.home)
        self._driver.move(self.world.joint_state().q, folded)
        return None

    def report(self, values: dict[str, object]) -> None:
        """Diagnostics, once a second; `values` are those of the loop."""
        world = self.world
        doing = "idle" if world.idle else "own motion" if self._driver.engaged else "commanded"
        doing = "deactivated" if self._deactivated else doing
        values |= {"frozen": world.frozen, "label": self._label, **self.counters}
        values["stamp of the last [ns]"] = self.stamp_ns
        now = self.get_clock().now().to_msg()
        self._diagnostics.publish(
            interface.diagnostics(now, "wam_sim: loop", "stand-in", "ok", doing, values)
        )
