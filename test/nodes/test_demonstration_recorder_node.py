# SPDX-License-Identifier: Apache-2.0
"""The recorder: every message of a recording, whatever ends it; in part over real DDS."""

from __future__ import annotations

import json
import re
import resource
import shutil
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from conftest import Probe, Processes, lift
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Path as NavPath
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool

from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.recovery import recover
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.policy import to_json
from wam_power_ros.nodes.demonstration_recorder import DemonstrationRecorder
from wam_power_ros.params.resources import share
from wam_power_ros.ros import endpoints, interface, joint_messages, pose_messages
from wam_power_ros.ros.stamps import time_message

NODE = "wam_power_ros.nodes.demonstration_recorder"
CONFIG = "demonstration_recorder.yaml"
NAMES = [f"wam_j{i}" for i in range(1, 8)]
START = 1_700_000_000_000_000_000
TICK = 2_000_000  # [ns]


def information(path: Path) -> dict:
    return yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


def state(number: int) -> JointState:
    """A joint state, by its number."""
    q = np.arange(7.0) + 0.001 * number
    write = joint_messages.JointStateWriter(NAMES)
    return write(START + TICK * number, q, np.zeros(7), np.ones(7))


def numbers(path: Path) -> list[int]:
    """Numbers of the joint states of a bag."""
    stamps_ns, q = reader.read_demonstration(path, NAMES)
    found = (stamps_ns - START) // TICK
    np.testing.assert_array_equal(q, np.arange(7.0) + 0.001 * found[:, None])
    return found.tolist()


class Fed:
    """A recorder in this process, whose callbacks the test calls."""

    def __init__(self, node: DemonstrationRecorder) -> None:
        self.node = node
        self.reports: list[tuple[Any, ...]] = []
        node._diagnostics = SimpleNamespace(publish=lambda *of: self.reports.append(of))

    def feed(self, message: object, topic: str = layout.STATES) -> None:
        """Let a message arrive."""
        topics = self.node._topics
        topics.msgtype = lambda _: endpoints.type_name(type(message))
        topics.offered = lambda _: ()
        self.node._on_message(topic, serialize_message(message))

    def later(self, *arrivals: Callable[[], object]) -> None:
        """What arrives while the recorder waits for it, one at a look."""
        left = iter(arrivals)
        self.node._topics.take = lambda: next(left, lambda: None)()

    def in_lockstep(self, number: int) -> None:
        """Follow the clock of a simulation that has come to a state."""
        self.node._sim_time = True
        now = SimpleNamespace(nanoseconds=START + TICK * number)
        self.node.get_clock = lambda: SimpleNamespace(now=lambda: now)

    def record(self, on: bool) -> tuple[bool, str]:
        """Request the start or the end of a recording."""
        response = self.node._on_record(SetBool.Request(data=on), SetBool.Response())
        return response.success, response.message

    def begin(self) -> Path:
        """Begin a recording; fail if it is refused."""
        done, message = self.record(True)
        assert done, message
        return Path(message)

    def end(self) -> Path:
        """End a recording; fail if it is refused."""
        done, message = self.record(False)
        assert done, message
        return Path(message)

    def report(self) -> tuple[str, str]:
        """Level and text of the diagnostics."""
        self.node._report()
        return self.reports[-1][:2]


Make = Callable[..., Fed]


@pytest.fixture
def make(node_here: Callable[..., DemonstrationRecorder], tmp_path: Path) -> Make:
    """Makes the recorder of a test."""
    usual = {"directory": tmp_path, "realtime_priority": 0}
    return lambda **given: Fed(node_here(DemonstrationRecorder, CONFIG, **(usual | given)))


def test_messages_that_wait_in_the_queue_at_a_request_are_not_recorded(
    probe: Probe, make: Make
) -> None:
    states = probe.node.create_publisher(JointState, layout.STATES, interface.STATE_OUT)

    def send(first: int, last: int) -> None:
        for number in range(first, last):
            states.publish(state(number))
            probe.spin(0.01)
        probe.spin(0.3)  # the node does not spin: they wait

    fed = make()
    discover = fed.node._topics.discover
    probe.until(lambda: discover() or states.get_subscription_count(), "a reader")
    send(0, 5)
    fed.begin()
    send(5, 9)
    assert numbers(fed.end()) == [5, 6, 7, 8]


