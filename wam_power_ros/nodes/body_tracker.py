# SPDX-License-Identifier: Apache-2.0
"""Tracker of one body: motion capture in; its state, and its path through a rollout, out.

Wraps `tracker.Tracker`. The path of a rollout has the frames whose stamps lie within it, whenever
they arrived. It is published once a frame at or after its end has come, or none for a while.
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from nav_msgs.msg import Odometry, Path
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

from wam_power_ros.learning.rollout import BodyPath
from wam_power_ros.params.body_tracker_params import BodyTrackerParams
from wam_power_ros.ros import endpoints, interface, node_runner, pose_messages
from wam_power_ros.ros.body_sources import BodySource
from wam_power_ros.ros.diagnostics import Diagnostics
from wam_power_ros.tracking.tracker import (
    ClockOffset,
    FrameFault,
    TrackedState,
    Tracker,
    Validity,
    free_fall_acceleration,
    late_stamps,
)

DISCOVERY_PERIOD = 0.1  # [s] between two looks for the publisher of the frames in lockstep
AT_REST = 0.05  # [m/s] of a body that rests, with the noise of its velocity
REPAIR_TIME = 5.0  # [s of wall time] in lockstep: Fast DDS's own profile repairs in 3 s
LEVELS = {Validity.OK: "ok", Validity.OCCLUDED: "warn"}  # any other validity is an error


class _Rollout(NamedTuple):
    """A finished rollout whose path has not been published yet."""

    start_ns: int
    end_ns: int
    received_ns: int  # when its end was received, by `BodyTracker._timeout_clock`


class BodyTracker(Node):
    """Publishes a state for each frame of the motion capture and a path for each rollout."""

    def __init__(self) -> None:
        super().__init__("pancake_tracker", automatically_declare_parameters_from_overrides=True)
        self._params = params = BodyTrackerParams.from_node(self)
        self._tracker = Tracker(params)
        namespace = self.get_namespace()
        self._frame = interface.frame(namespace, params.base_frame)
        self._body_frame = interface.frame(namespace, params.body)
        self._pending: _Rollout | None = None
        self._clock_offset = ClockOffset()
        self._problem = ""  # with the last refused message or path
        self._sim_time = self.get_parameter("use_sim_time").value
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timeout_clock = self.get_clock() if self._sim_time else steady
        self._first_frame_received = False
        self._frame_ns = self._timeout_clock.now().nanoseconds  # when the last frame came
        self._arrived = time.monotonic()  # when a frame or the end of a rollout last came [s]

        publish, topic = self.create_publisher, interface.body_topic(params.body, "state")
        self._states = publish(Odometry, topic, interface.STATE_OUT)
        self._paths = publish(Path, interface.rollout_topic(params.body), interface.LATCHED)
        self._diagnostics = Diagnostics(self, params.body, "motion capture")
        self._source, self._qos = BodySource(self, params), interface.MOCAP_BEST_EFFORT
        self._unmatched = ""  # publishers from which nothing is received, as text
        self._discovery = self.create_timer(DISCOVERY_PERIOD, self._discover, clock=steady)
        if not self._sim_time:
            self._subscribe_frames(interface.MOCAP_BEST_EFFORT)
        topic, then = interface.ROLLOUT_END_EFFECTOR, self._on_end_effector
        self.create_subscription(Path, topic, then, interface.LATCHED)
        self.create_timer(0.5 / params.rate, self._check_silence, clock=steady)
        self.get_logger().info(f"waiting for frames of the {params.body} on {self._source.topic}")
        self.create_timer(1.0, self._report, clock=steady)
        params.follow(self, self._accept)

    def _accept(self, params: BodyTrackerParams) -> None:
        """Track by other gates from now on, as after a start; not while a path may be under way."""
        state = self._tracker.at(self._tracker.latest_ns)
        if self._pending is not None or (state and math.hypot(*state.velocity) > AT_REST):
            raise ValueError(f"the {params.body} moves, or its path is waited for: set it at rest")
        counts, self._tracker = self._tracker.counts, Tracker(params)
        self._params, self._tracker.counts = params, counts

    def _discover(self) -> None:
        """In lockstep, subscribe to the frames once their publisher is known: reliably if it is.

        A best-effort reader of an overloaded process loses frames, and the rollout would not be the
        same as on a quiet machine.
        """
        kind = endpoints.type_name(self._source.kind)
        infos = self.get_publishers_info_by_topic(self._source.topic)
        if infos := [info for info in infos if info.topic_type == kind]:
            reliable = all(map(interface.is_reliable, infos))
            self._subscribe_frames(interface.MOCAP if reliable else interface.MOCAP_BEST_EFFORT)

    def _subscribe_frames(self, qos: QoSProfile) -> None:
        self._discovery.cancel()
        self._qos = qos
        self.create_subscription(self._source.kind, self._source.topic, self._on_frame, qos)

    def _on_frame(self, message: object) -> None:
        try:
            reading = self._source.read(message)
        except ValueError as error:
            self._refuse(error)
            return
        if reading is None:  # of other frames
            return
        stamp_ns, _, *measured = reading
        self._frame_ns = self._timeout_clock.now().nanoseconds
        self._arrived = time.monotonic()
        if not self._first_frame_received:  # logging with `once` would be slow at every frame
            self._first_frame_received = True
            self.get_logger().info("first frame received")
        if not self._sim_time:
            self._clock_offset.add(stamp_ns, self.get_clock().now().nanoseconds)
        add = self._tracker.add_markers if self._params.markers_topic else self._tracker.add
        state = add(stamp_ns, *measured)
        if state is not None:
            self._publish(state)
        elif fault := self._tracker.fault:
            self._problem = fault.value
            if fault is FrameFault.POSE_REPEATED:  # usual with some drivers; diagnostics count them
                self.get_logger().warning("repeated poses are refused; logged once", once=True)
            else:
                text = f"frame refused: {fault.value}"
                self.get_logger().warning(text, throttle_duration_sec=1.0)
        self._publish_path_if_complete()

    def _on_end_effector(self, message: Path) -> None:
        try:
            tool = pose_messages.path(message)
            if not len(tool.t):
                raise ValueError("path of the tool has no pose")
        except ValueError as error:
            self._refuse(error)
            return
        if self._pending is not None:
            self._publish_path()  # its missing frames will not come any more
        end_ns = tool.start_ns + round(float(tool.t[-1]) * 1e9)
        self._pending = _Rollout(tool.start_ns, end_ns, self._timeout_clock.now().nanoseconds)
        self._arrived = time.monotonic()
        self._publish_path_if_complete()

    def _refuse(self, error: ValueError) -> None:
        self._tracker.refuse(FrameFault.MESSAGE)
        self._problem = str(error)
        self.get_logger().warning(f"message refused: {error}", throttle_duration_sec=1.0)

    def _publish(self, state: TrackedState) -> None:
        reading = pose_messages.StateReading(state.stamp_ns, self._frame, *state[1:6])
        self._states.publish(pose_messages.odometry_message(reading, self._body_frame))

    def _check_silence(self) -> None:
        """Publish predicted states in an occlusion; end the wait for a path after `silence`.

        In lockstep, simulated time goes on while frames that were lost are sent again.
        """
        now_ns = self._timeout_clock.now().nanoseconds
        silent_ns = max(now_ns - self._frame_ns, 0)
        state = self._tracker.at(self._tracker.latest_ns + silent_ns)
        if state is not None and state.validity is Validity.OCCLUDED:
            self._publish(state)
        if self._pending is not None:
            waited_ns = min(silent_ns, now_ns - self._pending.received_ns)
            repaired = not self._sim_time or time.monotonic() - self._arrived > REPAIR_TIME
            if repaired and waited_ns > self._params.silence * 1e9:
                self._publish_path()

    def _publish_path_if_complete(self) -> None:
        if self._pending is not None and self._tracker.latest_ns >= self._pending.end_ns:
            self._publish_path()

    def _publish_path(self) -> None:
        rollout, self._pending = self._pending, None
        name = f"rollout-{rollout.start_ns}"
        path = self._tracker.path(name, rollout.start_ns, rollout.end_ns)
        down = None if self._params.tethered else free_fall_acceleration(path)
        if down is not None and down[2] > -0.87 * math.hypot(*down):  # 30 degrees
            self._log_error(
                f"the {self._params.body} falls with {down.round(1)} m/s^2 in the base frame, not "
                "along -z: correct up_axis or world_to_base"
            )
        offset, offset_max = self._clock_offset.seconds, self._params.clock_offset_max
        if abs(offset) > offset_max:
            late = f"more than {offset_max:.3f} s late; {late_stamps(offset)}"
            self._log_error(f"{name} not scored: {late}")
            path = BodyPath(name, *(np.zeros(shape) for shape in (0, (0, 3), (0, 4))))
        self._paths.publish(pose_messages.path_message(path, rollout.start_ns, self._frame))

    def _log_error(self, text: str) -> None:
        self._problem = text
        self.get_logger().error(text)

    def _report(self) -> None:
        tracker, topic = self._tracker, self._source.topic
        types = (endpoints.type_name(self._source.kind),)
        unmatched = "; ".join(endpoints.unmatched_publishers(self, topic, types, self._qos))
        if unmatched and unmatched != self._unmatched:
            self.get_logger().error(unmatched)
        self._unmatched = unmatched
        level, text = LEVELS.get(tracker.validity, "error"), tracker.validity.value
        offset, offset_max = self._clock_offset.seconds, self._params.clock_offset_max
        if not tracker.latest_ns:
            level, text = "stale", self._source.missing or "no frame yet"
        elif abs(offset) > 0.5 * offset_max:
            level = "error" if abs(offset) > offset_max else "warn"
            text = late_stamps(offset)
        if unmatched:
            level, text = "warn" if level == "ok" else "error", unmatched
        values = {
            **tracker.counts,
            "clock offset [s]": f"{offset:.4f}",
            "unmatched publishers": unmatched,
            "last problem": self._problem,
        }
        self._diagnostics.publish(level, text, values)


def main() -> int:
    """Entry point of `ros2 run wam_power_ros body_tracker`, or `pancake_tracker`."""
    return node_runner.run(BodyTracker)
