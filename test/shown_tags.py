# SPDX-License-Identifier: Apache-2.0
"""A camera that films a hand-held plate with tags."""

from __future__ import annotations

import time

import numpy as np

from hardware_sim.tag_film import D, Film, K
from wam_power_ros import rotations
from wam_power_ros.tracking.tag_detector import TagDetector

ONE = "36h11", (3,), 0.06, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
TWO = "36h11", (3, 7), 0.05, (-0.04, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0,
                              0.035, 0.01, -0.005, 0.0, 0.35, 0.0, 0.93674970)  # fmt: skip
CAMERA = np.array([0.8, 0.2, 1.4]), rotations.exp([0.3, 0.2, 0.5]) @ np.diag([1.0, -1.0, -1.0])


def truth(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) [m] and rotation (3, 3) of the plate in the optical frame at a time [s]."""
    place = np.array([0.1 * np.sin(0.9 * t), 0.08 * np.sin(1.3 * t), 0.6 + 0.1 * np.sin(0.7 * t)])
    lean = rotations.exp(np.array([0.5 + 0.1 * np.sin(t), 0.3 * np.sin(0.8 * t), 0.0]))
    return place, lean @ np.diag([1.0, -1.0, -1.0]) @ rotations.exp(np.array([0.0, 0.0, 0.4 * t]))


def measure(tags: tuple, count: int = 60) -> dict[str, object]:
    """Errors of poses anywhere in view [mm, degrees], and reasons of those that were not found."""
    film, detector, rng = Film(*tags), TagDetector(*tags), np.random.default_rng(1)
    errors, lost = [], []
    for number in range(count):
        depth, about = rng.uniform(0.35, 1.0), rng.uniform(-np.pi, np.pi)
        place = depth * np.array([*rng.uniform(-0.25, 0.25, 2), 1.0])
        axis = np.array([np.cos(about), np.sin(about), 0.0])
        rotation = rotations.exp(rng.uniform(0.3, 0.9) * axis) @ np.diag([1.0, -1.0, -1.0])
        rotation = rotation @ rotations.exp(np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)]))
        image = film.image(place, rotation, rng)
        try:
            found = detector.pose((number + 1) * 10**9, image, K, D)
        except ValueError as error:
            lost.append(str(error))
            continue
        angle = np.linalg.norm(rotations.log(found[1] @ rotation.T))
        errors.append([1e3 * np.linalg.norm(found[0] - place), np.rad2deg(angle)])
    return {"errors": errors, "lost": lost}


def publish(tags: tuple) -> None:
    """Publish images until the process is ended."""
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import CameraInfo, Image

    from wam_power_ros.ros.stamps import time_message

    film, rng = Film(*tags), np.random.default_rng(0)
    rclpy.init()
    node = rclpy.create_node("camera_driver")
    images = node.create_publisher(Image, "camera/image_raw", qos_profile_sensor_data)
    infos = node.create_publisher(CameraInfo, "camera/camera_info", qos_profile_sensor_data)
    while rclpy.ok():
        stamp_ns = time.time_ns()
        grey = film.image(*truth(stamp_ns * 1e-9 % 1000.0), rng)
        height, width = grey.shape
        message = Image(height=height, width=width, step=width, encoding="mono8")
        message.data = grey.tobytes()
        info = CameraInfo(height=height, width=width, distortion_model="plumb_bob")
        info.k, info.d = K.ravel().tolist(), D.tolist()
        for each, to in ((info, infos), (message, images)):
            each.header.stamp, each.header.frame_id = time_message(stamp_ns), "camera_optical"
            to.publish(each)
        time.sleep(max(0.0, 0.05 - 1e-9 * (time.time_ns() - stamp_ns)))


if __name__ == "__main__":
    publish(TWO)
