# SPDX-License-Identifier: Apache-2.0
"""Every source of a pose over real DDS: the states are true, and no frame is taken for another."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Probe, Processes
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter

from hardware_sim import body_messages
from hardware_sim.optitrack_node import OptitrackSim
from hardware_sim.sensors import MocapFrame
from wam_power_ros import rotations
from wam_power_ros.params import body_tracker_params, overlay
from wam_power_ros.params.body_tracker_params import MESSAGE_TYPES
from wam_power_ros.ros import body_sources, interface, pose_messages
from wam_power_ros.tracking.frame_tree import compose
from wam_power_ros.tracking.marker_fit import LAYOUT

BASE = "world_to_base: [0.5, -0.3, 0.2, 0.0, 0.0, 0.6, 0.8]"  # of every lab
SETUPS = {  # what the set-up of a source says, at most six lines
    "PoseStamped": "pose_topic: a/pose",
    "PoseStamped, y up": "pose_topic: a/pose\nup_axis: 'y'",
    "PoseWithCovarianceStamped": """
pose_topic: tracker/pose
message_type: geometry_msgs/msg/PoseWithCovarianceStamped""",
    "TransformStamped": """
pose_topic: vicon/pancake
message_type: geometry_msgs/msg/TransformStamped
mocap_frame: vicon""",
    "PoseArray": """
pose_topic: objects
message_type: geometry_msgs/msg/PoseArray
body_in_message: '2'""",
    "Odometry": """
pose_topic: t265/odom
message_type: nav_msgs/msg/Odometry
mocap_frame: odom""",
    "NamedPoseArray": """
pose_topic: poses
message_type: motion_capture_tracking_interfaces/msg/NamedPoseArray""",
    "RigidBodies": """
pose_topic: rigid_bodies
message_type: mocap4r2_msgs/msg/RigidBodies
body_in_message: '{body}.{body}'
mocap_frame: map""",
    "Markers": """
pose_topic: ''
markers_topic: markers
message_type: mocap4r2_msgs/msg/Markers
mocap_frame: map""",
    "PointCloud2": "pose_topic: ''\nmarkers_topic: pointCloud",
    "a frame of /tf": """
pose_topic: /tf
message_type: tf2_msgs/msg/TFMessage
body_in_message: tag36h11:0""",
}
RATE = 40.0  # [Hz]
CAMERA = np.array([1.5, -0.4, 1.2]), np.array([0.6, -0.64, 0.32, -0.36])  # in the mocap_frame
CAMERA = CAMERA[0], CAMERA[1] / np.linalg.norm(CAMERA[1])


def truth(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Position and quaternion of a body that is carried about, in the base frame."""
    place = np.array([0.8, 0.1, 0.6]) + 0.1 * np.sin([2.0 * t, 1.3 * t, 1.7 * t])
    return place, rotations.quat_of_vector(np.array([0.5 * np.sin(t), 0.4, 0.3 * t % 1.0]))


class Bench:
    """A tracker and a stand-in of one set-up."""

    def __init__(self, probe: Probe, processes: Processes, folder: Path, lines: str) -> None:
        assert len(lines.strip().splitlines()) <= 6
        file = folder / "lab.yaml"
        text = "\n".join(f"    {it}" for it in [BASE, f"rate: {RATE}", *lines.strip().splitlines()])
        file.write_text(f"pancake_tracker:\n  ros__parameters:\n{text}\n")
        setup = overlay.setup([str(file)], simulated=True)
        parameters = folder / "parameters.yaml"
        parameters.write_text(overlay.text(setup))
        self.probe, self.setup = probe, setup
        self.tracker = processes.node("wam_power_ros.nodes.body_tracker", parameters)
        self.states = probe.listen(Odometry, "pancake/state", interface.DEEP)
        self.reports = probe.listen(
            DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS
        )
        self.topic = setup["pancake_tracker"]["pose_topic"] or "markers"

    def camera(self, **changes: str) -> OptitrackSim:
        """Stand-in of the set-up, but for some parameters."""
        values = self.setup["optitrack_sim"] | changes
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        return OptitrackSim(context=self.probe.context, parameter_overrides=overrides)

    def film(self, camera: OptitrackSim, until: Callable[[], object], what: str) -> None:
        """Publish frames of the moving body in real time."""

        def send() -> object:
            stamp_ns = time.time_ns()
            place, quat = truth(stamp_ns * 1e-9 % 1000.0)
            markers = place + LAYOUT @ rotations.matrix(quat).T
            camera.publish(MocapFrame(stamp_ns, place, quat, markers), 0, stamp_ns)
            self.probe.spin(1.0 / RATE)
            return until()

        self.probe.until(send, what)

    def measured(self) -> list[pose_messages.StateReading]:
        """States that are not extrapolated."""
        variance = 1.01 * self.setup["pancake_tracker"]["noise"] ** 2
        states = map(pose_messages.odometry, self.states)
        return [state for state in states if state.variance < variance]

    def require_true(self) -> None:
        """Require states within 1 mm and half a degree of the truth."""
        for state in self.measured():
            place, quat = truth(state.stamp_ns * 1e-9 % 1000.0)
            assert state.frame == "wam_base"
            assert np.linalg.norm(state.position - place) < 1e-3
            assert 2.0 * np.arccos(min(1.0, abs(state.quat_xyzw.dot(quat)))) < np.deg2rad(0.5)

    def said(self, words: str) -> bool:
        """Whether the diagnostics have these words."""
        return any(words in str(status) for report in self.reports for status in report.status)