def test_a_recording_that_cannot_be_is_refused_with_its_reason(make: Make) -> None:
    fed = make()
    assert fed.record(False) == (False, "not recording")
    path = fed.begin()
    assert fed.record(True) == (False, f"already recording {path}")


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ({"free_to_start": 1e9}, "1000000000 MB needed"),
        ({"directory": "/proc/bags"}, "/proc/bags"),
    ],
)
def test_no_recording_begins_without_a_place_for_it(
    parameters: dict[str, object], why: str, make: Make
) -> None:
    done, message = make(**parameters).record(True)
    assert not done and why in message


def test_a_disk_that_is_nearly_full_closes_the_bag_in_time(make: Make) -> None:
    fed = make(free_to_start=0.0, free_to_continue=1e9)
    path = fed.begin()
    fed.feed(state(0))
    fed.node._check_disk()
    level, text = fed.report()
    assert level == "error" and "stopped below 1000000000 MB free" in text
    assert json.loads(information(path)["custom_data"]["joint_names"]) == NAMES
    assert fed.record(False) == (False, "not recording")


@pytest.mark.requirement("S-66")
def test_a_folder_that_goes_away_ends_the_recording_and_nothing_else(
    make: Make, tmp_path: Path
) -> None:
    fed = make(directory=tmp_path / "bags")
    fed.begin()
    (tmp_path / "bags").rename(tmp_path / "pulled out")
    fed.node._check_disk()
    level, text = fed.report()
    assert level == "error" and "left unfinished" in text
    (tmp_path / "pulled out").rename(tmp_path / "bags")
    again = fed.begin()
    fed.feed(state(0))
    assert fed.end() == again and numbers(again) == [0]


def test_in_lockstep_states_that_arrive_after_the_request_to_end_are_waited_for(
    make: Make,
) -> None:
    fed = make()
    fed.in_lockstep(9)
    fed.begin()
    for number in range(4):
        fed.feed(state(number))
    fed.later(*(lambda number=number: fed.feed(state(number)) for number in range(4, 10)))
    assert numbers(fed.end()) == [*range(10)]


def test_a_bag_of_a_simulation_is_stamped_by_its_time_whatever_its_pace(make: Make) -> None:
    fed = make()
    fed.in_lockstep(99)
    fed.feed(state(0))  # before the recording
    path = fed.begin()
    for number in range(1, 100):
        fed.feed(state(number))
        fed.feed(Clock(clock=time_message(START + TICK * number)), interface.CLOCK)
    fed.end()
    for topic in (layout.STATES, interface.CLOCK):
        stamps_ns = [stamp_ns for _, stamp_ns, _ in Bag(path).messages([topic])]
        assert stamps_ns == [START + TICK * number for number in range(1, 100)]
    assert information(path)["duration"]["nanoseconds"] == 99 * TICK


def test_a_rollout_is_named_after_the_policy_that_came_for_it(make: Make) -> None:
    fed, names = make(), []
    for id in ("trial-0007", "trial-0007", "", "../trial-0008"):  # the last two are no names
        policy = PolicyMessage(id=id, text=to_json(lift("trial-0007")))
        fed.feed(policy, "/policy")  # latched before the recording
        fed.node._on_policy(policy)
        fed.begin()
        names.append(fed.end())
    assert [path.name for path in names[:2]] == ["rollout_trial-0007", "rollout_trial-0007_2"]
    assert [path.name[:5] for path in names[2:]] == ["demo_"] * 2
    assert len([*Bag(names[0]).messages(["/policy"])]) == 1


