# SPDX-License-Identifier: Apache-2.0
"""The tag camera: poses from images, alone and over real DDS up to the tracker's states."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import shown_tags
from conftest import Probe, Processes
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image

from hardware_sim import body_messages
from hardware_sim.tag_film import HUE, BallFilm
from wam_power_ros import rotations
from wam_power_ros.nodes.tag_camera import COLOURS, GREY, pixels
from wam_power_ros.params import overlay
from wam_power_ros.ros import body_sources, interface, pose_messages
from wam_power_ros.ros.stamps import time_message
from wam_power_ros.tracking.ball_detector import BallDetector
from wam_power_ros.tracking.tag_detector import TagDetector

K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
NO_DISTORTION = np.zeros(5)
TAG = "36h11", (3,), 0.06, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
FACING = np.diag([1.0, -1.0, -1.0])


def drawn(place: np.ndarray, rotation: np.ndarray, number: int = 3) -> np.ndarray:
    """Image of a tag at a pose, by the homography of its plane."""
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    printed = np.full((10, 10), 255, np.uint8)
    printed[1:-1, 1:-1] = cv2.aruco.generateImageMarker(known, number, 8)
    texture = np.kron(printed, np.ones((40, 40), np.uint8))
    step = 0.06 / 8 / 40  # [m] of a pixel of the texture
    to_plane = np.array([[step, 0.0, -199.5 * step], [0.0, -step, 199.5 * step], [0.0, 0.0, 1.0]])
    to_image = K @ np.column_stack([rotation[:, :2], place]) @ to_plane
    scale = np.array([[4.0, 0.0, 1.5], [0.0, 4.0, 1.5], [0.0, 0.0, 1.0]])  # drawn four times larger
    large = cv2.warpPerspective(texture, scale @ to_image, (2560, 1920), borderValue=128)
    return cv2.GaussianBlur(
        cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), 0.7
    )


def leaning(tilt: float) -> np.ndarray:
    return rotations.exp(np.array([tilt, 0.0, 0.0])) @ FACING @ rotations.exp([0.0, 0.0, 0.7])


@pytest.mark.parametrize("tilt", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("depth", [0.3, 0.6, 1.0])
def test_the_pose_of_a_drawn_tag_is_found(depth: float, tilt: float) -> None:
    place, rotation = np.array([0.05, -0.04, depth]), leaning(tilt)
    found = TagDetector(*TAG).pose(1, drawn(place, rotation), K, NO_DISTORTION)
    assert np.linalg.norm(found[0] - place) < 1.5e-3 * depth
    assert np.linalg.norm(rotations.log(found[1] @ rotation.T)) < np.deg2rad(0.5)


def test_tags_anywhere_on_a_body_are_seen_and_none_that_is_nearly_edge_on() -> None:
    turn = rotations.exp(np.array([0.3, -0.2, 0.1]))
    pose = (0.03, -0.02, 0.05, *rotations.quat_xyzw(turn))
    detector = TagDetector("36h11", (3,), 0.06, pose)
    place, rotation = np.array([0.02, -0.03, 0.6]), leaning(0.6)
    found = detector.pose(1, drawn(place, rotation), K, NO_DISTORTION)
    wanted = rotation @ turn.T
    assert np.linalg.norm(rotations.log(found[1] @ wanted.T)) < np.deg2rad(0.5)
    assert np.linalg.norm(found[0] + found[1] @ pose[:3] - place) < 1e-3
    with pytest.raises(ValueError, match="edge-on"):
        TagDetector(*TAG).pose(2, drawn(np.array([0.0, 0.0, 0.3]), leaning(1.4)), K, NO_DISTORTION)


def test_an_image_without_the_tag_or_with_one_of_another_size_has_no_pose() -> None:
    place = np.array([0.0, 0.0, 0.5])
    detector = TagDetector(*TAG)
    with pytest.raises(ValueError, match=r"no tag of the body in view, but \[9\]"):
        detector.pose(1, drawn(place, leaning(0.5), number=9), K, NO_DISTORTION)
    wrong = TagDetector("36h11", (3, 4), 0.06, (*TAG[3], 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    both = np.minimum(
        drawn(place, leaning(0.5)), drawn(np.array([0.1, 0.0, 0.5]), leaning(0.5), number=4)
    )
    with pytest.raises(ValueError, match=r"tags \[3, 4\] do not fit"):
        wrong.pose(1, both, K, NO_DISTORTION)


def test_of_two_poses_that_fit_alike_the_one_that_continues_the_last_is_taken() -> None:
    small, detector = np.array([0.0, 0.0, 2.2]), TagDetector(*TAG)
    rng = np.random.default_rng(2)

    def noisy(tilt: float) -> np.ndarray:
        image = drawn(small, leaning(tilt)).astype(float)
        return np.clip(image + 2.0 * rng.standard_normal(image.shape), 0, 255).astype(np.uint8)

    unclear = 0
    for _ in range(20):  # without a last pose a doubtful one is refused, never guessed
        try:
            pose = TagDetector(*TAG).pose(1, noisy(0.25), K, NO_DISTORTION)
        except ValueError as error:
            assert "fit alike" in str(error)
            unclear += 1
        else:
            assert np.linalg.norm(rotations.log(pose[1] @ leaning(0.25).T)) < 0.5
    assert unclear > 0
    near = drawn(np.array([0.0, 0.0, 0.4]), leaning(0.25))  # clear
    detector.pose(1, near, K, NO_DISTORTION)
    for step in range(1, 20):
        pose = detector.pose(1 + step * 30_000_000, noisy(0.25), K, NO_DISTORTION)
        assert np.linalg.norm(rotations.log(pose[1] @ leaning(0.25).T)) < 0.35


def test_images_of_every_encoding_are_read_and_others_named() -> None:
    rng = np.random.default_rng(0)
    colours = rng.integers(0, 255, (4, 6, 3), dtype=np.uint8)
    wanted = cv2.cvtColor(colours, cv2.COLOR_RGB2GRAY)
    shapes = {"rgb8": colours, "bgr8": colours[..., ::-1], "mono8": wanted[..., None]}
    shapes["rgba8"] = np.concatenate([colours, colours[..., :1]], axis=2)
    for encoding, values in shapes.items():
        padded = np.pad(values.reshape(4, -1), ((0, 0), (0, 5)))
        message = Image(height=4, width=6, step=padded.shape[1], encoding=encoding)
        message.data = padded.tobytes()
        np.testing.assert_array_equal(pixels(message, GREY), wanted)
        if encoding in COLOURS:
            np.testing.assert_array_equal(pixels(message, COLOURS), colours[..., ::-1])
    message.encoding = "16UC1"
    with pytest.raises(ValueError, match="encoding '16UC1' is none of"):
        pixels(message, GREY)
    message.encoding, message.height = "mono8", 7
    with pytest.raises(ValueError, match="are no 7 rows"):
        pixels(message, GREY)


def test_a_tag_is_measured_to_a_millimetre_through_a_distorting_lens() -> None:
    found = shown_tags.measure(shown_tags.ONE)
    errors = np.array(found["errors"])
    assert len(errors) >= 57, found["lost"]
    assert (np.median(errors, axis=0) < [0.5, 0.15]).all()
    assert (np.percentile(errors, 95, axis=0) < [2.0, 1.0]).all()


def test_a_ball_is_found_by_its_outline_whatever_lights_it_and_hides_a_part() -> None:
    film, detector, rng = BallFilm(0.018), BallDetector(0.018, HUE), np.random.default_rng(1)
    errors = []
    for number in range(60):
        depth = rng.uniform(0.6, 1.6)
        place = depth * np.array([*rng.uniform(-0.2, 0.2, 2), 1.0])
        twist = np.array([*rng.uniform(-0.5, 0.5, 3), 0.0, 0.0, 0.0])
        image, corner = film.window(place, np.eye(3), rng, twist)
        if number % 3 == 0:  # a string, or the rim of a cup
            image[:, image.shape[1] // 2 : image.shape[1] // 2 + 3] = 128
        k = shown_tags.K.copy()
        k[:2, 2] -= corner
        found, turned = detector.pose(1, image, k, shown_tags.D)
        along = place / np.linalg.norm(place)
        off = found - place
        errors.append([np.linalg.norm(off - (off @ along) * along), abs(off @ along) / depth])
        assert (turned == np.eye(3)).all()
    assert (np.percentile(errors, 90, axis=0) < [1e-3, 0.03]).all()


def test_a_ball_of_which_a_fifth_of_the_outline_is_hidden_is_where_it_was() -> None:
    place = np.array([0.0, 0.0, 0.8])
    image, corner = BallFilm(0.018).window(place, np.eye(3), np.random.default_rng(1))
    k = shown_tags.K.copy()
    k[:2, 2] -= corner
    whole, _ = BallDetector(0.018, HUE).pose(1, image, k, shown_tags.D)
    image[:, round(k[0, 2] + 16.5) :] = 128  # of a radius of 20 pixels
    found, _ = BallDetector(0.018, HUE).pose(1, image, k, shown_tags.D)
    assert np.abs(found - whole).max() < 0.01


def test_where_no_ball_is_seen_whole_there_is_no_position() -> None:
    film, rng = BallFilm(0.018), np.random.default_rng(1)
    image, _ = film.window(np.array([0.0, 0.0, 1.0]), np.eye(3), rng)
    find = lambda hue, image: BallDetector(0.018, hue).pose(1, image, shown_tags.K, NO_DISTORTION)  # noqa: E731
    for hue, shown, text in (
        (120.0, image, "no ball with a hue of 120 degrees"),
        (HUE, image[:, : image.shape[1] // 2], "edge of the image"),
        (HUE, image[:0], "no image"),
        (HUE, np.full_like(image, 128), "no ball"),
    ):
        with pytest.raises(ValueError, match=text):
            find(hue, shown)
    cut, box = image.copy(), np.full_like(image, 128)
    cut[:, image.shape[1] // 2 :] = 128  # half of it is hidden
    box[30:70, 30:60] = image[image.shape[0] // 2, image.shape[1] // 2]
    for shown in (cut, box):
        with pytest.raises(ValueError, match="no ball's"):
            find(HUE, shown)


def test_images_become_states_of_the_tracker(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    file = tmp_path / "lab.yaml"
    tags, size, poses = (shown_tags.TWO[number] for number in (1, 2, 3))
    file.write_text(
        "pancake_tracker: {ros__parameters: {rate: 15.0}}\n"
        f"tag_camera: {{ros__parameters: {{tags: {[*tags]}, tag_size: {size}, "
        f"tag_poses: {[*poses]}}}}}\n"
    )
    setup = overlay.setup([str(file)], simulated=True)
    parameters = tmp_path / "parameters.yaml"
    parameters.write_text(overlay.text(setup))
    position, rotation = shown_tags.CAMERA
    kind = body_sources.message_class(body_sources.TF_TYPE)
    fixed = probe.publisher(kind, "/tf_static", interface.LATCHED, readers=0)
    place = position, rotations.quat_xyzw(rotation)
    fixed.publish(body_messages.message(body_sources.TF_TYPE, 1, "world", "camera_optical", *place))
    reports = probe.diagnostics()
    states = probe.listen(Odometry, "pancake/state", interface.DEEP)
    poses = probe.listen(PoseStamped, "pancake/pose", interface.DEEP)
    processes.node("wam_power_ros.nodes.tag_camera", parameters)
    processes.node("wam_power_ros.nodes.body_tracker", parameters)
    processes.start([sys.executable, shown_tags.__file__])
    probe.until(lambda: len(states) > 40, "states")
    off = []
    for reading in map(pose_messages.pose, poses):
        place, turned = shown_tags.truth(reading.stamp_ns * 1e-9 % 1000.0)
        assert reading.frame == "camera_optical"
        turn = rotations.log(rotations.matrix(reading.quat_xyzw) @ turned.T)
        off.append((np.linalg.norm(reading.position - place), np.linalg.norm(turn)))
    # The clock chooses the views, and of one tag in a hundred the pose is off by millimetres.
    assert (np.quantile(off, 0.8, axis=0) < (3e-3, np.deg2rad(1.0))).all()
    measured = {pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec for pose in poses}
    for state in map(pose_messages.odometry, states):
        if state.stamp_ns in measured:
            place, _ = shown_tags.truth(state.stamp_ns * 1e-9 % 1000.0)
            assert np.linalg.norm(state.position - position - rotation @ place) < 2e-2

    def said() -> str:
        status = [each for report in reports for each in report.status if "tags" in each.name]
        return next(
            (each.value for it in status for each in it.values if "latency" in each.key), ""
        )

    assert 0.0 < float(probe.until(said, "the latency")) < 5.0


def test_what_is_missing_is_in_the_diagnostics(probe: Probe, processes: Processes) -> None:
    processes.node("wam_power_ros.nodes.tag_camera", "tag_camera.yaml")
    reports = probe.diagnostics()
    images = probe.publisher(Image, "camera/image_raw", interface.STATE_OUT)
    infos = probe.publisher(CameraInfo, "camera/camera_info", interface.STATE_OUT)
    message = Image(height=480, width=640, step=640, encoding="mono8")
    message.data = bytes(640 * 480)

    def said(words: str) -> bool:
        message.header.stamp = time_message(time.time_ns())
        images.publish(message)
        probe.spin(0.1)
        return any(words in str(report.status) for report in reports)

    probe.until(lambda: said("no usable calibration on camera/camera_info"), "the calibration")
    fisheye = CameraInfo(distortion_model="equidistant", k=[600.0, 0.0, 320.0] * 3)
    infos.publish(fisheye)
    probe.until(lambda: said("calibration 'equidistant'") or infos.publish(fisheye), "the model")
    usable = CameraInfo(distortion_model="plumb_bob", k=K.ravel().tolist(), d=[0.0] * 5)
    infos.publish(usable)
    probe.until(lambda: said("no tag of the body in view") or infos.publish(usable), "the tag")
