# SPDX-License-Identifier: Apache-2.0
"""Camera with tags or a ball: images, their calibration in, pose out, stamped as the image.

The pose is in the optical frame of the camera.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping

import cv2
import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from wam_power_ros import rotations
from wam_power_ros.params.driver_params import TagCameraParams
from wam_power_ros.ros import interface, node_runner, pose_messages
from wam_power_ros.ros.diagnostics import Diagnostics
from wam_power_ros.ros.stamps import sensor_stamp
from wam_power_ros.tracking.ball_detector import BallDetector
from wam_power_ros.tracking.tag_detector import TagDetector

GREY = {"rgb8": cv2.COLOR_RGB2GRAY, "bgr8": cv2.COLOR_BGR2GRAY, "mono8": None}
GREY |= {"rgba8": cv2.COLOR_RGBA2GRAY, "bgra8": cv2.COLOR_BGRA2GRAY}
COLOURS = {"rgb8": cv2.COLOR_RGB2BGR, "bgr8": None}
COLOURS |= {"rgba8": cv2.COLOR_RGBA2BGR, "bgra8": cv2.COLOR_BGRA2BGR}
MODELS = ("", "plumb_bob", "rational_polynomial")  # of the distortion


def pixels(message: Image, codes: Mapping[str, int | None]) -> np.ndarray:
    """Grey values (h, w) or colours (h, w, 3) in BGR; a ValueError names another encoding."""
    if message.encoding not in codes:
        raise ValueError(f"encoding {message.encoding!r} is none of {list(codes)}")
    channels = {"mono8": 1, "rgb8": 3, "bgr8": 3}.get(message.encoding, 4)
    rows, width = np.frombuffer(message.data, np.uint8), message.width * channels
    if message.step < width or len(rows) != message.step * message.height or not len(rows):
        raise ValueError(f"{len(rows)} bytes are no {message.height} rows of {message.step} bytes")
    image = rows.reshape(message.height, message.step)[:, :width]
    image = image.reshape(message.height, message.width, channels)
    image = image[..., 0] if channels == 1 else image
    code = codes[message.encoding]
    return np.ascontiguousarray(image) if code is None else cv2.cvtColor(image, code)


class TagCamera(Node):
    """Publishes a pose for each image in which tags of the body, or a ball, are seen."""

    def __init__(self) -> None:
        super().__init__("tag_camera", automatically_declare_parameters_from_overrides=True)
        self._params = params = TagCameraParams.from_node(self)
        cv2.setNumThreads(1)  # the controller's machine has other things to do
        self._detector: BallDetector | TagDetector
        if params.ball_radius:
            self._detector = BallDetector(params.ball_radius, params.ball_hue)
        else:
            given = params.family, params.tags, params.tag_size, params.tag_poses
            self._detector = TagDetector(*given)
        self._codes = COLOURS if params.ball_radius else GREY
        self._problem = "no image yet"
        self._camera: tuple[np.ndarray, np.ndarray] | None = None
        self._recent: deque[tuple[float, float, bool]] = deque(maxlen=100)
        topic = interface.body_topic(params.body, "pose")
        self._poses = self.create_publisher(PoseStamped, topic, interface.STATE_OUT)
        self._diagnostics = Diagnostics(self, "tags", params.body)
        subscribe, newest = self.create_subscription, interface.NEWEST
        subscribe(CameraInfo, params.info_topic, self._on_info, newest)
        subscribe(Image, params.image_topic, self._on_image, newest)
        self.create_timer(1.0, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_info(self, message: CameraInfo) -> None:
        k, d = np.reshape(message.k, (3, 3)), np.array(message.d, dtype=float)
        usable = message.distortion_model in MODELS and k[0, 0] > 0.0 and np.isfinite(k).all()
        self._camera = (k, d) if usable else None
        if not usable:
            self._problem = f"calibration {message.distortion_model!r}, k {k.tolist()}: not usable"

    def _on_image(self, message: Image) -> None:
        begun = time.monotonic()
        try:
            stamp_ns = sensor_stamp(message)
            if self._camera is None:
                raise ValueError(f"no usable calibration on {self._params.info_topic}")
            image = pixels(message, self._codes)
            place, turned = self._detector.pose(stamp_ns, image, *self._camera)
            quat, frame = rotations.quat_xyzw(turned), message.header.frame_id
            self._poses.publish(pose_messages.pose_message(stamp_ns, frame, place, quat))
            age = 1e-9 * (self.get_clock().now().nanoseconds - stamp_ns)
            self._recent.append((age, time.monotonic() - begun, True))
        except (ValueError, cv2.error) as error:
            self._problem = str(error)
            self._recent.append((np.nan, time.monotonic() - begun, False))

    def _report(self) -> None:
        """Publish the share of images with a pose, and how late it is."""
        recent = np.array(self._recent).reshape(-1, 3)
        seen = recent[recent[:, 2] == 1.0]
        share = f"{len(seen)} of {len(recent)} images"
        values = {"images with a pose": share, "last problem": self._problem}
        if len(seen):
            values["latency [s]"] = f"{np.median(seen[:, 0]):.4f}"
            values["detection [s]"] = f"{np.median(seen[:, 1]):.4f}"
        level = "ok" if len(seen) > 0.5 * len(recent) else "warn" if len(recent) else "stale"
        self._diagnostics.publish(level, share if len(seen) else self._problem, values)
        self._recent.clear()


def main() -> int:
    """Entry point of `ros2 run wam_power_ros tag_camera`."""
    return node_runner.run(TagCamera)
