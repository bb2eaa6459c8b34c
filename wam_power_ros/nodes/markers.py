# SPDX-License-Identifier: Apache-2.0
"""Markers of the learner for RViz and Foxglove: the planned and the executed movement.

Published with every policy and at the end of every rollout, and twice a second while the body
moves; latched, and every message has all markers.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point
from nav_msgs.msg import Odometry
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.policy_shapes import ellipsoids, plan
from wam_power_ros.regions import Region
from wam_power_ros.ros import interface, pose_messages

# Colours, RGBA
PLANNED, EXECUTED = (0.15, 0.39, 0.92, 1.0), (0.92, 0.35, 0.05, 1.0)
STIFFNESS, NORMAL = (0.05, 0.58, 0.53, 0.4), (0.98, 0.79, 0.43, 1.0)
REGION = (0.86, 0.15, 0.15, 0.5)
LINE_WIDTH = 0.006  # of a path [m]
ARROW_LENGTH = 0.15  # of the normal of a body [m]
BODY_PERIOD = 0.5  # between two messages for the body alone [s of wall time]


class Markers:
    """Publishes the markers of one arm."""

    def __init__(self, node: Node, base_frame: str, body: str, region: Region | None) -> None:
        self._frame = interface.frame(node.get_namespace(), base_frame)
        self._drawn: dict[str, list[Marker]] = {}  # by namespace of RViz
        self._published = 0.0
        self._publisher = node.create_publisher(
            MarkerArray, interface.LEARNER_MARKERS, interface.LATCHED
        )
        if body:
            state = interface.body_topic(body, "state")
            node.create_subscription(Odometry, state, self._on_body, interface.STATE_IN)
        if region is not None:
            sphere = self._marker("region", Marker.SPHERE, REGION, [2.0 * region.radius] * 3)
            sphere.pose.position = _point(region.centre)
            self._drawn["region"] = [sphere]

    def plan(self, policy: Policy, start: np.ndarray) -> None:
        """Draw a policy: attractors with their stiffness, and its path from `start` (3,) [m]."""
        self._drawn["planned"] = [self._path("planned", plan(policy, start), PLANNED)]
        self._drawn["stiffness"] = drawn = []
        for number, (centre, semi_axes, wxyz) in enumerate(zip(*ellipsoids(policy), strict=True)):
            marker = self._marker("stiffness", Marker.SPHERE, STIFFNESS, 2.0 * semi_axes, number)
            marker.pose.position = _point(centre)
            turn = marker.pose.orientation
            turn.w, turn.x, turn.y, turn.z = wxyz.tolist()
            drawn.append(marker)
        self._publish()

    def executed(self, path: np.ndarray) -> None:
        """Draw the path of the tool in the last rollout (T, 3) [m]."""
        self._drawn["executed"] = [self._path("executed", path, EXECUTED)]
        self._publish()

    def _on_body(self, message: Odometry) -> None:
        if time.monotonic() - self._published < BODY_PERIOD:
            return
        try:
            state = pose_messages.odometry(message)
        except ValueError:
            return  # reported by nodes that depend on the state
        x, y, z, w = state.quat_xyzw
        normal = np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
        arrow = self._marker("normal", Marker.ARROW, NORMAL, [0.01, 0.02, 0.03])
        arrow.points = [_point(state.position), _point(state.position + ARROW_LENGTH * normal)]
        self._drawn["normal"] = [arrow]
        self._publish()

    def _path(self, name: str, points: np.ndarray, colour: Sequence[float]) -> Marker:
        marker = self._marker(name, Marker.LINE_STRIP, colour, [LINE_WIDTH, 0.0, 0.0])
        marker.points = [_point(point) for point in points]
        return marker

    def _marker(
        self, name: str, kind: int, colour: Sequence[float], scale: Sequence[float], number: int = 0
    ) -> Marker:
        """Marker without a stamp, for which RViz takes the newest transform."""
        marker = Marker(ns=name, id=number, type=kind, action=Marker.ADD)
        marker.header.frame_id = self._frame
        marker.pose.orientation.w = 1.0
        marker.scale.x, marker.scale.y, marker.scale.z = map(float, scale)
        marker.color = ColorRGBA(**dict(zip("rgba", map(float, colour), strict=True)))
        return marker

    def _publish(self) -> None:
        self._published = time.monotonic()
        clear = Marker(action=Marker.DELETEALL)
        clear.header.frame_id = self._frame
        drawn = [marker for markers in self._drawn.values() for marker in markers]
        self._publisher.publish(MarkerArray(markers=[clear, *drawn]))


def _point(position: Sequence[float]) -> Point:
    x, y, z = map(float, position)
    return Point(x=x, y=y, z=z)
