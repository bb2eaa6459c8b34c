# SPDX-License-Identifier: Apache-2.0
"""Every motion capture with a set-up: messages as of its driver give the right pancake."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path as FilePath

import numpy as np
import pytest
from conftest import Probe, Processes
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rclpy.parameter import Parameter

from hardware_sim.optitrack_node import OptitrackSim
from hardware_sim.sensors import Mocap, MocapFrame
from wam_power_ros import rotations
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, pose_messages

PAN = np.array([0.8, 0.1, 0.6])
MILLISECOND = 1_000_000  # [ns]
PLACED = [0.5, -0.3, 0.2, 0.0, 0.0, 0.6, 0.8]  # pose of the motion-capture frame in the base frame
HIDDEN = (1.0, 1.08)  # [s] in which the pancake cannot be seen, on its way up
DURATION = 2.0  # [s]
FILMS_MAX = 10  # attempts to see enough states
SLOW_MAX = 10.0  # largest age of frames that a tracker can be set to allow [s]


def toss(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the pancake in the base frame: at rest, thrown at 0.6 s, caught 0.6 s later."""
    free = float(np.clip(t - 0.6, 0.0, 0.6))
    place = PAN + np.array([0.2 * free, 0.05 * free, 2.9 * free - 4.905 * free**2])
    return place, rotations.matrix(rotations.quat_of_vector(np.array([0.1, 5.0 * free, 0.3])))


def of(name: str, *over: FilePath) -> overlay.Setup:
    return overlay.setup([name, *map(str, over)], simulated=True)


class Cameras:
    """A motion-capture driver by its set-up that measures a scripted toss at its own rate."""

    def __init__(self, probe: Probe, parameters: dict[str, object]) -> None:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        self.node = OptitrackSim(context=probe.context, parameter_overrides=overrides)
        self.probe, params = probe, self.node.params
        self._mocap = Mocap(params)

    def film(self, start_ns: int) -> None:
        """Play the toss in steps of a millisecond, at four times real time."""
        self._mocap.restart(1, np.random.default_rng(3))
        begun_ns = time.monotonic_ns()
        for now_ns in range(MILLISECOND, round((DURATION + 0.2) * 1e9), MILLISECOND):
            t = now_ns * 1e-9
            if self._mocap.due(now_ns):
                if HIDDEN[0] < t < HIDDEN[1]:
                    self._mocap.miss(now_ns)
                else:
                    self._mocap.expose(now_ns, *toss(t))
            for frame in self._mocap.delivered(now_ns):
                self.node.publish(frame, start_ns, now_ns)
            ahead = now_ns // 4 - (time.monotonic_ns() - begun_ns)
            if ahead > 5 * MILLISECOND:
                self.probe.spin(ahead * 1e-9)


@pytest.fixture
def cameras(probe: Probe) -> Iterator[list[Cameras]]:
    made: list[Cameras] = []
    yield made
    for each in made:
        each.node.destroy_node()


NAMES = ["natnet_ros2", "vrpn_mocap", "mocap_optitrack", "motion_capture_tracking"]
NAMES += ["motion_capture_tracking_poses", "mocap4r2_optitrack", "mocap4r2_vicon"]
NAMES += ["mocap4r2_qualisys", "vicon_receiver", "apriltag"]
Y_UP = """
pancake_tracker:
  ros__parameters: {up_axis: "y", world_to_base: [0.5, -0.3, 0.2, 0.0, 0.0, 0.6, 0.8]}
"""
ZEROS = "optitrack_sim: {ros__parameters: {lost: zero, dropout: 0.1}}"


