# SPDX-License-Identifier: Apache-2.0
"""OptiTrack stand-in: frames of the world in, pose and markers of the tracked body out.

Its cameras observe the world that `wam_sim` steps, so it runs in that process: see `main`. Its
parameters cover the differences between motion-capture drivers, and their common errors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.node import Node

from hardware_sim import body_messages
from hardware_sim.sensors import MocapFrame
from hardware_sim.settings import OptitrackSimParams
from wam_power_ros import rotations
from wam_power_ros.ros import body_sources, interface
from wam_power_ros.tracking.tracker import Y_UP

RECEIPT_GAP_NS = 100_000  # [ns] between the receipts of frames that are delivered together
STRAY_MARKERS = np.array([[0.4, -0.3, 0.05], [0.45, -0.2, 0.05], [-0.1, 0.6, 0.3]])  # [m]


class OptitrackSim(Node):
    """Publishes poses and markers of the tracked body; `options` are those of a `Node`."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - of Node
        super().__init__(
            "optitrack_sim", automatically_declare_parameters_from_overrides=True, **options
        )
        self.params = params = OptitrackSimParams.from_node(self)
        qos = interface.MOCAP if params.reliable else interface.MOCAP_BEST_EFFORT
        self._poses = self._markers = None
        if params.pose_topic:
            kind = body_sources.message_class(params.pose_type)
            self._poses = self.create_publisher(kind, params.pose_topic, qos)
        if params.markers_topic:
            kind = body_sources.message_class(params.markers_type)
            self._markers = self.create_publisher(kind, params.markers_topic, qos)
        pose = np.array(params.world_to_base)
        self._origin = pose[:3]
        turn = rotations.matrix(pose[3:]).T  # base frame to motion-capture frame
        self._turn = Y_UP.T @ turn if params.up_axis == "y" else turn
        self._turn_quat = rotations.quat_xyzw(self._turn)
        self._rng = np.random.default_rng(0)  # shuffles the unlabelled markers
        self._waiting: list[MocapFrame] = []

    def publish(self, frame: MocapFrame, stamp_offset_ns: int, now_ns: int) -> None:
        """Publish a frame, or hold it back until it can be delivered together with others.

        It is in the base frame of the arm and stamped by the world's clock, whose time is `now_ns`
        [ns] and from which the stamping clock is off by `stamp_offset_ns` [ns].
        """
        params = self.params
        self._waiting.append(frame)
        if len(self._waiting) < params.together:
            return
        frames, self._waiting = self._waiting, []
        for number, each in enumerate(frames):
            receipt_ns = now_ns + RECEIPT_GAP_NS * (number + 1 - len(frames))
            stamp_ns = each.stamp_ns if params.stamps == "exposure" else receipt_ns
            self._send(each, stamp_ns + stamp_offset_ns)

    def _send(self, frame: MocapFrame, stamp_ns: int) -> None:
        params, write = self.params, body_messages.message
        where = stamp_ns, params.frame, params.source_body
        if self._poses is not None:
            position, quat_xyzw = frame.position, frame.quat_xyzw
            if position.any():  # zeros mark a lost frame, whatever the coordinates
                position = self._turn @ (position - self._origin)
                quat_xyzw = rotations.multiply(self._turn_quat, quat_xyzw)
            self._poses.publish(write(params.pose_type, *where, position, quat_xyzw))
        if self._markers is not None:
            seen = np.vstack([frame.markers, STRAY_MARKERS[: params.stray]])
            points = self._rng.permutation(seen - self._origin) @ self._turn.T
            self._markers.publish(write(params.markers_type, *where, points))
