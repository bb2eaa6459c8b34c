# SPDX-License-Identifier: Apache-2.0
"""Every source of a pose: what is tracked is true.

Messages of the stand-in are read and tracked as the node does, without a middleware.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.logging import get_logger
from rclpy.parameter import Parameter

from hardware_sim import body_messages
from hardware_sim.optitrack_node import OptitrackSim
from hardware_sim.sensors import Mocap, MocapFrame
from wam_power_ros import rotations
from wam_power_ros.params import body_tracker_params, overlay
from wam_power_ros.params.body_tracker_params import MESSAGE_TYPES, BodyTrackerParams
from wam_power_ros.ros import body_sources, interface
from wam_power_ros.ros.body_sources import BodySource
from wam_power_ros.tracking.frame_tree import compose
from wam_power_ros.tracking.tracker import TrackedState, Tracker

PLACED = "world_to_base: [0.5, -0.3, 0.2, 0.0, 0.0, 0.6, 0.8]"
SOURCES = {  # what the set-up of a source says
    "PoseStamped, y up": "{pose_topic: a/pose, up_axis: 'y'}",
    "PoseWithCovarianceStamped": "{message_type: geometry_msgs/msg/PoseWithCovarianceStamped}",
    "TransformStamped": "{message_type: geometry_msgs/msg/TransformStamped, mocap_frame: vicon}",
    "PoseArray": "{message_type: geometry_msgs/msg/PoseArray, body_in_message: '2'}",
    "Odometry": "{message_type: nav_msgs/msg/Odometry, mocap_frame: odom}",
    "NamedPoseArray": "{message_type: motion_capture_tracking_interfaces/msg/NamedPoseArray}",
    "RigidBodies": "{message_type: mocap4r2_msgs/msg/RigidBodies, body_in_message: 'a.{body}'}",
    "Markers": "{pose_topic: '', markers_topic: m, message_type: mocap4r2_msgs/msg/Markers}",
    "PointCloud2": "{pose_topic: '', markers_topic: pointCloud}",
    "a TFMessage": "{message_type: tf2_msgs/msg/TFMessage, body_in_message: 'a:0'}",
}
PAN = np.array([0.8, 0.1, 0.6])
CAMERA = np.array([1.5, -0.4, 1.2]), np.array([0.6, -0.64, 0.32, -0.36])  # in the mocap_frame
CAMERA = CAMERA[0], CAMERA[1] / np.linalg.norm(CAMERA[1])
BEGIN_NS = 10**18
HIDDEN = (1.0, 1.08)  # [s] in which the pancake cannot be seen, on its way up
DURATION = 2.0  # [s]


def toss(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the pancake in the base frame: at rest, thrown at 0.6 s, caught 0.6 s later."""
    free = float(np.clip(t - 0.6, 0.0, 0.6))
    place = PAN + np.array([0.2 * free, 0.05 * free, 2.9 * free - 4.905 * free**2])
    return place, rotations.matrix(rotations.quat_of_vector(np.array([0.1, 5.0 * free, 0.3])))


@pytest.fixture(scope="module")
def context() -> Iterator[rclpy.Context]:
    context = rclpy.Context()
    rclpy.init(context=context)
    yield context
    rclpy.shutdown(context=context)


class Bench:
    """The cameras and the source of a set-up, and frames of /tf that are heard."""

    def __init__(self, context: rclpy.Context, folder: Path, *names: str, lines: str = "") -> None:
        file = folder / "lab.yaml"
        file.write_text(f"pancake_tracker: {{ros__parameters: {lines or '{}'}}}")
        self.setup = overlay.setup([*names, str(file)], simulated=True)
        self._context = context
        self.params = BodyTrackerParams.from_setup(self.setup)
        self.heard: dict[str, Callable[[Any], None]] = {}
        node = SimpleNamespace(
            resolve_topic_name=lambda name: name,
            create_subscription=lambda kind, topic, then, qos: self.heard.update({topic: then}),
            get_logger=lambda: get_logger("bench"),
        )
        self.source, self.tracker = BodySource(node, self.params), Tracker(self.params)

    def messages(self, **changes: object) -> tuple[OptitrackSim, list[Any]]:
        """Cameras, but for some parameters, and the messages that they will have sent."""
        values = self.setup["optitrack_sim"] | changes
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        camera = OptitrackSim(context=self._context, parameter_overrides=overrides)
        sent: list[Any] = []
        publisher = "_markers" if self.params.markers_topic else "_poses"
        setattr(camera, publisher, SimpleNamespace(publish=sent.append))
        return camera, sent

    def one(self, **changes: object) -> Any:  # noqa: ANN401
        """A message about the body at rest."""
        camera, sent = self.messages(**changes)
        camera.publish(MocapFrame(5, PAN, np.array([0.0, 0.0, 0.0, 1.0]), PAN[None]), BEGIN_NS, 5)
        camera.destroy_node()
        return sent[-1]

    def film(self) -> list[tuple[float, TrackedState]]:
        """Measured states of a toss, with their times since its begin [s]."""
        camera, sent = self.messages()
        mocap, found = Mocap(camera.params), []
        mocap.restart(1, np.random.default_rng(3))
        for now_ns in range(1_000_000, round((DURATION + 0.2) * 1e9), 1_000_000):
            if mocap.due(now_ns):
                if HIDDEN[0] < now_ns * 1e-9 < HIDDEN[1]:
                    mocap.miss(now_ns)
                else:
                    mocap.expose(now_ns, *toss(now_ns * 1e-9))
            for frame in mocap.delivered(now_ns):
                camera.publish(frame, BEGIN_NS, now_ns)
            while sent:
                if (state := self.track(sent.pop(0))) is not None:
                    found.append(((state.stamp_ns - BEGIN_NS) * 1e-9, state))
        camera.destroy_node()
        return found

    def track(self, message: Any) -> TrackedState | None:  # noqa: ANN401
        """State after a message, as the node makes it."""
        stamp_ns, _, *measured = self.source.read(message)
        add = self.tracker.add_markers if self.params.markers_topic else self.tracker.add
        return add(stamp_ns, *measured)