def test_there_is_a_reader_for_every_type_and_a_set_up_of_each_is_tested() -> None:
    assert set(body_sources.SOURCES) == set(body_messages.FILLS) == set(MESSAGE_TYPES)
    tested = "".join(SETUPS) + "a TFMessage"
    assert all(name.rpartition("/")[2] in tested for name in MESSAGE_TYPES)


@pytest.mark.parametrize("name", SETUPS)
def test_states_are_true_whatever_brings_the_pose(
    name: str, probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Bench(probe, processes, tmp_path, SETUPS[name])
    camera = bench.camera()
    try:
        bench.film(camera, lambda: len(bench.measured()) > 40, "states")
    finally:
        camera.destroy_node()
    bench.require_true()


@pytest.mark.parametrize("name", ["PoseStamped, y up", "Markers", "a frame of /tf"])
def test_a_foreign_frame_is_refused_by_name_until_tf_has_it_then_transformed(
    name: str, probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Bench(probe, processes, tmp_path, SETUPS[name])
    frame = bench.setup["pancake_tracker"]["mocap_frame"]
    camera = bench.camera(frame="camera_optical_frame")
    try:
        refused = f"'camera_optical_frame' is not connected to '{frame}'"
        bench.film(camera, lambda: bench.said(refused), "the refusal")
        assert not bench.states
    finally:
        camera.destroy_node()
    # the same camera, whose frame is where the stand-in's coordinates begin
    kind = body_sources.message_class(body_sources.TF_TYPE)
    fixed = probe.publisher(kind, "/tf_static", interface.LATCHED)
    first = body_messages.message(body_sources.TF_TYPE, 1, frame, "mount", *CAMERA)
    back = CAMERA[1] * np.array([-1.0, -1.0, -1.0, 1.0])
    inverse = -rotations.matrix(back) @ CAMERA[0], back
    np.testing.assert_allclose(compose(CAMERA, inverse)[0], 0.0, atol=1e-12)
    second = body_messages.message(
        body_sources.TF_TYPE, 1, "mount", "camera_optical_frame", *inverse
    )
    first.transforms = [*first.transforms, *second.transforms]
    fixed.publish(first)
    camera = bench.camera(frame="camera_optical_frame")
    try:
        bench.film(camera, lambda: len(bench.measured()) > 40, "states")
    finally:
        camera.destroy_node()
    bench.require_true()


def test_a_message_without_the_body_is_refused_with_the_names_in_it(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Bench(probe, processes, tmp_path, SETUPS["NamedPoseArray"])
    camera = bench.camera(body_in_message="plate")
    try:
        words = "no body 'pancake'; it has ['another_body', 'plate']"
        bench.film(camera, lambda: bench.said(words), "the refusal")
    finally:
        camera.destroy_node()
    assert not bench.states


def test_a_frame_that_tf_does_not_have_is_named_with_those_it_has(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Bench(probe, processes, tmp_path, SETUPS["a frame of /tf"])
    camera = bench.camera(body_in_message="tag36h11:7")
    try:
        words = "/tf has no frame 'tag36h11:0'; it has ['tag36h11:7']"
        bench.film(camera, lambda: bench.said(words), "the report")
    finally:
        camera.destroy_node()
    assert not bench.states


def test_a_package_that_is_missing_is_named_with_what_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(body_tracker_params, "find_spec", lambda package: None)
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    with pytest.raises(ValueError, match="apt install ros-kilted-mocap4r2-msgs; without ROS"):
        body_sources.message_class("mocap4r2_msgs/msg/RigidBodies")
