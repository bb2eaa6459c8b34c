# SPDX-License-Identifier: Apache-2.0
"""Demonstration recorder: `recorder/record` true begins a bag, false ends it.

Messages are received serialised and written by another thread, never decoded. A bag is named
`rollout_<id>` if the rollout of a policy is to come, else `<stem>_<date>_<time>`.
"""

from __future__ import annotations

import itertools
import json
import math
import shutil
import struct
import time
from array import array
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Literal

from pydantic import Field
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import SetBool

from wam_power_interfaces.msg import Policy, RolloutEnd
from wam_power_ros import __version__, arm_identity
from wam_power_ros.bags import layout
from wam_power_ros.bags.background_writer import Recording
from wam_power_ros.bags.quality import gaps
from wam_power_ros.bags.writer import header_stamp
from wam_power_ros.control.arm import Arm
from wam_power_ros.durable_files import explained
from wam_power_ros.learning.policy import check_id
from wam_power_ros.params.body_tracker_params import MESSAGE_TYPES
from wam_power_ros.params.node_params import Names, Params
from wam_power_ros.params.resources import robot_description
from wam_power_ros.params.torque_controller_params import PositionLimits
from wam_power_ros.ros import interface, node_runner, scheduling
from wam_power_ros.ros.diagnostics import Diagnostics
from wam_power_ros.ros.outcomes import Answer, Code, fill
from wam_power_ros.ros.raw_subscriptions import RawTopics

MEGABYTE = 1_000_000
MEGABYTES = "in MB: 0 requires none; at most a petabyte"
PATH_TIMEOUT = 1.0  # longest wait for the path of the body in a finished rollout [s]
STATES_TIMEOUT = 5.0  # longest wait for states in lockstep; some DDS profiles repair in 3 s [s]
DISK_CHECK_PERIOD = 0.1  # [s] between checks for write errors and free space


class DemonstrationRecorderParams(Params):
    """Parameters of the node; the values are in config/demonstration_recorder.yaml."""

    file = "demonstration_recorder.yaml"

    directory: str
    realtime_priority: int = Field(ge=0, le=98, description="99 is for the kernel's own threads")
    stem: str = Field(min_length=1, pattern=r"^[A-Za-z0-9-]+$")
    body: str  # name of the tracked body; empty for none
    state_topic: str
    driver_topics: Names
    mocap_topics: Names
    topics: Names
    latched_topics: Names
    joint_names: Names
    model_joint_names: Names  # the same in the URDF
    urdf: str  # path, or a file of our share folder; empty: bags do not name their arm
    base_frame: str  # link, see the controller's
    tool_frame: str
    position_limits: PositionLimits
    source: Literal["sim", "hardware"]
    free_to_start: float = Field(ge=0.0, le=1e9, description=MEGABYTES)
    free_to_continue: float = Field(ge=0.0, le=1e9, description=MEGABYTES)


