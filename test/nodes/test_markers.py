# SPDX-License-Identifier: Apache-2.0
"""Every message has markers of the policy, the last rollout, the body and the guarded region."""

from __future__ import annotations

import numpy as np
from conftest import Probe, lift
from nav_msgs.msg import Odometry
from visualization_msgs.msg import Marker, MarkerArray

from wam_power_ros.nodes.markers import ARROW_LENGTH, Markers
from wam_power_ros.regions import Region
from wam_power_ros.ros import interface, pose_messages

POLICY = lift("trial-0001")
START = POLICY.attractors[0] + [0.0, 0.1, 0.0]
ALL = {"planned", "stiffness", "executed", "normal", "region"}


def points(marker: Marker) -> np.ndarray:
    return np.array([[point.x, point.y, point.z] for point in marker.points])


def test_who_comes_late_sees_everything_in_the_frame_of_the_arm(probe: Probe) -> None:
    markers = Markers(probe.node, "arm_base", "pancake", Region("box", (0.7, 0.0, 0.6), 0.09))
    states = probe.publisher(
        Odometry, interface.body_topic("pancake", "state"), interface.STATE_OUT
    )
    markers.plan(POLICY, START)
    executed = np.random.default_rng(1).normal(size=(9, 3))
    markers.executed(executed)
    tilted = np.array([np.sin(0.2), 0.0, 0.0, np.cos(0.2)])  # by 0.4 rad about x
    where = np.array([0.6, 0.0, 0.5])
    still = np.zeros(3)
    state = pose_messages.StateReading(1, "arm_base", where, tilted, still, still, 1e-6)
    received = probe.listen(MarkerArray, interface.LEARNER_MARKERS, interface.LATCHED)

    def whole() -> list[Marker] | None:
        states.publish(pose_messages.odometry_message(state, "pancake"))
        probe.spin(0.05)
        last = received[-1].markers if received else []
        return last if {marker.ns for marker in last} - {""} == ALL else None

    clear, *drawn = probe.until(whole, "all markers")
    assert clear.action == Marker.DELETEALL
    assert {marker.header.frame_id for marker in (clear, *drawn)} == {"arm_base"}
    assert len({(marker.ns, marker.id) for marker in drawn}) == len(drawn)
    by_name = {marker.ns: marker for marker in drawn}
    np.testing.assert_array_equal(points(by_name["planned"])[0], START)
    np.testing.assert_array_equal(points(by_name["executed"]), executed)
    normal = points(by_name["normal"]) - where
    np.testing.assert_allclose(normal[1], ARROW_LENGTH * np.array([0.0, -np.sin(0.4), np.cos(0.4)]))
    assert by_name["region"].scale.x == 0.18
    ellipsoids = [marker for marker in drawn if marker.ns == "stiffness"]
    centres = [[getattr(marker.pose.position, axis) for axis in "xyz"] for marker in ellipsoids]
    np.testing.assert_array_equal(centres, POLICY.attractors)


def test_without_a_body_and_a_region_there_is_neither(probe: Probe) -> None:
    received = probe.listen(MarkerArray, interface.LEARNER_MARKERS, interface.LATCHED)
    Markers(probe.node, "arm_base", "", None).plan(POLICY, START)
    (message,) = probe.until(lambda: received, "the markers")
    assert {marker.ns for marker in message.markers[1:]} == {"planned", "stiffness"}
