# SPDX-License-Identifier: Apache-2.0
"""A rollout state by state: its end, its path, the obstacle, and what makes a policy unfit."""

import re
from dataclasses import replace

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.policy_execution import Execution, prepare
from wam_power_ros.control.tracking_error import TrackingLost
from wam_power_ros.learning.policy import Basis, Policy, with_id
from wam_power_ros.params.resources import share

ARM = Arm(share("urdf/wam7.urdf").read_text(), [f"wam_j{i}" for i in range(1, 8)])
LIMITS = safety.limits_of(ARM)
SETTINGS = ControllerSettings(settle_time=0.1)
HOME = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])
STILL = np.zeros(7)
POSITION, ROTATION = ARM.tool_pose(HOME)
POLICY = Policy(
    id="trial-0001",
    basis=Basis(4, 0.4, 0.0025),
    stiffness=np.tile(300.0 * np.eye(3), (4, 1, 1)),
    attractors=np.tile(POSITION, (4, 1)),
    damping=32.0,
    orientation_reference=rotations.quat_xyzw(ROTATION),
    rotation_attractors=np.zeros((4, 3)),
    rotation_stiffness=400.0,
    rotation_damping=36.0,
    q_start=HOME,
)
START_NS, PERIOD_NS = 10**12, 2_000_000


def execution(policy: Policy = POLICY, settings: ControllerSettings = SETTINGS) -> Execution:
    return Execution(prepare(policy, ARM.n, LIMITS, settings), ARM, settings)


def answer(rollout: Execution, tick: float, q: np.ndarray = HOME) -> np.ndarray | None:
    stamp_ns = START_NS + round(tick * PERIOD_NS)
    return rollout.torque(stamp_ns, q, STILL, ARM.motion(q, STILL))


def test_a_rollout_lasts_for_its_movement_and_the_settling_and_is_sampled_at_100_hz() -> None:
    rollout = execution()
    assert rollout.start_ns is None
    for tick in range(251):
        assert answer(rollout, tick) is not None and not rollout.complete
    assert answer(rollout, 251) is None and rollout.complete
    path = rollout.path(HOME, STILL)
    assert (path.id, rollout.start_ns) == ("trial-0001", START_NS)
    np.testing.assert_allclose(path.t, np.arange(51) * 0.01, atol=1e-12)
    np.testing.assert_allclose(path.position, np.tile(POSITION, (51, 1)))


def test_at_the_attractor_at_rest_the_torque_is_that_of_gravity() -> None:
    np.testing.assert_allclose(answer(execution(), 0), ARM.gravity(HOME), atol=1e-9)


def test_a_gap_in_the_states_is_a_gap_in_the_path_and_time_goes_on() -> None:
    rollout = execution()
    for tick in (0, 1, 2, 40, 41, 240):
        assert answer(rollout, tick) is not None
    assert answer(rollout, 300) is None and rollout.complete
    np.testing.assert_allclose(rollout.path(HOME, STILL).t, [0.0, 0.08, 0.48])


def test_stamps_with_jitter_count_as_the_nearest_tick_and_no_sample_comes_twice() -> None:
    rollout = execution()
    for tick in (0.0, 0.4, 1.1, 4.9, 5.3, 5.4, 9.6):
        answer(rollout, tick)
    np.testing.assert_allclose(rollout.path(HOME, STILL).t, [0.0, 0.01, 0.02])


def test_the_tool_in_the_obstacle_ends_the_rollout_with_a_sample_of_that_state() -> None:
    outside = HOME + np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    rollout = execution(settings=replace(SETTINGS, obstacle=(*POSITION, 0.05)))
    for tick in range(7):
        assert answer(rollout, tick, outside) is not None
    assert answer(rollout, 7) is None
    assert not rollout.complete
    path = rollout.path(HOME, STILL)
    np.testing.assert_allclose(path.t, [0.0, 0.01, 0.014])
    np.testing.assert_allclose(path.position[-1], POSITION)


def test_an_obstacle_met_in_a_tick_that_has_a_sample_leaves_a_valid_path() -> None:
    outside = HOME + np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    rollout = execution(settings=replace(SETTINGS, obstacle=(*POSITION, 0.05)))
    answer(rollout, 0, outside)
    assert answer(rollout, 0.4) is None  # still tick 0
    assert rollout.path(HOME, STILL).t.tolist() == [0.0]
    later = execution(settings=replace(SETTINGS, obstacle=(*POSITION, 0.05)))
    for tick in (0, 5, 10):
        answer(later, tick, outside)
    assert answer(later, 10.4) is None
    np.testing.assert_allclose(later.path(HOME, STILL).t, [0.0, 0.01, 0.02])