def test_the_path_of_a_body_is_waited_for_when_its_rollout_has_finished(make: Make) -> None:
    fed = make()
    fed.begin()
    fed.feed(NavPath(), f"/{interface.ROLLOUT_END_EFFECTOR}")
    nothing = lambda: None  # noqa: E731
    fed.later(nothing, nothing, nothing, lambda: fed.feed(NavPath(), "/rollout/pancake"))
    assert len([*Bag(fed.end()).messages(["/rollout/pancake"])]) == 1


def test_what_is_missing_is_said_in_the_bag_and_the_diagnostics(make: Make) -> None:
    fed = make()
    fed.begin()
    assert fed.report() == ("warn", "no message on /joint_states yet")
    for number in (*range(30), *range(34, 60)):
        fed.feed(state(number))
    custom = information(fed.end())["custom_data"]
    assert json.loads(custom["missing"])["/joint_states"] == 4
    note = "4 messages missing on /joint_states, longest gap 0.010 s"
    assert fed.report() == ("warn", note)


def test_a_driver_of_another_type_is_a_warning_that_names_both(probe: Probe, make: Make) -> None:
    probe.node.create_publisher(PointStamped, "/pancake/pose", 10)
    fed = make()
    text = "not recorded: node 'probe' publishes geometry_msgs/msg/PointStamped"
    discover = fed.node._topics.discover
    probe.until(lambda: discover() or fed.report()[1].startswith(text), "its name")
    assert fed.report()[0] == "warn"


class Bench:
    """A recorder in a process, and publishers of its topics."""

    def __init__(self, probe: Probe, processes: Processes, folder: Path) -> None:
        self.probe = probe
        self.processes = processes
        self.node = processes.node(NODE, CONFIG, directory=folder)
        self.diagnostics = probe.diagnostics()
        self.states = probe.publisher(JointState, interface.JOINT_STATES, interface.STATE_OUT)
        self.sent = 0

    def record(self, on: bool) -> Path:
        """Begin or end a recording; fail if it is refused."""
        response = self.probe.call(SetBool, interface.RECORD, SetBool.Request(data=on))
        assert response.success, response.message
        return Path(response.message)

    def start(self) -> Path:
        """Begin a recording."""
        return self.record(True)

    def received(self) -> None:
        """Wait until the recorder has all states, or has been told that some are lost."""
        assert self.states.wait_for_all_acked(Duration(seconds=60.0))

    def stop(self) -> Path:
        """End a recording that has all states."""
        self.received()
        return self.record(False)

    def send(self, count: int) -> None:
        """Joint states 2 ms apart by their stamps and by the wall clock."""
        due = time.monotonic()
        for _ in range(count):
            self.states.publish(state(self.sent))
            self.sent += 1
            due += 0.002
            self.probe.spin(max(0.0, due - time.monotonic()))

    def status(self, text: str) -> DiagnosticArray:
        """Wait for diagnostics that say `text`."""
        return self.probe.until(
            lambda: next((msg for msg in self.diagnostics if text in str(msg)), None), text
        )


@pytest.fixture(scope="module")
def shared(
    shared_nodes: tuple[Probe, Processes], tmp_path_factory: pytest.TempPathFactory
) -> Bench:
    return Bench(*shared_nodes, tmp_path_factory.mktemp("bags") / "made")


@pytest.fixture
def bench(shared: Bench) -> Bench:
    """A recorder that several tests share; each leaves it idle."""
    shared.diagnostics.clear()
    return shared


def latched(probe: Probe, topic: str, text: str) -> Publisher:
    publisher = probe.publisher(String, topic, interface.LATCHED)
    publisher.publish(String(data=text))
    return publisher