@pytest.mark.parametrize(
    ("name", "over"),
    [*((name, "") for name in NAMES), ("natnet_ros2", Y_UP), ("mocap_optitrack", ZEROS)],
    ids=[*NAMES, "motive left at y up", "zeros when lost"],
)
def test_a_toss_comes_out_right_whatever_the_driver_makes_of_it(
    name: str, over: str, probe: Probe, processes: Processes, cameras: list, tmp_path: FilePath
) -> None:
    more = tmp_path / "over.yaml"
    more.write_text(over or "{}")
    setup = of(name, more)
    setup = setup.changed({"pancake_tracker": {"clock_offset_max": SLOW_MAX, "silence": 60.0}})
    file = tmp_path / "parameters.yaml"
    file.write_text(overlay.text(setup))
    processes.node("wam_power_ros.nodes.body_tracker", file)
    states = probe.listen(Odometry, interface.body_topic("pancake", "state"), interface.DEEP)
    paths = probe.listen(Path, interface.rollout_topic("pancake"), interface.LATCHED)
    ends = probe.publisher(Path, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
    camera = Cameras(probe, setup["optitrack_sim"])
    cameras.append(camera)
    topic = setup["pancake_tracker"]["pose_topic"] or setup["pancake_tracker"]["markers_topic"]
    probe.until(lambda: camera.node.count_subscribers(topic), "the tracker listens")
    probe.spin(0.3)

    t = np.arange(0.0, DURATION, 0.01)
    still = np.tile([*PAN, 0.0, 0.0, 0.0, 1.0], (len(t), 1))
    pan = EndEffectorPath("trial-1", t, still[:, :3], still[:, 3:])
    # On a busy machine frames are late: states predicted meanwhile have a larger variance. And
    # states that the probe does not take in time are lost: then the toss is filmed again.
    rate = setup["pancake_tracker"]["rate"]
    measured = 1.01 * setup["pancake_tracker"]["noise"] ** 2
    for _ in range(FILMS_MAX):
        start_ns = time.time_ns()
        camera.film(start_ns)
        if time.time_ns() - start_ns > 0.8e9 * SLOW_MAX:
            continue
        paths.clear()
        ends.publish(pose_messages.path_message(pan, start_ns, "wam_base"))
        path = pose_messages.path(probe.until(lambda: paths and paths[-1], "the path", 60.0))
        timed = [
            ((state.stamp_ns - start_ns) * 1e-9, state)
            for state in map(pose_messages.odometry, states)
            if state.variance < measured
        ]
        resting = [state for at, state in timed if 0.2 < at < 0.55]
        moving = [(at, state) for at, state in timed if 0.1 < at < 0.95]
        # the states are right at rest and in flight, however few came through
        assert all(np.linalg.norm(state.position - toss(at)[0]) < 0.02 for at, state in moving)
        if len(resting) > 0.15 * rate and len(moving) > 0.25 * rate:
            break
        probe.spin(DURATION)  # stamps of the next film must be newer
    else:
        pytest.fail(f"no film of {FILMS_MAX} came through in time with enough states")

    # the path has every measured frame at its time of exposure, and no other
    wanted = rate * (DURATION - HIDDEN[1] + HIDDEN[0])
    assert 0.8 * wanted < len(path.t) < 1.05 * wanted
    assert not ((path.t > HIDDEN[0] + 0.002) & (path.t < HIDDEN[1] - 0.002)).any()
    true = [toss(at) for at in path.t]
    np.testing.assert_allclose(path.position, [place for place, _ in true], atol=0.006)
    normals = rotations.matrix(path.quat_xyzw)[:, :, 2]
    cosines = np.einsum("ij,ij->i", normals, [turned[:, 2] for _, turned in true])
    assert cosines.min() > 0.99
    # and at rest the states do not move
    assert np.median([np.linalg.norm(state.velocity) for state in resting]) < 0.05


def test_a_driver_with_y_up_sends_height_as_its_second_number(probe: Probe, cameras: list) -> None:
    values = of("natnet_ros2")["optitrack_sim"] | {"up_axis": "y", "world_to_base": PLACED}
    camera = Cameras(probe, values)
    cameras.append(camera)
    poses = probe.listen(PoseStamped, "/pancake/pose", interface.STATE_OUT)
    probe.until(lambda: camera.node.count_subscribers("/pancake/pose"), "somebody listens")
    level = np.array([0.0, 0.0, 0.0, 1.0])
    # one metre ahead of the motion capture's origin, which is turned by 73.7 degrees, half above
    ahead = np.array([0.5 + 0.28, -0.3 + 0.96, 0.2 + 0.5])
    frame = MocapFrame(5, ahead, level, np.empty((0, 3)))
    probe.until(
        lambda: camera.node.publish(frame, time.time_ns(), 5) or probe.spin(0.05) or poses, "a pose"
    )
    reading = pose_messages.pose(poses[-1])
    np.testing.assert_allclose(reading.position, [1.0, 0.5, 0.0], atol=1e-9)
    up = rotations.matrix(reading.quat_xyzw)[:, 2]
    np.testing.assert_allclose(up, [0.0, 1.0, 0.0], atol=1e-9)
