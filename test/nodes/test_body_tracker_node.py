# SPDX-License-Identifier: Apache-2.0
"""The pancake tracker over real DDS: frames in, states and paths of rollouts out."""

import signal
import time

import numpy as np
import pytest
from conftest import Probe, Processes
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.stamps import time_message

NODE = "wam_power_ros.nodes.body_tracker"
CONFIG = "pancake_tracker.yaml"
PERIOD = 33_333_333
PAN = np.array([0.8, 0.0, 0.6])
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
RELIABLE = interface.STATE_OUT


def toss(rng: np.random.Generator, count: int = 70) -> list[tuple[np.ndarray, np.ndarray]]:
    """At rest, thrown and turning from frame 20 on, caught at frame 38, at rest again."""
    poses = []
    for index in range(count):
        free = np.clip((index - 20) / 30.0, 0.0, 0.6)
        place = PAN + np.array([0.2 * free, 0.0, 2.9 * free - 4.905 * free**2])
        turned = rotations.quat_of_vector(np.array([0.0, 5.0 * free, 0.0]))
        poses.append((place + rng.normal(0.0, 5e-4, 3), turned))
    return poses


def pan_path(id: str, duration: float) -> EndEffectorPath:
    t = np.arange(0.0, duration + 1e-9, 0.01)
    position = np.repeat(PAN[None], len(t), axis=0)
    return EndEffectorPath(id, t, position, np.repeat(LEVEL[None], len(t), axis=0))


