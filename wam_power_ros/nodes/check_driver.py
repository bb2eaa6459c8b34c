# SPDX-License-Identifier: Apache-2.0
"""Check of the drivers before any node is activated: prints a table and a verdict.

Receives what controller and tracker would receive and asks a person questions. Torques are sent
only with consent, and none that could move the arm. The modules in `conformance` make the rows.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.utilities import remove_ros_args
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from wam_power_ros.client.link import Link
from wam_power_ros.conformance import arm_checks, mocap_checks, topic_checks
from wam_power_ros.conformance.arm_checks import ArmRecord, StateSample
from wam_power_ros.conformance.mocap_checks import CloudSample, FrameSample
from wam_power_ros.conformance.topic_checks import Endpoint, Row, Verdict
from wam_power_ros.conformance.watchdog_check import CommandCheck
from wam_power_ros.control.arm import Arm
from wam_power_ros.params import overlay
from wam_power_ros.params.body_tracker_params import BodyTrackerParams
from wam_power_ros.params.resources import robot_description
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.ros import endpoints, interface, joint_messages, node_runner, scheduling
from wam_power_ros.ros.body_sources import BodySource
from wam_power_ros.ros.guards import Info, StateGuard, with_info
from wam_power_ros.ros.interface import is_latched, is_reliable
from wam_power_ros.ros.pose_messages import MarkersReading
from wam_power_ros.ros.stamps import nanoseconds

Input = tuple[str, tuple[str, ...], QoSProfile]  # topic, expected type, and QoS
OWN_NODES = {"torque_controller", "demonstration_recorder", "check_driver"}  # not to be checked
DISCOVERY_TIMEOUT = 5.0  # [s] for discovery, and for the next message
DROP_ATTEMPTS = 3  # with the stand-in: a busy machine may miss frames of a fall
FALL_TIME = 2.0  # [s] in which a released body falls to the ground
# Of base and tool: of cartesian_controllers, and of crisp_controllers
FRAME_PARAMETERS = (("robot_base_link", "end_effector_link"), ("base_frame", "end_effector_frame"))
COLOURS = {
    Verdict.OK: "green",
    Verdict.WARN: "yellow",
    Verdict.FAIL: "bold red",
    Verdict.UNCHECKED: "dim",
}


class CheckDriver(Node):
    """Subscribes to the devices of one set-up and checks them."""

    def __init__(
        self, arm: TorqueControllerParams, mocap: BodyTrackerParams, console: Console
    ) -> None:
        super().__init__("check_driver")
        self._arm_params, self._mocap, self._console = arm, mocap, console
        self._recording = self._input_ended = False
        self._read = joint_messages.JointStateReader(arm.joint_names)
        self._state_guard = StateGuard(self, arm.state_topic)
        self._velocity_guard = StateGuard(self, arm.velocity_topic or arm.state_topic)
        self._second = ""  # sentence on publishers of the same states or velocities
        self.states: list[StateSample] = []
        self.velocities: list[tuple[int, np.ndarray]] = []
        self.frames: list[FrameSample] = []
        self.clouds: list[CloudSample] = []
        self._refused: Counter[str] = Counter()  # by reason
        self._urdf = robot_description(arm.urdf) if arm.urdf else ""
        self._send_torque: Callable[[StateSample], None] | None = None
        self._command_type = joint_messages.COMMAND_TYPES[arm.message]
        subscribe = self._subscribe
        self._state_input = subscribe(JointState, arm.state_topic, self._on_state)
        if arm.velocity_topic:
            self._velocity_input = subscribe(JointState, arm.velocity_topic, self._on_velocity)
        if not arm.urdf:
            described = interface.ROBOT_DESCRIPTION, self._on_urdf, interface.LATCHED
            self.create_subscription(String, *described)
        self._torques: list[object] = []
        command = arm.command_topic, self._torques.append, interface.DEEP_IN
        self._listener = self.create_subscription(self._command_type, *command)
        scheduling.request(arm.realtime_priority)  # as in the controller, to measure its jitter
        self.link = Link(self)
        self._mocap_input: Input | None = None
        if mocap.body:  # else the task tracks nothing
            self._source = BodySource(self, mocap)
            self._mocap_input = subscribe(self._source.kind, mocap.topic, self._on_frame)
            self._drop = interface.body_topic(mocap.body, "drop")
            self.link.prepare(self._drop)

    # Callbacks, of the link's thread; messages count only while the check waits

    def _subscribe(self, kind: type, topic: str, then: Callable[[Any, Info], None]) -> Input:
        counted = lambda message, info: self._recording and then(message, info)  # noqa: E731
        self.create_subscription(kind, topic, with_info(counted), interface.DEEP_IN)
        return topic, (endpoints.type_name(kind),), interface.DEEP_IN

    def _follow(self, guard: StateGuard, info: Info) -> None:
        if not guard.follows(info):
            self._second = guard.second_publisher() or ""

    def _on_state(self, message: JointState, info: Info) -> None:
        if not set(message.name).isdisjoint(self._arm_params.joint_names):
            self._follow(self._state_guard, info)
        q, qd, tau = (np.array(v) for v in (message.position, message.velocity, message.effort))
        stamp_ns = nanoseconds(message.header.stamp)
        sample = StateSample(time.time_ns(), stamp_ns, tuple(message.name), q, qd, tau)
        self.states.append(sample)
        if self._send_torque is not None:
            self._send_torque(sample)

    def _on_velocity(self, message: JointState, info: Info) -> None:
        try:
            qd = self._read.velocity(message)
        except ValueError:
            return
        if qd is not None:
            self._follow(self._velocity_guard, info)
            self.velocities.append((time.time_ns(), qd))

    def _on_frame(self, message: object, _: Info) -> None:
        try:
            reading = self._source.read(message)
        except ValueError as error:
            self._refused[str(error).partition(":")[0]] += 1  # the values differ
            return
        if isinstance(reading, MarkersReading):
            self.clouds.append(CloudSample(time.time_ns(), reading.stamp_ns, reading.points))
        elif reading is not None:
            self.frames.append(FrameSample(time.time_ns(), reading.stamp_ns, *reading[2:]))

    def _on_urdf(self, message: String) -> None:
        self._urdf = message.data

    # Waiting

    def wait(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Wait for some time [s], or until a condition holds; messages are received meanwhile."""
        self._recording = True
        self.link.until(until, timeout=seconds)
        self._recording = False

    def ask(self, question: str) -> str | None:
        """Ask a person; None when standard input has ended."""
        if self._input_ended:
            return None
        self._console.print(question)
        self._recording = True
        line = sys.stdin.readline()
        self._recording = False
        self._input_ended = not line
        return line.strip() if line else None

    # Rows

    def check(self, seconds: float, active: bool) -> list[Row]:
        """Record for `seconds` [s] and make all rows; `active` is consent to the watchdog test."""
        cameras = self._mocap_input
        heard = lambda: self.states and (cameras is None or self.frames or self.clouds)  # noqa: E731
        self.wait(DISCOVERY_TIMEOUT, heard)
        for samples in (self.states, self.velocities, self.frames, self.clouds, self._refused):
            samples.clear()
        still = "leave the arm at rest and the body still, in view"
        self._console.print(f"Recording for {seconds:.0f} s: {still}.")
        self.wait(seconds)
        inputs = [each for each in (self._state_input, cameras) if each is not None]
        found = any(endpoints.unmatched_publishers(self, *each) for each in inputs)
        if cameras is not None and (missing := self._source.missing):
            self._refused[missing] += 1
        if not (self.states or self.frames or self.clouds or self._refused or found):
            topics = " nor on ".join(self.resolve_topic_name(each[0]) for each in inputs)
            raise ValueError(
                f"no messages on {topics}: start the drivers, with the same ROS_DOMAIN_ID and "
                "ROS_AUTOMATIC_DISCOVERY_RANGE as this check"
            )
        if not self._urdf:
            described = interface.ROBOT_DESCRIPTION, ("std_msgs/msg/String",), interface.LATCHED
            topic = self.resolve_topic_name(interface.ROBOT_DESCRIPTION)
            unmatched = "; ".join(endpoints.unmatched_publishers(self, *described))
            advice = unmatched or "publish the URDF there, or set the parameter urdf"
            raise ValueError(f"no message on {topic}: {advice}")
        arm = self._arm_params.arm(self._urdf)
        rows, record = self._arm_rows(arm, seconds)
        path = self._command_path()
        mocap = self._mocap_rows(arm, record, seconds)
        asked = {"multiarray": self._torque_order, "pose": self._pose_frames}
        order = [ask() for kind, ask in asked.items() if kind == self._arm_params.message]
        rows += [path, *order, self._watchdog(arm, record, path, active), self._service()]
        frozen = any(row.name == "mocap frozen" and row.verdict is Verdict.FAIL for row in mocap)
        fall = [] if frozen or not (self.frames or self.clouds) else [self._fall()]
        return [*rows, *mocap, *fall, *self._by_hand(arm, record)]

    def _arm_rows(self, arm: Arm, seconds: float) -> tuple[list[Row], ArmRecord]:
        params = self._arm_params
        received = self._reception("state", len(self.states), seconds, self._state_input)
        velocity: list[Row] = []
        record, names = arm_checks.collect(self.states, params.joint_names)
        if not len(record.q):
            return [*received, names] if self.states else received, record
        if params.velocity_topic:
            received_ns, qd = (np.array([v[i] for v in self.velocities]) for i in (0, 1))
            record = arm_checks.with_velocity(record, received_ns, qd)
            velocity = [self._match("velocity QoS", self._velocity_input)]
        return [
            received[0],
            names,
            received[1],
            arm_checks.one_publisher(self.resolve_topic_name(params.state_topic), self._second),
            topic_checks.rate("state rate", record.stamp_ns, 1.0 / params.period),
            topic_checks.jitter("state jitter", record.received_ns, params.period),
            topic_checks.stamps("state stamps", record.stamp_ns),
            topic_checks.stamp_jitter("stamp jitter", record.stamp_ns),
            topic_checks.clock("state clock", record.received_ns, record.stamp_ns),
            arm_checks.positions(record, arm),
            *velocity,
            arm_checks.velocity(record, params.velocity_topic),
            arm_checks.effort(record, params.effort),
            arm_checks.gravity(record, arm, params.effort),
        ], record

    def _command_path(self) -> Row:
        topic = self.resolve_topic_name(self._arm_params.command_topic)
        ends = self.get_subscriptions_info_by_topic(topic), self.get_publishers_info_by_topic(topic)
        kind = endpoints.type_name(self._command_type)
        unmatched, _ = endpoints.unmatched_subscriptions(self, topic, kind, interface.COMMAND)
        count, ends = len(self._torques), map(_ends, ends)
        return topic_checks.command_path(topic, kind, *ends, count, unmatched)

    def _torque_order(self) -> Row:
        """Row about the order of the driver, asked for its parameters if it is a forwarder."""
        params, driver, found = self._arm_params, "the driver", ((), "")
        for name in self._drivers():
            values = self.link.parameters(name, ("joints", "interface_name"), DISCOVERY_TIMEOUT)
            if len(values) == 2:
                driver, found = name, (values[0].string_array_value, values[1].string_value)
                break
        expected = "effort" if params.output == "torque" else "position"
        return topic_checks.torque_order(driver, *found, params.joint_names, expected)

    def _pose_frames(self) -> Row:
        """Row about the frames of a driver of poses, asked for its parameters."""
        expected = self._arm_params.base_frame, self._arm_params.tool_frame
        for driver, names in itertools.product(self._drivers(), FRAME_PARAMETERS):
            values = self.link.parameters(driver, names, DISCOVERY_TIMEOUT)
            frames = [value.string_value for value in values]
            if len(frames) == 2 and all(frames):
                return topic_checks.pose_frames(driver, frames, expected)
        return topic_checks.pose_frames("the driver", (), expected)

    def _drivers(self) -> list[str]:
        topic = self.resolve_topic_name(self._arm_params.command_topic)
        return [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self.get_subscriptions_info_by_topic(topic)
            if info.node_name not in OWN_NODES
        ]

    def _service(self) -> Row:
        services = {name: types[0] for name, types in self.get_service_names_and_types()}
        idle = self._arm_params.idle_service
        wanted = idle and self.resolve_service_name(idle)
        return topic_checks.service("idle service", "std_srvs/srv/Trigger", services, wanted)

    def _mocap_rows(self, arm: Arm, record: ArmRecord, seconds: float) -> list[Row]:
        params = self._mocap
        if self._mocap_input is None:
            return []
        samples = self.clouds or self.frames
        count = len(samples) + self._refused.total()
        reception = self._reception("mocap", count, seconds, self._mocap_input)
        if not samples:
            refused = mocap_checks.frame_quality([], params, self._refused)
            return [*reception, *refused] if self._refused else reception
        received, stamp_ns = (np.array([sample[i] for sample in samples]) for i in (0, 1))
        age = float(np.median(record.received_ns - record.stamp_ns)) if len(record.q) else 0.0
        tool = arm.tool_pose(record.q[-1])[0] if len(record.q) else None
        offsets = params.latency_offset, params.clock_offset_max
        found = [
            *reception,
            topic_checks.rate("mocap rate", stamp_ns, params.rate),
            topic_checks.jitter("mocap jitter", received, 1.0 / params.rate),
            topic_checks.stamps("mocap stamps", stamp_ns),
            mocap_checks.latency(received, stamp_ns, 1e-9 * age, *offsets),
        ]
        frames = self.frames
        if params.markers_topic:
            frames, layout = mocap_checks.marker_poses(self.clouds, params)
            found.append(layout)
        found += mocap_checks.frame_quality(frames, params, self._refused)
        return [*found, mocap_checks.body_position(frames, params, tool)]

    def _watchdog(self, arm: Arm, record: ArmRecord, path: Row, active: bool) -> Row:
        """Row about the watchdog of the driver, tested if a person agrees."""
        expected = "the driver ends an old torque"
        unchecked = partial(Row, "watchdog", expected, verdict=Verdict.UNCHECKED)
        if self._arm_params.output != "torque":
            return unchecked("positions are sent: a driver that keeps the last one holds the arm")
        if path.verdict is Verdict.FAIL:
            return unchecked("see the command path")
        if not record.still or record.tau is None:
            return unchecked("the arm moves, or the driver reports no effort")
        if self._arm_params.effort != "torque":  # the test ends on what the driver reports
            return unchecked("effort is no torque: a torque that is held would not show")
        q, tau = record.q.mean(axis=0), record.tau.mean(axis=0)
        params, names = self._arm_params, self._arm_params.joint_names
        try:
            check = CommandCheck(arm, names, params.driver_compensates_gravity, q, tau)
        except ValueError as error:
            return unchecked(str(error))
        question = f"Watchdog: {check.warning}. Hand on the pendant, then type yes: "
        if not active and self.ask(question) != "yes":
            return unchecked("needs consent: --active, or yes at the keyboard")
        self.destroy_subscription(self._listener)
        write = joint_messages.TorqueWriter(names, params.command_type)
        topic = params.command_topic
        publisher = self.create_publisher(write.message_type, topic, interface.COMMAND)
        self.wait(DISCOVERY_TIMEOUT, lambda: publisher.get_subscription_count() > 0)

        def send_torque(sample: StateSample) -> None:
            state, _ = arm_checks.collect([sample], names)
            if len(state.q) and state.tau is not None:
                torque = check.step(sample.stamp_ns, state.q[0], state.tau[0])
                if torque is not None:
                    publisher.publish(write(sample.stamp_ns, "check", torque))

        self._send_torque = send_torque
        try:
            self.wait(DISCOVERY_TIMEOUT, lambda: check.finished)
        finally:
            self._send_torque = None
            if not check.finished:
                publisher.publish(write(record.stamp_ns[-1], "check", check.carrying_torque))
            self.wait(0.1)
            self.destroy_publisher(publisher)
        return check.row

    def _fall(self) -> Row:
        """Row about a fall of the body, dropped by a person or the stand-in."""
        samples, row = self.clouds if self._mocap.markers_topic else self.frames, self._fall_row
        if self.link.offers(self._drop):
            for _ in range(DROP_ATTEMPTS):
                samples.clear()
                self.link.begin(self._drop)
                self.wait(0.5 * FALL_TIME)
                if row().verdict is not Verdict.UNCHECKED:
                    break
            return row()
        question = "Axes: hold the marker body a metre up, on edge, in view. Press Enter, then let "
        answer = self.ask(f"{question}go within {FALL_TIME:.0f} s (s: skip): ")
        samples.clear()
        if answer not in (None, "s"):
            self.wait(2.0 * FALL_TIME)
        return row()

    def _fall_row(self) -> Row:
        frames = self.frames
        if self._mocap.markers_topic:
            frames, _ = mocap_checks.marker_poses(self.clouds, self._mocap)
        return mocap_checks.fall_direction(frames, self._mocap)

    def _by_hand(self, arm: Arm, record: ArmRecord) -> list[Row]:
        """Rows about each joint moved by a person."""
        question = "Move each joint by hand? (y, anything else skips it) "
        if not len(record.q) or self.ask(question) != "y":
            advice = "answer y at the keyboard, with an arm that can be moved by hand"
            expected = "a joint that is moved is reported under its own name"
            return [Row("joints by hand", expected, "not tested", Verdict.UNCHECKED, advice)]

        def moved() -> ArmRecord:
            return arm_checks.collect(self.states, record.joint_names)[0]

        rows: list[Row] = []
        q = record.q[-1]
        for joint, name in enumerate(record.joint_names):
            direction = arm_checks.tool_direction(arm, q, joint)
            self.states.clear()
            question = f"{name}: move only this joint until {direction}, then Enter (s: skip) "
            if self.ask(question) == "s":
                continue
            self.wait(DISCOVERY_TIMEOUT, lambda: len(moved().q) > 0)  # Enter may precede any state
            made = moved()
            rows += [arm_checks.hand_movement(made, joint), arm_checks.velocity_lag(made, joint)]
            if not len(made.q):
                break
            q = made.q[-1]
        return rows

    def _reception(self, device: str, count: int, seconds: float, given: Input) -> list[Row]:
        """Whether messages arrive, and whether all publishers of the topic are received."""
        name = "states" if device == "state" else device
        ends = self._publisher_ends(given)
        received = topic_checks.reception(name, given[0], count, seconds, *ends)
        return [received, self._match(f"{device} QoS", given)]

    def _match(self, name: str, given: Input) -> Row:
        return topic_checks.publishers(name, given[1][0], *self._publisher_ends(given))

    def _publisher_ends(self, given: Input) -> tuple[list[Endpoint], list[str]]:
        """Publishers of a topic, and those of them that are not received, as text."""
        infos = self.get_publishers_info_by_topic(self.resolve_topic_name(given[0]))
        return _ends(infos, ()), endpoints.unmatched_publishers(self, *given)


