# SPDX-License-Identifier: Apache-2.0
"""Every message has markers of the policy and the guarded region."""

from __future__ import annotations

import numpy as np
from conftest import Probe, lift
from visualization_msgs.msg import Marker, MarkerArray

from wam_power_ros.nodes.markers import Markers
from wam_power_ros.regions import Region
from wam_power_ros.ros import interface

POLICY = lift("trial-0001")
START = POLICY.attractors[0] + [0.0, 0.1, 0.0]
ALL = {"planned", "stiffness", "region"}


def points(marker: Marker) -> np.ndarray:
    return np.array([[point.x, point.y, point.z] for point in marker.points])


def test_who_comes_late_sees_everything_in_the_frame_of_the_arm(probe: Probe) -> None:
    markers = Markers(probe.node, "arm_base", Region("box", (0.7, 0.0, 0.6), 0.09))
    markers.plan(POLICY, START)
    received = probe.listen(MarkerArray, interface.LEARNER_MARKERS, interface.LATCHED)
    probe.until(lambda: received, "the markers")
    clear, *drawn = received[-1].markers
    assert {marker.ns for marker in drawn} == ALL
    assert clear.action == Marker.DELETEALL
    assert {marker.header.frame_id for marker in (clear, *drawn)} == {"arm_base"}
    assert len({(marker.ns, marker.id) for marker in drawn}) == len(drawn)
    by_name = {marker.ns: marker for marker in drawn}
    np.testing.assert_array_equal(points(by_name["planned"])[0], START)
    assert by_name["region"].scale.x == 0.18
    ellipsoids = [marker for marker in drawn if marker.ns == "stiffness"]
    centres = [[getattr(marker.pose.position, axis) for axis in "xyz"] for marker in ellipsoids]
    np.testing.assert_array_equal(centres, POLICY.attractors)