def test_there_is_a_reader_for_every_type_and_a_set_up_of_each_is_tested() -> None:
    assert set(body_sources.SOURCES) == set(body_messages.FILLS) == set(MESSAGE_TYPES)
    assert all(name.rpartition("/")[2] in "".join(SOURCES) for name in MESSAGE_TYPES)


ZEROS = "optitrack_sim: {ros__parameters: {lost: zero, dropout: 0.1}}"


@pytest.mark.parametrize("name", [*SOURCES, "zeros when lost"])
def test_a_toss_comes_out_right_whatever_brings_its_poses(
    name: str, context: rclpy.Context, tmp_path: Path
) -> None:
    (placed := tmp_path / "placed.yaml").write_text(
        f"pancake_tracker: {{ros__parameters: {{{PLACED}}}}}\n"
        + (ZEROS if name == "zeros when lost" else "")
    )
    names = [] if name in SOURCES else ["natnet_ros2"]
    bench = Bench(context, tmp_path, *names, str(placed), lines=SOURCES.get(name, ""))
    states = bench.film()
    for at, state in states:
        if 0.1 < at < 0.95:
            assert np.linalg.norm(state.position - toss(at)[0]) < 0.02
    # the path has every measured frame at its time of exposure, and no other
    path = bench.tracker.path("a", BEGIN_NS, BEGIN_NS + round(DURATION * 1e9))
    lost = 0.85 if name == "zeros when lost" else 0.95
    wanted = bench.params.rate * (DURATION - HIDDEN[1] + HIDDEN[0])
    assert lost * wanted < len(path.t) < 1.05 * wanted
    assert not ((path.t > HIDDEN[0] + 0.002) & (path.t < HIDDEN[1] - 0.002)).any()
    true = [toss(at) for at in path.t]
    np.testing.assert_allclose(path.position, [place for place, _ in true], atol=0.006)
    normals = rotations.matrix(path.quat_xyzw)[:, :, 2]
    cosines = np.einsum("ij,ij->i", normals, [turned[:, 2] for _, turned in true])
    assert cosines.min() > 0.99
    resting = [state for at, state in states if 0.2 < at < 0.55]  # and there it does not move
    assert np.median([np.linalg.norm(state.velocity) for state in resting]) < 0.05


@pytest.mark.parametrize("name", ["PoseStamped, y up", "Markers", "a TFMessage"])
def test_a_foreign_frame_is_refused_by_name_until_tf_has_it_then_transformed(
    name: str, context: rclpy.Context, tmp_path: Path
) -> None:
    bench = Bench(context, tmp_path, lines=SOURCES[name])
    frame = bench.params.mocap_frame
    foreign = bench.one(frame="camera_optical_frame")
    refused = f"'camera_optical_frame' is not connected to '{frame}'"
    with pytest.raises(ValueError, match=refused):
        bench.source.read(foreign)
    # a mount, and on it the camera, whose frame is where the stand-in's coordinates begin
    back = CAMERA[1] * np.array([-1.0, -1.0, -1.0, 1.0])
    inverse = -rotations.matrix(back) @ CAMERA[0], back
    np.testing.assert_allclose(compose(CAMERA, inverse)[0], 0.0, atol=1e-12)
    for parent, child, pose in (
        (frame, "/mount", CAMERA),
        ("mount", "camera_optical_frame", inverse),
    ):
        message = body_messages.message(body_sources.TF_TYPE, 0, parent, child, *pose)
        bench.heard[interface.TF_STATIC](message)
    own, found = bench.source.read(bench.one()), bench.source.read(foreign)
    assert (found.frame, found.stamp_ns) == (frame, own.stamp_ns)
    for seen, wanted in zip(found[2:], own[2:], strict=True):
        np.testing.assert_allclose(seen, wanted, atol=1e-6)
    on_mount = bench.source.read(bench.one(frame="mount"))[2]
    turned = own[2] @ rotations.matrix(CAMERA[1]).T
    np.testing.assert_allclose(on_mount, turned + CAMERA[0], atol=1e-6)


def test_a_body_that_is_not_there_is_named_with_those_that_are(
    context: rclpy.Context, tmp_path: Path
) -> None:
    bench = Bench(context, tmp_path, lines=SOURCES["NamedPoseArray"])
    names = r"no body 'pancake'; it has \['another_body', 'plate'\]"
    with pytest.raises(ValueError, match=names):
        bench.source.read(bench.one(body_in_message="plate"))
    bench = Bench(context, tmp_path, lines=SOURCES["a TFMessage"])
    assert bench.source.read(bench.one(body_in_message="a:7")) is None
    assert bench.source.missing == "/tf has no frame 'a:0'; it has ['a:7']"
    assert bench.source.read(bench.one()) is not None and bench.source.missing == ""


def test_a_package_that_is_missing_is_named_with_what_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(body_tracker_params, "find_spec", lambda package: None)
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    with pytest.raises(ValueError, match="apt install ros-kilted-mocap4r2-msgs; without ROS"):
        body_sources.message_class("mocap4r2_msgs/msg/RigidBodies")
