# SPDX-License-Identifier: Apache-2.0
"""The tag camera: poses from images."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import shown_tags
from sensor_msgs.msg import CameraInfo, Image

from wam_power_ros import rotations
from wam_power_ros.nodes.tag_camera import TagCamera, grey_image
from wam_power_ros.nodes.tag_detector import TagDetector
from wam_power_ros.ros import pose_messages
from wam_power_ros.ros.stamps import time_message

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


@pytest.mark.parametrize(("depth", "tilt"), [(0.3, 0.9), (0.6, 0.6), (1.0, 0.3)])
def test_the_pose_of_a_drawn_tag_is_found(depth: float, tilt: float) -> None:
    place, rotation = np.array([0.05, -0.04, depth]), leaning(tilt)
    found = TagDetector(*TAG).pose(1, drawn(place, rotation), K, NO_DISTORTION)
    assert np.linalg.norm(found[0] - place) < 1.5e-3 * depth
    assert np.linalg.norm(rotations.log(found[1] @ rotation.T)) < np.deg2rad(0.5)


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
    for _ in range(8):  # without a last pose a doubtful one is refused, never guessed
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
    for step in range(1, 8):
        pose = detector.pose(1 + step * 30_000_000, noisy(0.25), K, NO_DISTORTION)
        assert np.linalg.norm(rotations.log(pose[1] @ leaning(0.25).T)) < 0.35


def test_images_of_every_encoding_are_read_and_others_named() -> None:
    rng = np.random.default_rng(0)
    colours = rng.integers(0, 255, (4, 6, 3), dtype=np.uint8)
    wanted = cv2.cvtColor(colours, cv2.COLOR_RGB2GRAY)
    shapes = {"rgb8": colours, "bgr8": colours[..., ::-1], "mono8": wanted[..., None]}
    shapes["rgba8"] = np.concatenate([colours, colours[..., :1]], axis=2)
    for encoding, pixels in shapes.items():
        padded = np.pad(pixels.reshape(4, -1), ((0, 0), (0, 5)))
        message = Image(height=4, width=6, step=padded.shape[1], encoding=encoding)
        message.data = padded.tobytes()
        np.testing.assert_array_equal(grey_image(message), wanted)
    message.encoding = "16UC1"
    with pytest.raises(ValueError, match="encoding '16UC1' is none of"):
        grey_image(message)
    message.encoding, message.height = "mono8", 7
    with pytest.raises(ValueError, match="are no 7 rows"):
        grey_image(message)


def test_tags_are_measured_to_a_millimetre_through_a_distorting_lens() -> None:
    for tags in (shown_tags.ONE, shown_tags.TWO):
        found = shown_tags.measure(tags, 20)
        errors = np.array(found["errors"])
        assert len(errors) >= 19, found["lost"]
        assert (np.median(errors, axis=0) < [0.5, 0.15]).all()
        assert (np.percentile(errors, 95, axis=0) < [2.0, 1.0]).all()


def test_images_become_poses_in_the_frame_of_the_camera_and_what_is_missing_is_said(
    node_here: Callable[..., TagCamera],
) -> None:
    tags, size, poses = shown_tags.TWO[1:]
    given = {"tags": [*tags], "tag_size": size, "tag_poses": [*poses]}
    camera, sent, said = node_here(TagCamera, "tag_camera.yaml", **given), [], []
    camera._poses = SimpleNamespace(publish=sent.append)
    camera._diagnostics = SimpleNamespace(publish=lambda *of: said.append(of))
    film = shown_tags.Film(shown_tags.TWO)

    def report() -> tuple[str, str]:
        camera._report()
        return said[-1][:2]

    def show(t: float, grey: np.ndarray) -> None:
        message = Image(height=480, width=640, step=640, encoding="mono8", data=grey.tobytes())
        message.header.stamp = time_message(round(t * 1e9))
        message.header.frame_id = "camera_optical"
        camera._on_image(message)

    assert report() == ("stale", "no image yet")
    show(1.0, film.image(*shown_tags.truth(1.0)))
    assert report() == ("warn", "no usable calibration on camera/camera_info")
    camera._on_info(CameraInfo(distortion_model="equidistant", k=shown_tags.K.ravel()))
    assert "calibration 'equidistant'" in report()[1]
    model = {"k": shown_tags.K.ravel(), "d": shown_tags.D.tolist()}
    camera._on_info(CameraInfo(distortion_model="plumb_bob", **model))
    show(1.0, np.zeros((480, 640), np.uint8))
    assert "no tag of the body in view" in report()[1]
    for number in range(10):
        show(2.0 + 0.3 * number, film.image(*shown_tags.truth(2.0 + 0.3 * number)))
    assert report() == ("ok", f"{len(sent)} of 10 images") and len(sent) >= 9
    for reading in map(pose_messages.pose, sent):
        place, turned = shown_tags.truth(reading.stamp_ns * 1e-9)
        assert reading.frame == "camera_optical"
        assert np.linalg.norm(reading.position - place) < 3e-3
        turn = rotations.log(rotations.matrix(reading.quat_xyzw) @ turned.T)
        assert np.linalg.norm(turn) < np.deg2rad(1.0)