class Bench:
    """A tracker, with publishers and subscriptions for all its topics."""

    def __init__(self, probe: Probe, processes: Processes, **parameters: object) -> None:
        self.probe = probe
        self.node = processes.node(NODE, CONFIG, **parameters)
        state = interface.body_topic("pancake", "state")
        self.states = probe.listen(Odometry, state, interface.STATE_RECORD)  # bursts, too
        self.paths = probe.listen(Path, interface.rollout_topic("pancake"), interface.LATCHED)
        self.diagnostics = probe.diagnostics()
        self.ends = probe.publisher(Path, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
        probe.until(lambda: self.diagnostics, "the tracker's diagnostics")

    def path(self) -> pose_messages.PathReading:
        """The next path of the pancake."""
        message = self.probe.until(lambda: self.paths and self.paths.pop(0), "a path")
        return pose_messages.path(message)

    def status(self, text: str) -> dict[str, str]:
        """The next status that contains `text`."""
        found = self.probe.until(
            lambda: next(
                (item for msg in self.diagnostics for item in msg.status if text in str(item)), None
            ),
            f"diagnostics with {text}",
        )
        return {"level": found.level[0], "text": found.message} | {
            item.key: item.value for item in found.values
        }


def test_a_path_holds_every_valid_frame_of_the_rollout_however_they_come(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, clock_offset_max=10.0, silence=60.0)
    frames = probe.publisher(PoseStamped, interface.body_topic("pancake", "pose"), RELIABLE)
    paths = []
    poses = toss(np.random.default_rng(1))
    now_ns = time.time_ns()
    for id, pause, start_ns in (("trial-1", 0.0, now_ns), ("trial-2", 0.01, now_ns + 10**10 + 7)):
        first_ns = start_ns - 5 * PERIOD
        stamps = [first_ns + index * PERIOD for index in range(len(poses))]
        for index, (stamp_ns, pose) in enumerate(zip(stamps, poses, strict=True)):
            if index == 40:  # the path of the pan comes while frames are still on their way
                bench.ends.publish(
                    pose_messages.path_message(pan_path(id, 2.0), start_ns, "wam_base")
                )
            if index not in (30, 31):  # a gap
                frames.publish(pose_messages.pose_message(stamp_ns, "world", *pose))
            probe.spin(pause)
        paths.append(bench.path())
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
    assert len(bench.states) > 100
    state = pose_messages.odometry(bench.states[-1])
    assert state.frame == "wam_base"
    assert np.linalg.norm(state.velocity) < 0.1


def test_a_path_without_an_end_in_view_goes_out_after_silence(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, silence=0.3)
    frames = probe.publisher(PoseStamped, interface.body_topic("pancake", "pose"), RELIABLE)
    start_ns = time.time_ns()
    for index, pose in enumerate(toss(np.random.default_rng(1), 10)):
        frames.publish(pose_messages.pose_message(start_ns + index * PERIOD, "world", *pose))
        probe.spin(PERIOD * 1e-9)  # stamps of a camera are in the past
    bench.ends.publish(pose_messages.path_message(pan_path("short", 2.0), start_ns, "wam_base"))
    begun = time.monotonic()
    assert len(bench.path().t) == 10
    assert time.monotonic() - begun > 0.2
    bench.ends.publish(pose_messages.path_message(pan_path("unseen", 2.0), 10**18, "wam_base"))
    path = bench.path()
    assert (path.start_ns, len(path.t)) == (10**18, 0)


def test_hidden_markers_coast_and_every_fault_is_in_the_diagnostics(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, rate=10.0)
    frames = probe.publisher(PoseStamped, interface.body_topic("pancake", "pose"), RELIABLE)
    probe.spin(0.5)  # it has found the tracker, and the tracker finds it a moment later
    now_ns = time.time_ns()
    bad = [
        (PAN + np.array([0.0, 2.0, 0.0]), LEVEL),
        (np.zeros(3), LEVEL),
        (np.array([np.nan, 0.0, 0.6]), LEVEL),
        (PAN, 2.0 * LEVEL),
        (PAN + np.array([0.0, 0.0, 9.0]), LEVEL),
    ]
    rng = np.random.default_rng(0)
    good = [(PAN + rng.normal(0.0, 5e-4, 3), LEVEL) for _ in range(5)]
    for index, pose in enumerate([*good, *bad, *good[:2], good[1]]):
        frames.publish(pose_messages.pose_message(now_ns + index * 100_000_000, "world", *pose))
        probe.spin(0.01)

    def coasting() -> list[Odometry]:
        return [item for item in bench.states if item.pose.covariance[0] > 1e-6]

    for index in range(13, 23):  # a busy tracker may miss the moment
        probe.spin(1.0)
        if coasted := coasting():
            break
        pose = good[index % 5]
        frames.publish(pose_messages.pose_message(now_ns + index * 100_000_000, "world", *pose))
    assert pose_messages.odometry(coasted[0]).stamp_ns > now_ns + 12 * 100_000_000
    status = bench.status("lost")
    assert status["level"] == 2
    counts = {key: status[key] for key in ("zero pose", "jump", "out of workspace")}
    assert counts == {"zero pose": "1", "jump": "1", "out of workspace": "1"}
    assert status["message not valid"] == "2"
    assert status["pose repeated"] == "1"
    assert int(status["accepted"]) >= 7


@pytest.mark.requirement("S-47")
def test_stamps_of_another_clock_are_reported_and_no_path_is_made_of_them(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes)
    frames = probe.publisher(PoseStamped, interface.body_topic("pancake", "pose"), RELIABLE)
    start_ns = time.time_ns() - 3600 * 1_000_000_000
    for index, pose in enumerate(toss(np.random.default_rng(1), 10)):
        frames.publish(pose_messages.pose_message(start_ns + index * PERIOD, "world", *pose))
    bench.ends.publish(pose_messages.path_message(pan_path("old", 0.2), start_ns, "wam_base"))
    assert len(bench.path().t) == 0
    status = bench.status("synchronise the clocks")
    assert status["level"] == 2
    assert f"rollout-{start_ns} not scored" in status["last problem"]


class Lockstep(Bench):
    """A tracker in simulated time, which the tests below share; each begins at a later second."""

    def __init__(self, probe: Probe, processes: Processes) -> None:
        super().__init__(probe, processes, use_sim_time=True, silence=0.5)
        pose = interface.body_topic("pancake", "pose")
        self._frames = probe.publisher(PoseStamped, pose, interface.MOCAP)
        self._clock = probe.publisher(Clock, interface.CLOCK, interface.NEWEST)
        self.begin_ns = 0

    def end(self, duration: float) -> None:
        """Send the path of the tool in a rollout [s]."""
        message = pose_messages.path_message(pan_path("a", duration), self.begin_ns, "wam_base")
        self.ends.publish(message)

    def tick(self, t: float) -> None:
        """Send the time since the begin of the rollout [s]."""
        self._clock.publish(Clock(clock=time_message(self.begin_ns + round(t * 1e9))))

    def frame(self, index: int, place: np.ndarray, quat: np.ndarray) -> None:
        """Send a frame of the rollout."""
        stamp_ns = self.begin_ns + index * PERIOD
        self._frames.publish(pose_messages.pose_message(stamp_ns, "world", place, quat))


@pytest.fixture(scope="module")
def tracker(shared_nodes: tuple[Probe, Processes]) -> Lockstep:
    return Lockstep(*shared_nodes)


@pytest.fixture
def lockstep(tracker: Lockstep) -> Lockstep:
    tracker.begin_ns += 100_000_000_000
    return tracker


def test_a_fall_along_another_axis_is_reported(lockstep: Lockstep) -> None:
    lockstep.end(1.5)
    for index, (place, quat) in enumerate(toss(np.random.default_rng(1), 50)):
        x, y, z = place - PAN
        lockstep.tick(index * PERIOD * 1e-9)
        lockstep.frame(index, PAN + np.array([x, z, -y]), quat)
        lockstep.probe.spin(0.005)
    lockstep.path()
    lockstep.diagnostics.clear()
    assert "not along -z" in lockstep.status("last problem")["last problem"]


def test_in_lockstep_a_standing_clock_is_no_silence(lockstep: Lockstep) -> None:
    poses = toss(np.random.default_rng(1), 40)

    def send(first: int, last: int) -> None:
        for index in range(first, last):
            lockstep.tick(index * PERIOD * 1e-9)
            lockstep.frame(index, *poses[index])
            lockstep.probe.spin(0.005)

    send(0, 20)
    lockstep.end(1.0)
    lockstep.probe.spin(1.2)  # the arm's stand-in waits for a torque
    assert not lockstep.paths
    send(20, 40)
    assert len(lockstep.path().t) == 31


def test_in_lockstep_frames_that_are_sent_again_later_belong_to_the_path(
    lockstep: Lockstep,
) -> None:
    lockstep.end(1.0)
    for late in range(20):  # simulated time goes on
        lockstep.tick(0.1 * late)
        lockstep.probe.spin(0.1)
    assert not lockstep.paths
    for index, pose in enumerate(toss(np.random.default_rng(1), 40)):
        lockstep.frame(index, *pose)
        lockstep.probe.spin(0.005)
    assert len(lockstep.path().t) == 31


def test_in_lockstep_a_tracker_that_stood_still_loses_no_frame(lockstep: Lockstep) -> None:
    lockstep.node.send_signal(signal.SIGSTOP)
    try:  # more than the middleware keeps for a process that does not read
        for index, pose in enumerate(toss(np.random.default_rng(1), 300)):
            for _ in range(5):
                lockstep.tick(index * PERIOD * 1e-9)
            lockstep.frame(index, *pose)
            lockstep.probe.spin(0.002)
    finally:
        lockstep.node.send_signal(signal.SIGCONT)
    lockstep.end(9.9)
    assert len(lockstep.path().t) == 298  # within 9.9 s
