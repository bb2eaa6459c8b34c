# SPDX-License-Identifier: Apache-2.0
"""A simulated rollout finds the fault that would end a rollout, without moving the arm."""

from dataclasses import replace

import numpy as np
import pytest
from rigid_arm import HOME as START
from rigid_arm import NAMES, URDF, make_policy

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.feasibility import (
    POSITION_MARGIN,
    SPEED_SHARE,
    Feasibility,
    simulate,
    simulate_policy,
)
from wam_power_ros.control.safety import limits_of
from wam_power_ros.faults import FaultKind
from wam_power_ros.learning.policy import Basis, Policy

SETTINGS = ControllerSettings()


@pytest.fixture(scope="module")
def arm() -> Arm:
    """The WAM with its pan."""
    return Arm(URDF, NAMES)


def lift(arm: Arm, height: float) -> Policy:
    """A policy that lifts the pan by `height` [m] in half a second."""
    return replace(
        make_policy("lift", size=0.0),
        basis=Basis(count=4, duration=0.5, variance=0.004),
        stiffness=np.tile(300.0 * np.eye(3), (4, 1, 1)),
        attractors=arm.tool_pose(START)[0] + np.outer([0.0, 0.5, 1.0, 1.0], [0.0, 0.0, height]),
        rotation_attractors=np.zeros((4, 3)),
    )


def test_a_simulated_rollout_has_the_path_of_the_tool_and_the_excess_of_each_limit(
    arm: Arm,
) -> None:
    policy = lift(arm, 0.1)
    rollout, simulated = simulate(arm, SETTINGS, policy), simulate_policy(arm, SETTINGS, policy)
    assert simulated.fault is None and (simulated.qd_peak < arm.qd_max).all()
    path, limits = rollout.tool, limits_of(arm)
    np.testing.assert_allclose(path.position[0], arm.tool_pose(START)[0], atol=1e-6)
    assert path.position[-1, 2] - path.position[0, 2] == pytest.approx(0.1, abs=0.02)
    assert np.diff(path.t) == pytest.approx(SETTINGS.period)
    speeds = np.linalg.norm(np.diff(path.position, axis=0), axis=1) / SETTINGS.period
    assert speeds.max() == pytest.approx(simulated.tool_peak, rel=0.01)
    tool_share = simulated.tool_peak / limits.tool_speed
    assert rollout.limit_excess[-1] == pytest.approx(tool_share / SPEED_SHARE - 1.0)
    assert len(rollout.limit_excess) == 2 * arm.n + 2 and rollout.limit_excess.max() < 0.0


def test_beyond_a_position_limit_it_is_told_how_far(arm: Arm) -> None:
    policy = lift(arm, 0.2)
    free, limits = simulate_policy(arm, SETTINGS, policy).q, limits_of(arm)
    joint = int(np.argmax(free.max(axis=0) - free[0]))
    q_max = limits.q_max.copy()
    q_max[joint] = free[:, joint].max() - 0.04
    tight = SETTINGS.model_copy(update={"limits": replace(limits, q_max=q_max)})
    assert simulate_policy(arm, tight, policy).fault.kind is FaultKind.JOINT_POSITION
    limit_excess = simulate(arm, tight, policy).limit_excess
    half = 0.5 * (q_max - limits.q_min)[joint]
    free_of_springs = (0.04 + POSITION_MARGIN) / (half - POSITION_MARGIN)
    assert 0.0 < limit_excess[joint] < free_of_springs, "those at the limit push it back"
    assert np.delete(limit_excess, joint).max() < 0.0


@pytest.mark.parametrize(("share", "told"), [(0.6, True), (0.3, False)])
def test_beyond_a_limit_it_is_told_how_far_and_far_beyond_it_nothing(
    arm: Arm, share: float, told: bool
) -> None:
    policy = lift(arm, 0.2)
    peak = simulate_policy(arm, SETTINGS, policy).tool_peak
    limits = replace(limits_of(arm), tool_speed=share * peak / SPEED_SHARE)
    slow = SETTINGS.model_copy(update={"limits": limits})
    assert simulate_policy(arm, slow, policy).fault is not None
    simulated = simulate(arm, slow, policy)
    assert (simulated is not None) == told
    if simulated is not None:
        assert simulated.limit_excess[-1] == pytest.approx(1.0 / share - 1.0)


@pytest.mark.requirement("S-31")
def test_a_movement_that_is_too_fast_ends_in_the_fault_it_would_cause(arm: Arm) -> None:
    simulated = simulate_policy(arm, SETTINGS, lift(arm, 0.9))
    assert simulated.fault.kind is FaultKind.GUARDED_SPEED and "limit" in simulated.fault.text


@pytest.fixture(scope="module")
def free(arm: Arm) -> Feasibility:
    """A lift of 25 cm that is not near any limit, without a margin."""
    return simulate_policy(arm, SETTINGS, lift(arm, 0.25), margin=1.0)


