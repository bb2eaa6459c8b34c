# SPDX-License-Identifier: Apache-2.0
"""The rigid-body model against finite differences and Barrett's figures."""

import re

import numpy as np
import pinocchio as pin
import pytest
from rigid_arm import HOME, NAMES, URDF

from wam_power_ros.control.arm import WAM_GUARDED_POINTS, Arm, GuardedPoint, guarded_points
from wam_power_ros.params.resources import share

ARMATURE = (0.20517, 0.18884, 0.06691, 0.03462, 0.003227, 0.003227, 0.0003165)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm(URDF, NAMES)


def states(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(3)
    return [(rng.uniform(-1.5, 1.5, 7), rng.uniform(-2.0, 2.0, 7)) for _ in range(count)]


def test_the_tool_plate_agrees_with_barretts_kinematics() -> None:
    plate = Arm(URDF, NAMES, tool_frame="wam_tool_plate")
    for joint, expected in (
        (1, (0.43670872, 0.0, 1.14538996)),
        (3, (0.17853346, 0.0, 1.2342937)),
        (5, (0.02919702, 0.0, 1.24944478)),
    ):
        assert np.allclose(plate.tool_pose(0.5 * np.eye(7)[joint])[0], expected, atol=1e-7)


def test_the_jacobian_is_the_derivative_of_the_pose(arm: Arm) -> None:
    for q, qd in states(5):
        step = 1e-6
        (p_a, r_a), (p_b, r_b) = arm.tool_pose(q - step * qd), arm.tool_pose(q + step * qd)
        twist, motion = arm.jacobian(q) @ qd, arm.motion(q, qd)
        assert np.allclose((p_b - p_a) / (2 * step), twist[:3], atol=1e-6)
        assert np.allclose(pin.log3(r_b @ r_a.T) / (2 * step), twist[3:], atol=1e-6)
        assert np.allclose(motion.twist, twist, atol=1e-12)
        assert motion.tool_speed == pytest.approx(np.linalg.norm(twist[:3]))
        for found, expected in zip(motion[:2], arm.tool_pose(q), strict=True):
            assert np.array_equal(found, expected)
        change = arm.jacobian(q + step * qd) @ qd - arm.jacobian(q - step * qd) @ qd
        assert np.allclose(motion.drift, change / (2 * step), atol=1e-5)


def test_the_rotors_are_in_every_dynamics_function(arm: Arm) -> None:
    assert np.allclose(arm.armature, ARMATURE)
    bare = Arm(re.sub(r'armature="[^"]*"', "", URDF), NAMES)
    for q, qd in states(5):
        mass, qdd = arm.mass_matrix(q), np.arange(7.0)
        assert np.allclose(mass - bare.mass_matrix(q), np.diag(ARMATURE), atol=1e-12)
        assert np.array_equal(mass, mass.T)
        dynamics = arm.dynamics(q, qd)
        assert np.allclose(dynamics.inverse_mass @ mass, np.eye(7), atol=1e-9)
        tau = arm.inverse_dynamics(q, qd, qdd)
        assert np.allclose(tau, mass @ qdd + dynamics.bias, atol=1e-10)
        assert np.allclose(arm.resisted_dynamics(q, qd, tau, np.zeros(7), 0.0), qdd, atol=1e-7)


def test_guarded_points_move_as_their_positions_do(arm: Arm) -> None:
    elbow, step = Arm(URDF, NAMES, tool_frame="wam_link4"), 1e-6

    def speed(q: np.ndarray, qd: np.ndarray, point: np.ndarray) -> float:
        ends = [elbow.tool_pose(q + sign * step * qd) for sign in (-1.0, 1.0)]
        before, after = (position + rotation @ point for position, rotation in ends)
        return float(np.linalg.norm(after - before) / (2 * step))

    for q, qd in states(5):
        (at_elbow, beyond), tool = arm.speeds(q, qd)
        assert at_elbow == pytest.approx(speed(q, qd, np.zeros(3)), abs=1e-6)
        assert beyond == pytest.approx(speed(q, qd, np.array([-0.045, -0.35, 0.0])), abs=1e-6)
        assert tool == pytest.approx(arm.motion(q, qd).tool_speed)


def test_guarded_points_are_configurable_and_an_unknown_link_is_named(arm: Arm) -> None:
    wrist = GuardedPoint("wrist", "wam_link6", (0.03, -0.05, 0.1))
    other = Arm(URDF, NAMES, guarded=(*WAM_GUARDED_POINTS, wrist, WAM_GUARDED_POINTS[0]))
    assert other.guarded == ("elbow", "forearm", "wrist", "elbow")
    speeds, tool = other.speeds(HOME, np.ones(7))
    assert (speeds[:2], tool) == arm.speeds(HOME, np.ones(7)) and speeds[3] == speeds[0]
    position, rotation = Arm(URDF, NAMES, tool_frame="wam_link6").tool_pose(HOME)
    found = other.motion(HOME, np.ones(7)).guarded_positions[2]
    np.testing.assert_allclose(found, position + rotation @ wrist.offset)
    assert Arm(URDF, NAMES, guarded=()).motion(HOME, np.ones(7)).guarded_speeds == []
    with pytest.raises(ValueError, match="another_robots_link"):
        Arm(URDF, NAMES, guarded=[wrist._replace(link="another_robots_link")])


def test_results_are_not_changed_by_later_calls(arm: Arm) -> None:
    (q, qd), (q_other, qd_other) = states(2)
    results = [*arm.motion(q, qd)[:4], *arm.dynamics(q, qd), *arm.tool_pose(q), arm.gravity(q)]
    copies = [result.copy() for result in results]
    arm.motion(q_other, qd_other)
    arm.dynamics(q_other, qd_other)
    arm.tool_pose(q_other)
    arm.gravity(q_other)
    assert all(np.array_equal(a, b) for a, b in zip(results, copies, strict=True))


def test_a_joint_or_frame_that_does_not_match_is_named() -> None:
    with pytest.raises(ValueError, match=r"'spoon'.*pan"):
        Arm(URDF, NAMES, tool_frame="spoon")
    for wrong in ("heavy", "-0.001", "nan"):
        with pytest.raises(ValueError, match="armature"):
            Arm(URDF.replace('armature="0.20517"', f'armature="{wrong}"'), NAMES)


def test_limits_are_those_of_the_urdf(arm: Arm) -> None:
    limits = {"lower": arm.q_min, "upper": arm.q_max, "velocity": arm.qd_max, "effort": arm.tau_max}
    for name, values in limits.items():
        assert values.tolist() == [float(x) for x in re.findall(rf' {name}="([^"]*)"', URDF)][:7]


def test_guarded_points_are_read_three_numbers_each() -> None:
    names, links = ["elbow", "forearm"], ["wam_link4", "wam_link4"]
    offsets = [0.0, 0.0, 0.0, -0.045, -0.35, 0.0]
    assert guarded_points(names, links, offsets) == WAM_GUARDED_POINTS
    assert guarded_points([""], [""], [0.0]) == ()
    for wrong in (
        (names, links[:1], offsets),
        (names[:1], links, offsets),
        (names, links, offsets[:5]),
    ):
        with pytest.raises(ValueError, match="must be three numbers"):
            guarded_points(*wrong)
    with pytest.raises(ValueError, match=r"guarded point elbow\[1\] = nan must be finite"):
        Arm(URDF, NAMES, guarded=[GuardedPoint("elbow", "wam_link4", (0.0, np.nan, 0.0))])


@pytest.mark.requirement("S-59")
def test_an_arm_is_recognised_and_another_one_is_not_mistaken_for_it(arm: Arm) -> None:
    ours = arm.identity()
    arm.motion(HOME, HOME)  # independent of the contents of its buffers
    assert arm.identity() == ours == Arm(URDF, NAMES).identity()
    assert (ours.name, ours.joint_names) == ("wam7", tuple(NAMES))
    names = [f"cobot_joint{i}" for i in range(1, 8)]
    cobot = Arm(share("urdf/cobot7.urdf").read_text(), names, "cobot_pan", guarded=())
    for other in (cobot, Arm(URDF, NAMES, "wam_link7")):  # no pan
        assert other.identity().kinematics != ours.kinematics


@pytest.mark.requirement("S-59")
@pytest.mark.parametrize(
    ("pattern", "replacement", "differ"),
    [
        (r'xyz="0\.045 0 0\.55(" rpy="-1)', r'xyz="0.045 0 0.551\1', {"kinematics"}),
        (r'(<mass value=")10\.76768767', r"\g<1>10.9", {"dynamics"}),
        (r'(<limit [^>]*effort=")[0-9.]+', r"\g<1>1.0", set()),
        (r'<robot name="[^"]*"', '<robot name="other"', {"name"}),
    ],
)
def test_the_identity_separates_geometry_and_masses_and_ignores_limits(
    arm: Arm, pattern: str, replacement: str, differ: set[str]
) -> None:
    ours, text = arm.identity()._asdict(), re.sub(pattern, replacement, URDF, count=1)
    assert text != URDF
    theirs = Arm(text, NAMES).identity()._asdict()
    assert {name for name in ours if ours[name] != theirs[name]} == differ