class DemonstrationRecorder(Node):
    """One bag per recording."""

    def __init__(self) -> None:
        name = "demonstration_recorder"
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self._params = params = DemonstrationRecorderParams.from_node(self)
        self._arm = ""  # identity of the arm, as JSON
        if params.urdf:
            urdf = robot_description(params.urdf)
            names, tool, base = params.model_joint_names, params.tool_frame, params.base_frame
            arm = Arm(urdf, names, tool, (), None, base, params.position_limits)
            self._arm = arm_identity.to_json(arm.identity())
        self._directory = Path(params.directory).expanduser().absolute()
        self._recording: Recording | None = None
        self._latched_messages: dict[str, bytes] = {}  # by topic
        self._policy_id = ""  # of a policy whose rollout is to be recorded
        self._error = ""  # why a recording ended early
        self._warning = ""  # about the last bag

        self._state_topic = self.resolve_topic_name(params.state_topic)
        self._latched = {self.resolve_topic_name(topic) for topic in params.latched_topics}
        devices = (params.state_topic, *params.driver_topics, *params.mocap_topics)
        state, path = "", ""
        if params.body:
            state = interface.body_topic(params.body, "state")
            path = interface.rollout_topic(params.body)
        self._body_path_topic = path and self.resolve_topic_name(path)  # empty without a body
        names = (*devices, *params.topics, state, path, *params.latched_topics)
        topics: dict[str, tuple[str, ...]] = dict.fromkeys(names, ())
        topics |= dict.fromkeys(params.mocap_topics, MESSAGE_TYPES)
        topics[params.state_topic] = (layout.JOINT_STATE,)
        topics.pop("", None)  # an empty list in ROS parameters is [""]
        self._sim_time = self.get_parameter("use_sim_time").value
        self._state_ns = 0  # stamp of the newest state
        self._stamps = array("q")  # of the states in the recording
        joint = f"{params.joint_names[0]}\0".encode()
        self._joint = struct.pack("<I", len(joint)) + joint  # in a state of the arm
        if self._sim_time:
            topics[interface.CLOCK] = ()
        self._topics = RawTopics(self, topics, self._on_message)
        subscribe, latched = self.create_subscription, interface.LATCHED
        subscribe(Policy, interface.POLICY, self._on_policy, latched)
        subscribe(RolloutEnd, interface.ROLLOUT_END, self._on_end, latched)
        self._diagnostics = Diagnostics(self, "bag", "disk")
        self.create_service(SetBool, interface.RECORD, self._on_record)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DISK_CHECK_PERIOD, self._check_disk, clock=steady)
        self.create_timer(1.0, self._report, clock=steady)
        self.get_logger().info(
            f"waiting for {self.resolve_service_name(interface.RECORD)}; bags go to "
            f"{self._directory}; topics: {', '.join(self._topics.names)}"
        )
        # A driver queues only ten states for a late reader; in lockstep all are queued.
        self._granted = scheduling.request(0 if self._sim_time else params.realtime_priority)
        for bag in sorted(self._directory.glob(f"*{layout.UNFINISHED}")):
            finished = bag.with_name(bag.name.removesuffix(layout.UNFINISHED))
            advice = f"to recover it: wam-power recover {finished}"
            self.get_logger().warning(f"{bag} was never closed; {advice}")

    def _now(self) -> int:
        """Time of reception [ns]: system time, in lockstep the stamp of the newest state.

        In lockstep the simulation and /clock run ahead of a late recorder, but states come in
        order, so that a bag is played at the speed of the arm.
        """
        if not self._sim_time:
            return time.time_ns()
        return self._state_ns or self.get_clock().now().nanoseconds

    def _on_message(self, topic: str, cdr: bytes) -> None:
        if topic == self._state_topic and self._joint in cdr:
            self._state_ns = header_stamp(cdr)  # a message with the name holds at least 12 bytes
            if self._recording is not None:
                self._stamps.append(self._state_ns)
        if topic in self._latched:
            self._latched_messages[topic] = cdr
        if self._recording is not None:
            self._write(topic, cdr)

    def _on_policy(self, message: Policy) -> None:
        try:
            check_id(message.id)  # will be the name of a file
            self._policy_id = message.id
        except ValueError as error:
            self.get_logger().warning(f"policy refused: {error}", throttle_duration_sec=1.0)

    def _on_end(self, message: RolloutEnd) -> None:
        if message.policy_id == self._policy_id:  # or the next recording would be named after it
            self._policy_id = ""

    def _on_record(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            answer = self._start() if request.data else self._stop(layout.STOP_REQUESTED)
        except (OSError, ValueError) as error:
            text = explained(error) if isinstance(error, OSError) else str(error)
            answer = Answer(Code.REFUSED, text)
        if not answer.success:
            self.get_logger().warning(f"request refused: {answer.text}")
        return fill(response, answer)

    def _start(self) -> Answer:
        """Begin a bag; the text of the answer is its path."""
        if self._recording is not None:
            return Answer(Code.BUSY, f"already recording {self._recording.path}")
        self._directory.mkdir(parents=True, exist_ok=True)
        if (free := self._free()) < (needed := self._params.free_to_start):
            place = f"{free:.0f} MB free on the disk of {self._directory}"
            return Answer(Code.REFUSED, f"{place}, {needed:.0f} MB needed: free some space")
        self._topics.discover()
        self._topics.take()  # what came before the request does not belong into the bag
        kind = "rollout" if self._policy_id else self._params.stem
        stem = self._policy_id or f"{datetime.now():%Y%m%d_%H%M%S}"
        path = layout.free_path(self._directory, f"{kind}_{stem}")
        self._recording = Recording(path, kind, self._notes, self._now)
        self._stamps = array("q")
        self._policy_id = self._error = self._warning = ""
        for topic, cdr in self._latched_messages.items():
            self._write(topic, cdr)
        self.get_logger().info(f"recording {path}")
        return Answer(Code.DONE, str(path))

    def _stop(self, reason: str) -> Answer:
        """Close the bag; the text of the answer is its path."""
        recording = self._recording
        if recording is None:
            return Answer(Code.NOTHING, "not recording")
        self._take_pending(recording)
        try:
            recording.close(reason, self._notes)
        except OSError as error:
            self._abandon(error)
            raise
        self._recording = None
        count = sum(recording.counts.values())
        self.get_logger().info(f"recorded {recording.path}: {count} messages")
        if (states := gaps(self._stamps)).missing:
            longest = f"longest gap {states.longest:.3f} s"
            self._warning = f"{states.missing} messages missing on {self._state_topic}, {longest}"
            self.get_logger().warning(self._warning)
        return Answer(Code.DONE, str(recording.path))

    def _take_pending(self, recording: Recording) -> None:
        """Write the messages that have arrived but were not dispatched yet.

        Waits for the path of the body in a finished rollout, which the learner, who ends the
        recording, may have before this node; in lockstep also for all states up to the request.
        """
        now_ns, path = self.get_clock().now().nanoseconds, self._body_path_topic
        tool_path = self.resolve_topic_name(interface.ROLLOUT_END_EFFECTOR)
        late = lambda: self._sim_time and 0 < self._state_ns < now_ns  # noqa: E731
        lacking = lambda: path and tool_path in recording and path not in recording  # noqa: E731
        begun = time.monotonic()
        self._topics.take()
        for awaited, timeout in ((late, STATES_TIMEOUT), (lacking, PATH_TIMEOUT)):
            while awaited() and time.monotonic() - begun <= timeout:
                time.sleep(0.01)
                self._topics.take()

    def _write(self, topic: str, cdr: bytes) -> None:
        if topic not in self._recording:
            self._recording.add(topic, *self._topics.layout_of(topic))
        self._recording.write(topic, cdr)

    @property
    def _notes(self) -> dict[str, str]:
        return {
            "joint_names": json.dumps(self._params.joint_names),
            **({"arm": self._arm} if self._arm else {}),
            "state_topic": self._state_topic,
            "source": self._params.source,
            "version": f"wam_power_ros {__version__}",
        }

    def _free(self) -> float:
        return shutil.disk_usage(self._directory).free / MEGABYTE

    def _abandon(self, error: OSError) -> None:
        """Leave the bag unfinished; the node goes on, since nothing else depends on the disk."""
        path, self._recording = self._recording.path, None
        with_file = OSError(error.errno, error.strerror, str(path)) if error.errno else error
        self._error = f"bag left unfinished: {explained(with_file)}; then wam-power recover {path}"
        self.get_logger().error(self._error)
        self._report()

    def _check_disk(self) -> None:
        """End the recording after a write error, or when the disk is nearly full."""
        recording = self._recording
        if recording is None:
            return
        free = math.inf
        try:
            free = self._free()
        except OSError as error:  # the folder is gone, as on a disk that was unplugged
            recording.error = recording.error or error
        if recording.error is not None:
            self._abandon(recording.error)
        elif free < self._params.free_to_continue:
            with suppress(OSError):  # logged already
                self._stop("disk nearly full")
                needed = self._params.free_to_continue
                self._error = f"stopped below {needed:.0f} MB free in {self._directory}"

    def _report(self) -> None:
        recording = self._recording
        counts = recording.counts if recording else {}
        level, text = "ok", f"recording {recording.path}" if recording else "idle"
        unmatched = "; ".join(itertools.chain(*self._topics.unmatched.values()))
        if self._error:
            level, text = "error", self._error
        elif self._warning:
            level, text = "warn", self._warning
        elif unmatched:
            level, text = "warn", f"not recorded: {unmatched}"
        elif recording and self._state_topic not in recording:
            level, text = "warn", f"no message on {self._state_topic} yet"
        values = {
            **counts,
            "without a message": [topic for topic in self._topics.names if topic not in counts],
            "unmatched publishers": unmatched,
            "waiting for the disk": recording.waiting if recording else 0,
            "real-time scheduling": self._granted.scheduling,
        }
        self._diagnostics.publish(level, text, values)

    def close(self) -> None:
        """Finish the bag before the process ends."""
        if self._recording is not None:
            try:
                self._stop("shutdown")
            except OSError as error:
                self.get_logger().error(f"bag not closed: {explained(error)}")


def main() -> int:
    """Entry point of `ros2 run wam_power_ros demonstration_recorder`."""
    return node_runner.run(DemonstrationRecorder)