def _ends(infos: Sequence[TopicEndpointInfo], but: Collection[str] = OWN_NODES) -> list[Endpoint]:
    return [
        Endpoint(info.node_name, is_reliable(info), is_latched(info))
        for info in infos
        if info.node_name not in but
    ]


def _table(rows: Sequence[Row]) -> Table:
    """Table of the findings; those that are not OK come with the requirement, some with advice."""
    table = Table("", "", "found")
    for row in rows:
        verdict, lines = row.verdict, [escape(row.found)]
        if verdict is not Verdict.OK:
            lines.append(f"[dim]expected: {escape(row.expected)}[/dim]")
        if row.advice:
            lines.append(f"[italic]{escape(row.advice)}[/italic]")
        mark = f"[{COLOURS[verdict]}]{verdict.value}[/{COLOURS[verdict]}]"
        table.add_row(row.name, mark, "\n".join(lines))
    return table


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="check_driver",
        description="Check the drivers of arm and motion capture before anything moves. "
        "Exit status: 0 conforms, 1 does not, 2 cannot be checked.",
    )
    add = parser.add_argument
    add("--config", action="append", default=[], metavar="NAME", help="set-up, as for wam-power")
    add("--task", default="", metavar="NAME", help="cameras are checked if it tracks a body")
    add("--seconds", type=float, default=5.0, help="duration of the check (default 5)")
    alone = "test the watchdog without asking; keep a hand on the pendant"
    add("--active", action="store_true", help=alone)
    add("--accept", nargs="+", default=[], metavar="ROW", help="rows whose failure is accepted")
    add("--json", type=Path, metavar="FILE", help="also write the rows to a file")
    return parser