def test_a_demonstration_holds_every_message_and_what_its_topics_offered(bench: Bench) -> None:
    probe = bench.probe
    latched(probe, interface.ROBOT_DESCRIPTION, "<robot name='wam'/>")
    torques = probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)
    pose_topic = interface.body_topic("pancake", "pose")
    poses = probe.publisher(PoseStamped, pose_topic, interface.STATE_IN)
    bench.send(50)  # before the recording
    path = bench.start()
    assert re.fullmatch(r"demo_\d{8}_\d{6}", path.name)
    assert not path.exists()
    torques.publish(Float64MultiArray(data=[0.5] * 7))
    poses.publish(pose_messages.pose_message(START, "world", np.ones(3), np.array([0, 0, 0, 1.0])))
    first = bench.sent
    bench.send(700)
    assert bench.record(False) == path
    assert numbers(path) == [*range(first, bench.sent)]

    info = information(path)
    custom = info["custom_data"]
    assert json.loads(custom["joint_names"]) == NAMES
    assert Bag(path).arm == Arm(share("urdf/wam7.urdf").read_text(), NAMES).identity()
    assert (custom["source"], custom["rate"]) == ("hardware", "500.0")
    assert json.loads(custom["missing"])["/joint_states"] == 0
    topics = {item["topic_metadata"]["name"]: item for item in info["topics_with_message_count"]}
    offered = {
        name: (profile["reliability"], profile["durability"])
        for name, item in topics.items()
        for profile in item["topic_metadata"]["offered_qos_profiles"]
    }
    assert offered == {
        "/joint_states": ("reliable", "volatile"),
        "/effort_controller/commands": ("reliable", "volatile"),
        "/pancake/pose": ("best_effort", "volatile"),
        "/robot_description": ("reliable", "transient_local"),
        layout.EVENT: ("reliable", "transient_local"),
    }
    assert topics["/robot_description"]["message_count"] == 1

    first_of = {topic: cdr for topic, _, cdr in reversed([*Bag(path).messages(topics)])}
    torque = deserialize_message(first_of[f"/{interface.EFFORT_COMMANDS}"], Float64MultiArray)
    assert list(torque.data) == [0.5] * 7
    description = deserialize_message(first_of["/robot_description"], String)
    assert description.data == "<robot name='wam'/>"


@pytest.mark.parametrize("left_out", [(), np.full(7, np.nan)], ids=["empty", "NaN"])
def test_states_without_velocity_or_effort_are_recorded_and_read_however_they_were_sent(
    bench: Bench, left_out: Sequence[float]
) -> None:
    """A player of bags sends the bytes in them: what `serialize_message` makes is longer."""
    path = bench.start()
    write = joint_messages.JointStateWriter(NAMES)
    cases = [(left_out, np.ones(7)), (np.ones(7), left_out), (left_out, left_out)]
    wanted, excess = np.arange(7.0) + 0.001 * np.arange(60)[:, None], set()
    for number, q in enumerate(wanted):
        message = write(START + TICK * number, q, *cases[number % 3])
        bench.states.publish(serialize_message(message) if number % 2 else message)
        bench.probe.spin(0.002)
    bench.stop()
    assert numbers(path) == [*range(60)]
    for number, (_, _, cdr) in enumerate(Bag(path).messages([layout.STATES])):
        found = layout.decoded(cdr, layout.JOINT_STATE)
        np.testing.assert_array_equal(found.velocity, cases[number % 3][0])
        np.testing.assert_array_equal(found.effort, cases[number % 3][1])
        written = layout.TYPES.serialize_cdr(found, layout.JOINT_STATE)
        excess.add((number % 2, len(cdr) - len(written)))
    # What this package writes is as long as what a publisher sends.
    assert {size for played, size in excess if not played} == {0}
    assert {size for played, size in excess if played} == ({0} if len(left_out) else {4, 8})


def test_a_recorder_that_stands_still_holds_nobody_up(bench: Bench) -> None:
    bench.start()
    bench.send(10)
    bench.node.send_signal(signal.SIGSTOP)
    try:
        held_up, message = 0, state(0)
        for _ in range(5200):  # a writer that forgets nothing waits from the 5000th on
            begun = time.monotonic()
            bench.states.publish(message)
            held_up += time.monotonic() - begun > 0.09  # it waits 0.1 s
    finally:
        bench.node.send_signal(signal.SIGCONT)
    assert held_up < 100  # at all of the last 200; a busy machine at some
    bench.stop()


