# SPDX-License-Identifier: Apache-2.0
"""The pancake tracker: frames in, states and paths of rollouts out; in part over real DDS."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import Probe, Processes
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock

from hardware_sim import body_messages
from wam_power_ros import rotations
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.nodes.body_tracker import REPAIR_TIME, BodyTracker
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.stamps import time_message
from wam_power_ros.tracking import marker_fit

NODE = "wam_power_ros.nodes.body_tracker"
CONFIG = "pancake_tracker.yaml"
PERIOD = 33_333_333
SECOND = 1_000_000_000
PAN = np.array([0.8, 0.0, 0.6])
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def toss(count: int = 70) -> list[tuple[np.ndarray, np.ndarray]]:
    """At rest, thrown and turning from frame 20 on, caught at frame 38, at rest again."""
    rng, poses = np.random.default_rng(1), []
    for index in range(count):
        free = np.clip((index - 20) / 30.0, 0.0, 0.6)
        place = PAN + np.array([0.2 * free, 0.0, 2.9 * free - 4.905 * free**2])
        turned = rotations.quat_of_vector(np.array([0.0, 5.0 * free, 0.0]))
        poses.append((place + rng.normal(0.0, 5e-4, 3), turned))
    return poses


def pan_path(id: str, duration: float, start_ns: int) -> Path:
    t = np.arange(0.0, duration + 1e-9, 0.01)
    position = np.repeat(PAN[None], len(t), axis=0)
    path = EndEffectorPath(id, t, position, np.repeat(LEVEL[None], len(t), axis=0))
    return pose_messages.path_message(path, start_ns, "wam_base")


class Tracked:
    """A tracker in this process, whose callbacks and clocks the test calls and sets."""

    def __init__(self, node: BodyTracker) -> None:
        self.node = node
        self.states: list[Odometry] = []
        self.paths: list[Path] = []
        self.reports: list[tuple[str, str, dict[str, object]]] = []
        self.now_ns = SECOND
        self.node._states = SimpleNamespace(publish=self.states.append)
        self.node._paths = SimpleNamespace(publish=self.paths.append)
        report = lambda *of: self.reports.append(of)  # noqa: E731
        self.node._diagnostics = SimpleNamespace(publish=report)
        now = lambda: SimpleNamespace(nanoseconds=self.now_ns)  # noqa: E731
        self.node._timeout_clock = SimpleNamespace(now=now)

    def frame(self, stamp_ns: int, place: np.ndarray, quat_xyzw: np.ndarray = LEVEL) -> None:
        """A frame that arrives as it is exposed."""
        self.now_ns = stamp_ns
        self.node._on_frame(pose_messages.pose_message(stamp_ns, "world", place, quat_xyzw))

    def end(self, duration: float, start_ns: int) -> None:
        """The end of a rollout."""
        self.node._on_end_effector(pan_path("trial", duration, start_ns))

    def wait(self, seconds: float) -> None:
        """Let time go on without a frame."""
        self.now_ns += round(seconds * 1e9)
        self.node._check_silence()

    def path(self) -> pose_messages.PathReading:
        """The one path that was published."""
        (message,) = self.paths
        return pose_messages.path(message)

    def report(self) -> tuple[str, str, dict[str, object]]:
        """Level, text and values of the diagnostics."""
        self.node._report()
        return self.reports[-1]


Make = Callable[..., Tracked]


@pytest.fixture
def make(node_here: Callable[..., BodyTracker]) -> Make:
    """Makes the tracker of a test."""
    return lambda **parameters: Tracked(node_here(BodyTracker, CONFIG, **parameters))


def test_a_path_holds_every_valid_frame_of_the_rollout_however_they_come(
    probe: Probe, processes: Processes
) -> None:
    processes.node(NODE, CONFIG, clock_offset_max=10.0, silence=60.0)
    states = probe.listen(Odometry, interface.body_topic("pancake", "state"), interface.DEEP_IN)
    received = probe.listen(Path, interface.rollout_topic("pancake"), interface.LATCHED)
    ends = probe.publisher(Path, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
    pose_topic = interface.body_topic("pancake", "pose")
    frames = probe.publisher(PoseStamped, pose_topic, interface.STATE_OUT)
    paths = []
    poses = toss()
    now_ns = time.time_ns()
    for id, pause, start_ns in (("trial-1", 0.0, now_ns), ("trial-2", 0.01, now_ns + 10**10 + 7)):
        first_ns = start_ns - 5 * PERIOD
        stamps = [first_ns + index * PERIOD for index in range(len(poses))]
        for index, (stamp_ns, pose) in enumerate(zip(stamps, poses, strict=True)):
            if index == 40:  # the path of the pan comes while frames are still on their way
                ends.publish(pan_path(id, 2.0, start_ns))
            if index not in (30, 31):  # a gap
                frames.publish(pose_messages.pose_message(stamp_ns, "world", *pose))
            probe.spin(pause)
        paths.append(pose_messages.path(probe.until(lambda: received and received.pop(), "a path")))
        assert paths[-1].start_ns == start_ns
        end = start_ns + 2_000_000_000
        inside = [
            index
            for index, stamp_ns in enumerate(stamps)
            if start_ns - 3 * 10**8 <= stamp_ns <= end and index not in (30, 31)
        ]
        assert len(paths[-1].t) == len(inside)
        np.testing.assert_allclose(paths[-1].position, [poses[i][0] for i in inside], atol=1e-12)
        probe.spin(0.3)
    np.testing.assert_array_equal(paths[0].t, paths[1].t)  # at any time and any speed
    np.testing.assert_array_equal(paths[0].position, paths[1].position)
    assert len(states) > 100
    state = pose_messages.odometry(states[-1])
    assert state.frame == "wam_base"
    assert np.linalg.norm(state.velocity) < 0.1


def test_a_path_without_an_end_in_view_goes_out_after_silence(make: Make) -> None:
    tracked = make(silence=0.3)
    start_ns = time.time_ns()
    for index, pose in enumerate(toss(10)):
        tracked.frame(start_ns + index * PERIOD, *pose)
    tracked.end(2.0, start_ns)
    tracked.wait(0.29)
    assert not tracked.paths
    tracked.wait(0.02)
    assert len(tracked.path().t) == 10
    tracked.paths.clear()
    tracked.end(2.0, 10**18)  # nothing was seen of it, and the next begins
    tracked.end(2.0, 2 * 10**18)
    assert (tracked.path().start_ns, len(tracked.path().t)) == (10**18, 0)


def test_hidden_markers_coast_and_every_fault_is_in_the_diagnostics(make: Make) -> None:
    tracked = make(rate=10.0)
    start_ns, step = time.time_ns(), 100_000_000
    rng = np.random.default_rng(0)
    good = [PAN + rng.normal(0.0, 5e-4, 3) for _ in range(5)]
    bad = [PAN + np.array(off) for off in ([0.0, 2.0, 0.0], [0.0, 0.0, 9.0], [np.nan, 0.0, 0.0])]
    for index, place in enumerate([*good, *bad, np.zeros(3), *good[:2], good[1]]):
        tracked.frame(start_ns + index * step, place)
    seen = len(tracked.states)
    for _ in range(20):
        tracked.wait(0.05)
    coasted = tracked.states[seen:]
    assert 0 < len(coasted) < 10
    assert all(state.pose.covariance[0] > 1e-6 for state in coasted)
    level, text, counts = tracked.report()
    assert (level, "lost" in text) == ("error", True)
    wanted = {"zero pose": 1, "jump": 1, "out of workspace": 1}
    wanted |= {"message not valid": 1, "pose repeated": 1, "accepted": 7}
    assert wanted.items() <= counts.items()


@pytest.mark.requirement("S-47")
def test_stamps_of_another_clock_are_reported_and_no_path_is_made_of_them(make: Make) -> None:
    tracked = make()
    start_ns = time.time_ns() - 3600 * SECOND
    for index, pose in enumerate(toss(10)):
        tracked.frame(start_ns + index * PERIOD, *pose)
    tracked.end(0.2, start_ns)
    assert len(tracked.path().t) == 0
    level, text, values = tracked.report()
    assert level == "error" and "synchronise the clocks" in text
    assert f"rollout-{start_ns} not scored" in str(values["last problem"])


def test_a_cloud_of_markers_in_a_y_up_world_gives_the_state_in_the_base(make: Make) -> None:
    tracked = make(pose_topic='""', markers_topic=interface.MARKERS, up_axis='"y"')
    rng, start_ns = np.random.default_rng(0), time.time_ns()
    other = np.array([[0.0, 0.0, 0.1]])
    for index in range(5):
        place = PAN + rng.normal(0.0, 5e-4, 3)
        x, y, z = rng.permutation(np.vstack([marker_fit.LAYOUT + place, other])).T
        cloud = np.stack([x, z, -y], axis=1)
        kind, stamp_ns = "sensor_msgs/msg/PointCloud2", start_ns + index * PERIOD
        tracked.node._on_frame(body_messages.message(kind, stamp_ns, "world", "", cloud))
    state = pose_messages.odometry(tracked.states[-1])
    np.testing.assert_allclose(state.position, PAN, atol=3e-3)
    np.testing.assert_allclose(rotations.matrix(state.quat_xyzw), np.eye(3), atol=1e-4)


@pytest.mark.parametrize("tethered", [False, True])
def test_a_fall_along_another_axis_is_reported_unless_a_string_may_hold_the_body(
    tethered: bool, make: Make
) -> None:
    tracked = make(tethered=tethered, clock_offset_max=10.0)
    start_ns = time.time_ns()
    tracked.end(1.5, start_ns)
    for index, (place, quat) in enumerate(toss(50)):
        x, y, z = place - PAN
        tracked.frame(start_ns + index * PERIOD, PAN + np.array([x, z, -y]), quat)
    assert len(tracked.path().t) > 40
    problem = str(tracked.report()[2]["last problem"])
    assert ("not along -z" in problem) == (not tethered)


def test_in_lockstep_a_path_is_waited_for_while_the_clock_stands_or_frames_are_sent_again(
    make: Make,
) -> None:
    tracked = make(use_sim_time=True, silence=0.5)
    poses = toss(40)
    for index in range(20):
        tracked.frame(SECOND + index * PERIOD, *poses[index])
    tracked.end(1.0, SECOND)
    tracked.node._arrived -= 2.0 * REPAIR_TIME  # the arm's stand-in waits for a torque
    tracked.wait(0.0)
    assert not tracked.paths
    tracked.node._arrived = time.monotonic()  # lost frames may be sent again
    tracked.wait(2.0)
    assert not tracked.paths
    for index in range(20, 40):
        tracked.frame(SECOND + index * PERIOD, *poses[index])
    assert len(tracked.path().t) == 31
    tracked.paths.clear()
    tracked.end(1.0, 9 * SECOND)
    tracked.node._arrived -= 2.0 * REPAIR_TIME
    tracked.wait(9.0)
    assert len(tracked.path().t) == 0


def test_in_lockstep_a_tracker_that_stood_still_loses_no_frame(
    probe: Probe, processes: Processes
) -> None:
    node = processes.node(NODE, CONFIG, use_sim_time=True)
    paths = probe.listen(Path, interface.rollout_topic("pancake"), interface.LATCHED)
    ends = probe.publisher(Path, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
    pose_topic = interface.body_topic("pancake", "pose")
    frames = probe.publisher(PoseStamped, pose_topic, interface.MOCAP)
    clock = probe.publisher(Clock, interface.CLOCK, interface.CLOCK_QOS)
    poses = toss(300)
    node.send_signal(signal.SIGSTOP)
    try:
        for index in range(300):  # more than the middleware keeps for a process that does not read
            stamp_ns = SECOND + index * PERIOD
            for _ in range(5):
                clock.publish(Clock(clock=time_message(stamp_ns)))
            frames.publish(pose_messages.pose_message(stamp_ns, "world", *poses[index]))
            probe.spin(0.002)
    finally:
        node.send_signal(signal.SIGCONT)
    ends.publish(pan_path("held", 9.9, SECOND))
    message = probe.until(lambda: paths and paths[0], "a path")
    assert len(pose_messages.path(message).t) == 298  # within 9.9 s


def test_a_driver_of_another_type_is_an_error_that_names_both(probe: Probe, make: Make) -> None:
    probe.node.create_publisher(PointStamped, "/pancake/pose", 10)
    tracked = make()
    theirs = "node 'probe' publishes geometry_msgs/msg/PointStamped (reliable, volatile) on "
    text = f"{theirs}/pancake/pose, not geometry_msgs/msg/PoseStamped"
    probe.until(lambda: text in tracked.report()[1], "its name")
    assert tracked.report()[0] == "error"
    tracked.frame(time.time_ns(), PAN)
    tracked.frame(time.time_ns(), PAN + 1e-3)  # of a driver that is received
    assert tracked.report()[0] == "warn"


def test_a_tracker_without_a_source_stops_with_the_names_of_both(processes: Processes) -> None:
    node = processes.node(NODE, CONFIG, pose_topic='""')
    assert node.wait(20.0) == 2
    assert "pose_topic or markers_topic" in processes.output(node)