def test_a_tenth_of_each_speed_limit_is_kept_in_reserve(arm: Arm, free: Feasibility) -> None:
    for name, peak, kind in (
        ("qd_max", np.full(7, free.qd_peak.max()), FaultKind.JOINT_SPEED),
        ("guarded_speed", free.guarded_peak, FaultKind.GUARDED_SPEED),
        ("tool_speed", free.tool_peak, FaultKind.TOOL_SPEED),
    ):
        settings = ControllerSettings(limits=limits_of(arm, **{name: 1.05 * peak}))
        assert simulate_policy(arm, settings, lift(arm, 0.25), margin=1.0).fault is None
        assert simulate_policy(arm, settings, lift(arm, 0.25)).fault.kind is kind


def test_a_policy_that_oscillates_under_the_delay_of_the_loop_is_infeasible(
    arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A delay reduces the damping of 7 1/s by stiffness times delay: 10 1/s.
    policy = replace(lift(arm, 0.05), stiffness=np.tile(2400.0 * np.eye(3), (4, 1, 1)), damping=7.0)
    assert simulate_policy(arm, SETTINGS, policy).fault is not None
    monkeypatch.setattr("wam_power_ros.control.model_arm.TORQUE_DELAY", 0)
    assert simulate_policy(arm, SETTINGS, policy).fault is None


def test_the_low_pass_of_the_reported_speeds_is_simulated(arm: Arm) -> None:
    # A lag makes damping stiffness, and leaves too little of it.
    policy = replace(
        lift(arm, 0.05), stiffness=np.tile(2400.0 * np.eye(3), (4, 1, 1)), damping=16.0
    )
    slow = ControllerSettings(velocity_cutoff=20.0)
    assert simulate_policy(arm, slow, policy).fault is not None
    fast = ControllerSettings(velocity_cutoff=1500.0)
    assert simulate_policy(arm, fast, policy).fault is None


@pytest.mark.parametrize(
    ("name", "joint", "limit", "height", "kind"),
    [  # lowering the pan moves joint 2 to 0.64 or 0.65 rad, lifting it joint 4 to 1.36 rad
        ("q_max", 1, 0.72, -0.2, None),
        ("q_max", 1, 0.67, -0.2, FaultKind.JOINT_POSITION),
        ("q_min", 3, 1.34, 0.25, FaultKind.JOINT_POSITION),
    ],
)
def test_a_margin_to_the_position_limits_is_kept(
    arm: Arm, name: str, joint: int, limit: float, height: float, kind: FaultKind | None
) -> None:
    limits = limits_of(arm, **{name: np.where(np.arange(7) == joint, limit, getattr(arm, name))})
    fault = simulate_policy(arm, ControllerSettings(limits=limits), lift(arm, height)).fault
    assert (fault and fault.kind) is kind
    assert fault is None or fault.text.startswith(f"joint {joint + 1} comes within 0.0")


def test_a_policy_the_controller_refuses_is_not_simulated(arm: Arm) -> None:
    stiff = replace(lift(arm, 0.1), stiffness=np.tile(9e4 * np.eye(3), (4, 1, 1)))
    refused = simulate_policy(arm, SETTINGS, stiff)
    assert "stiffness" in refused.fault.text
    assert (refused.qd_peak.tolist(), refused.guarded_peak, refused.tool_peak) == ([0.0] * 7, 0, 0)


@pytest.mark.parametrize(("angle", "kind"), [(1.0, None), (2.6, FaultKind.TRACKING)])
def test_a_tool_that_turns_too_far_from_its_reference_ends_the_simulation(
    arm: Arm, angle: float, kind: FaultKind | None
) -> None:
    axis = arm.tool_pose(START)[1][:, 0]  # about which the arm has room to turn
    turning = np.outer([0.0, 0.5, 1.0, 1.0], angle * axis)
    policy = replace(lift(arm, 0.0), rotation_attractors=turning)
    fault = simulate_policy(arm, SETTINGS, policy, margin=10.0).fault
    assert (fault and fault.kind) is kind


def test_an_arm_that_takes_positions_is_foreseen_behind_them_by_its_servo(arm: Arm) -> None:
    policy, told = lift(arm, 0.1), {"set_point_period": 0.002, "servo_delay": 0.04}
    ahead, late = (
        simulate(arm, SETTINGS.model_copy(update=update), policy).tool.position
        for update in ({}, told)
    )
    np.testing.assert_allclose(late[20:], ahead[:-20], atol=1e-9)


def test_a_measured_delay_of_the_loop_is_simulated(arm: Arm) -> None:
    def peaks(delay: float) -> np.ndarray:
        settings = ControllerSettings(loop_delay=delay)
        return simulate_policy(arm, settings, lift(arm, 0.1)).qd_peak

    assert not np.array_equal(peaks(0.008), peaks(0.0))
    assert not np.array_equal(peaks(0.008), peaks(0.002))