@pytest.mark.parametrize(("qos", "lost"), [(interface.DEEP, False), (interface.STATE_OUT, True)])
def test_what_came_while_the_recorder_stood_still_is_sent_again_or_told_as_missing(
    probe: Probe, processes: Processes, tmp_path: Path, qos: QoSProfile, lost: bool
) -> None:
    bench = Bench(probe, processes, tmp_path)
    bench.states = probe.publisher(JointState, interface.JOINT_STATES, qos)
    bench.start()
    bench.send(50)
    probe.spin(1.0)
    bench.node.send_signal(signal.SIGSTOP)
    try:
        for _ in range(1500):  # more than a reader's socket holds
            bench.states.publish(state(bench.sent))
            bench.sent += 1
            time.sleep(1e-4)
    finally:
        bench.node.send_signal(signal.SIGCONT)
    bench.send(50)
    if not lost:
        bench.status(f"/joint_states', value='{bench.sent}'")
    path = bench.stop()
    if lost:
        bench.status("messages missing on /joint_states")
    assert (len(numbers(path)) < bench.sent) == lost


def test_a_recorder_that_is_stopped_closes_its_bag(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Bench(probe, processes, tmp_path)
    path = bench.start()
    bench.send(100)
    bench.received()
    assert processes.end(bench.node, signal.SIGTERM) == 0
    assert numbers(path) == [*range(100)]
    assert not list(tmp_path.glob("*.unfinished"))


@pytest.mark.requirement("S-65")
def test_states_reach_the_disk_during_a_recording_and_survive_a_kill(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Bench(probe, processes, tmp_path)
    path = bench.start()
    bench.send(500)
    copy = tmp_path / "copy" / path.name

    def on_the_disk() -> bool:
        shutil.rmtree(copy.parent, ignore_errors=True)
        shutil.copytree(f"{path}{layout.UNFINISHED}", f"{copy}{layout.UNFINISHED}")
        try:
            return len(numbers(recover(copy).path)) == 500
        except ValueError:  # no state yet
            return False

    probe.until(on_the_disk, "all states on the disk")
    processes.end(bench.node, signal.SIGKILL)
    with pytest.raises(ValueError, match="recover it first"):
        reader.read_demonstration(path, NAMES)
    made = recover(path).path
    assert numbers(made) == [*range(500)]
    assert information(made)["custom_data"]["joint_names"] == json.dumps(NAMES)
    again = processes.node(NODE, CONFIG, directory=tmp_path)
    hint = f"wam-power recover {path}"
    probe.until(lambda: hint in processes.output(again), "the hint to recover the bag")


@pytest.mark.requirement("S-65", "S-66")
@pytest.mark.parametrize("size", [0, 1_500_000])  # met by the flush, or by a message itself
def test_a_disk_that_fills_up_ends_the_recording_and_nothing_else(
    probe: Probe, processes: Processes, tmp_path: Path, size: int
) -> None:
    bench = Bench(probe, processes, tmp_path)
    robot = latched(probe, interface.ROBOT_DESCRIPTION, "")
    path = bench.start()
    allowed = (200_000, resource.getrlimit(resource.RLIMIT_FSIZE)[1])
    resource.prlimit(bench.node.pid, resource.RLIMIT_FSIZE, allowed)
    if size:
        bench.send(300)
        robot.publish(String(data="x" * size))
    for _ in range(300):
        if "left unfinished" not in str(bench.diagnostics):
            bench.send(10)
    bench.status("left unfinished")
    robot.publish(String(data=""))
    kept = len(numbers(recover(path).path))
    assert kept >= 100
    # It was noticed long before the 3000th; for times see S-65 in docs/safety.md.
    assert bench.sent - kept <= 1500
    resource.prlimit(bench.node.pid, resource.RLIMIT_FSIZE, (allowed[1], allowed[1]))
    again = bench.start()  # the next recording is complete
    bench.send(100)
    assert bench.stop() == again
    assert len(numbers(again)) == 100