def test_a_rollout_that_never_began_has_a_path_of_one_pose() -> None:
    path = execution().path(HOME, STILL)
    assert path.t.tolist() == [0.0]
    np.testing.assert_allclose(path.position[0], POSITION)


def test_a_tool_that_is_turned_too_far_is_lost() -> None:
    rollout, turned = execution(), HOME.copy()
    turned[6] += 1.99
    assert answer(rollout, 0, turned) is not None
    turned[6] += 0.02
    with pytest.raises(TrackingLost, match="turned by more than"):
        answer(rollout, 1, turned)


def test_a_policy_that_does_not_fit_is_refused_with_value_and_limit() -> None:
    for wrong, text in (
        ({"q_start": HOME[:6]}, "is for 6 joints, the arm has 7"),
        ({"q_start": HOME + 3.0}, "outside the limits"),
        ({"stiffness": 9.0 * POLICY.stiffness}, "stiffness 2700 .* above the limit 2500"),
        ({"rotation_stiffness": 3000.0}, "stiffness 3000"),
    ):
        with pytest.raises(ControllerError, match=text) as refused:
            prepare(replace(POLICY, **wrong), ARM.n, LIMITS, SETTINGS)
        assert refused.value.refusal is Refusal.REFUSED


def test_a_policy_at_the_limits_fits() -> None:
    flat = np.deg2rad(30.0)
    turn = np.array([[np.cos(flat), -np.sin(flat)], [np.sin(flat), np.cos(flat)]])
    stiff = 300.0 * np.eye(3)
    stiff[:2, :2] = turn @ np.diag([2499.0, 200.0]) @ turn.T  # stiff along a line across the axes
    for change in (
        {"q_start": LIMITS.q_min},
        {"q_start": LIMITS.q_max},
        {"rotation_stiffness": SETTINGS.stiffness_max},
        {"stiffness": np.tile(stiff, (4, 1, 1))},
    ):
        policy = replace(POLICY, **change)
        assert prepare(policy, ARM.n, LIMITS, SETTINGS).id == policy.id


@pytest.mark.parametrize("joint", range(7))
def test_one_joint_beyond_a_limit_or_one_stiff_matrix_is_enough_to_be_refused(joint: int) -> None:
    for limit, sign in ((LIMITS.q_min, -1.0), (LIMITS.q_max, 1.0)):
        start = HOME.copy()
        start[joint] = limit[joint] + 1e-6 * sign
        with pytest.raises(ControllerError, match="outside the limits"):
            prepare(replace(POLICY, q_start=start), ARM.n, LIMITS, SETTINGS)
    stiffness = POLICY.stiffness.copy()
    stiffness[joint % 4] *= 9.0
    with pytest.raises(ControllerError, match="stiffness 2700"):
        prepare(replace(POLICY, stiffness=stiffness), ARM.n, LIMITS, SETTINGS)


def test_a_loop_slower_than_the_path_samples_every_tick() -> None:
    rollout = execution(settings=replace(SETTINGS, period=0.02))
    for tick in range(0, 250, 10):
        answer(rollout, tick)
    np.testing.assert_allclose(rollout.path(HOME, STILL).t, np.arange(25) * 0.02)


def test_the_content_of_a_policy_is_the_same_under_any_name_and_only_kept_where_needed() -> None:
    held = replace(SETTINGS, hold_to_run=True)
    first, second = (
        prepare(policy, ARM.n, LIMITS, held) for policy in (POLICY, with_id(POLICY, "again"))
    )
    other = prepare(replace(POLICY, damping=31.0), ARM.n, LIMITS, held)
    assert first.content == second.content != other.content
    assert prepare(POLICY, ARM.n, LIMITS, SETTINGS).content == ""


@pytest.mark.requirement("S-59")
def test_a_policy_of_another_arm_is_refused_and_both_are_named() -> None:
    ours = ARM.identity()
    theirs = ours._replace(name="cobot7", kinematics="c" * 64)
    settings = replace(SETTINGS, arm=ours)
    why = f"policy trial-0001 is of another arm: of {theirs}; this one is {ours}"
    with pytest.raises(ControllerError, match=re.escape(why)):
        prepare(replace(POLICY, arm=theirs), ARM.n, LIMITS, settings)
    for arm in (ours, None):
        assert prepare(replace(POLICY, arm=arm), ARM.n, LIMITS, settings).id == POLICY.id
    assert prepare(replace(POLICY, arm=theirs), ARM.n, LIMITS, SETTINGS).id == POLICY.id