def main() -> int:
    """Entry point of `ros2 run wam_power_ros check_driver`; returns the exit status."""
    options = _parser().parse_args(remove_ros_args(sys.argv)[1:])
    console, errors = Console(), Console(stderr=True)
    node_runner.interrupt_on_signals()
    try:
        setup = overlay.setup(options.config, task=options.task)
        arm = TorqueControllerParams.from_setup(setup)
        mocap = BodyTrackerParams.from_setup(setup)
        make = lambda: CheckDriver(arm, mocap, console)  # noqa: E731
        with node_runner.participant(make) as node, node.link:
            rows = node.check(options.seconds, options.active)
        rows = topic_checks.accept(rows, options.accept)
    except (ValueError, OSError) as error:
        errors.print(f"cannot check: {error}", markup=False)
        return 2
    except KeyboardInterrupt:
        return 2
    result, sentence = topic_checks.verdict(rows)
    console.print(_table(rows))
    console.print(sentence, style=COLOURS[result])
    if options.json is not None:
        table = [{**asdict(row), "verdict": row.verdict.value} for row in rows]
        text = {"verdict": result.value, "said": sentence, "config": options.config, "rows": table}
        options.json.write_text(json.dumps(text, indent=1) + "\n")
    return int(result is Verdict.FAIL)
