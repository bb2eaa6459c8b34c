# SPDX-License-Identifier: Apache-2.0
"""Markers of the learner for RViz and Foxglove: the planned movement and the guarded region.

Published with every policy; latched, and every message has all markers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.policy_shapes import ellipsoids, plan
from wam_power_ros.regions import Region
from wam_power_ros.ros import interface

# Colours, RGBA
PLANNED, STIFFNESS = (0.15, 0.39, 0.92, 1.0), (0.05, 0.58, 0.53, 0.4)
REGION = (0.86, 0.15, 0.15, 0.5)
LINE_WIDTH = 0.006  # of a path [m]


class Markers:
    """Publishes the markers of one arm."""

    def __init__(self, node: Node, base_frame: str, region: Region | None) -> None:
        self._frame = interface.frame(node.get_namespace(), base_frame)
        self._region: list[Marker] = []
        topic, qos = interface.LEARNER_MARKERS, interface.LATCHED
        self._publisher = node.create_publisher(MarkerArray, topic, qos)
        if region is not None:
            sphere = self._marker("region", Marker.SPHERE, REGION, [2.0 * region.radius] * 3)
            sphere.pose.position = _point(region.centre)
            self._region = [sphere]

    def plan(self, policy: Policy, start: np.ndarray) -> None:
        """Draw a policy: attractors with their stiffness, and its path from `start` (3,) [m]."""
        clear = Marker(action=Marker.DELETEALL)
        clear.header.frame_id = self._frame
        path = self._marker("planned", Marker.LINE_STRIP, PLANNED, [LINE_WIDTH, 0.0, 0.0])
        path.points = [_point(point) for point in plan(policy, start)]
        drawn = [clear, path, *self._region]
        for number, (centre, semi_axes, wxyz) in enumerate(zip(*ellipsoids(policy), strict=True)):
            marker = self._marker("stiffness", Marker.SPHERE, STIFFNESS, 2.0 * semi_axes, number)
            marker.pose.position = _point(centre)
            turn = marker.pose.orientation
            turn.w, turn.x, turn.y, turn.z = wxyz.tolist()
            drawn.append(marker)
        self._publisher.publish(MarkerArray(markers=drawn))

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


def _point(position: Sequence[float]) -> Point:
    x, y, z = map(float, position)
    return Point(x=x, y=y, z=z)
