# SPDX-License-Identifier: Apache-2.0
"""Estimate of the arm while its states are missing or not plausible."""

import numpy as np
import pytest
from rigid_arm import HOME, MODEL, PERIOD_NS, Plant

from wam_power_ros.control.estimate import POSITION_CORRECTION_SPEED, Estimate
from wam_power_ros.control.plausibility import Bound, Plausibility
from wam_power_ros.control.state_checks import JointState

PERIOD = PERIOD_NS * 1e-9


@pytest.mark.parametrize("share", [-0.6, 0.6])
def test_the_estimate_keeps_joints_at_rest_that_friction_holds(share: float) -> None:
    for way in ([0.3, 0.2, 0.1, 0.2, 0.3, 0.1, 0.2], [-0.2, 0.1, -0.3, 0.4, 0.8, 0.5, -0.6]):
        q = HOME + way
        push = share * MODEL.friction * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0])
        estimate = Estimate(MODEL, q, np.zeros(7))
        for _ in range(25):
            estimate.predict(MODEL.gravity(q) + push, 0.008)
        assert np.abs(estimate.qd).max() < 0.05


def test_the_estimate_follows_joints_that_move_against_friction() -> None:
    qd = np.array([0.8, -0.6, 0.9, 1.0, 2.0, -2.0, 2.5])
    plant = Plant(HOME, friction=1.0)
    plant.qd = qd.copy()
    estimate = Estimate(MODEL, HOME, qd)
    for _ in range(10):
        tau = MODEL.gravity(plant.q)
        plant.step(tau)
        estimate.predict(tau, 0.002)
        np.testing.assert_allclose(estimate.qd, plant.qd, atol=0.15)


def moved(rates: list[float], trusted: bool = True, joint: int = 3) -> Estimate:
    """Estimate of an arm at rest that then reports these rates of one joint [rad/s]."""
    estimate, q, carried = Estimate(MODEL, HOME, np.zeros(7)), HOME, MODEL.gravity(HOME)
    for k, rate in enumerate([0.0] * 8 + rates):
        q = q + rate * PERIOD * np.eye(7)[joint]
        state = JointState(k * PERIOD_NS, q, np.zeros(7), PERIOD, PERIOD)
        estimate.follow(state, carried, trusted)
    return estimate


def test_a_joint_that_jumps_once_or_back_and_forth_has_no_speed() -> None:
    for rates in (
        [20.0],
        [20.0, 0.0],
        [20.0, 0.0, 0.0],
        [10.0, -10.0] * 4,
        [10.0, -10.0] * 4 + [0.0],
    ):
        assert np.abs(moved(rates).qd).max() < 0.01, rates


@pytest.mark.requirement("S-121")
def test_states_that_are_not_trusted_change_nothing() -> None:
    for rates in ([20.0], [0.1] * 50, [3.0] * 50, [10.0, -10.0] * 20):
        estimate = moved(rates, trusted=False)
        assert np.abs(estimate.qd).max() < 1e-9, rates
        np.testing.assert_allclose(estimate.q, HOME, atol=1e-9)


def test_states_that_are_trusted_again_count_from_then_on() -> None:
    estimate, q, carried = Estimate(MODEL, HOME, np.zeros(7)), HOME, MODEL.gravity(HOME)
    for k in range(100):
        q = q + PERIOD * np.eye(7)[3]
        state = JointState(k * PERIOD_NS, q, np.zeros(7), PERIOD, PERIOD)
        estimate.follow(state, carried, k >= 50)
        assert estimate.qd[3] == pytest.approx(0.0 if k < 50 else 1.0, abs=1e-9)


def test_a_joint_that_moves_has_the_speed_at_which_its_position_changes() -> None:
    for rate in (0.1, 1.0, -2.0):
        assert moved([rate] * 8).qd[3] == pytest.approx(rate)
    assert moved([4.0, 5.2, 3.6, 4.4]).qd[3] == pytest.approx(4.3)


def test_a_jump_of_a_moving_joint_does_not_count_as_motion() -> None:
    jumped = moved([3.0] * 8 + [60.0] + [3.0] * 8)
    assert jumped.qd[3] == pytest.approx(3.0)
    corrected = 9 * PERIOD * POSITION_CORRECTION_SPEED  # of the new zero, since the jump
    assert jumped.q[3] - moved([3.0] * 17).q[3] == pytest.approx(corrected)


def test_a_measured_position_counts_once_its_joint_moves() -> None:
    jump = [100.0, *([0.0] * 4)]  # 0.2 rad: its zero has changed, or it had no power
    still, moving = (moved(jump + steps) for steps in ([0.0] * 300, [0.3] * 300))
    assert still.q[3] == pytest.approx(HOME[3], abs=0.005)
    assert moving.q[3] == pytest.approx(HOME[3] + 0.38)


@pytest.mark.parametrize("joint", [0, 3, 6])
def test_no_estimated_speed_exceeds_the_limit_of_its_joint(joint: int) -> None:
    push = 50.0 * MODEL.tau_max[joint] * np.eye(7)[joint]
    estimate = Estimate(MODEL, HOME, np.zeros(7))
    for _ in range(200):
        estimate.predict(MODEL.gravity(estimate.q) + push, PERIOD)
        assert np.all(np.abs(estimate.qd) <= MODEL.qd_max)
    assert estimate.qd[joint] == pytest.approx(MODEL.qd_max[joint])


def test_a_joint_that_is_not_observed_keeps_its_momentum() -> None:
    mass = MODEL.mass_matrix(HOME)
    seen = np.arange(7) != 1
    estimate = Estimate(MODEL, HOME, np.full(7, 0.5))
    momentum = mass.dot(estimate.qd)[1]
    estimate.correct(seen, np.array([0.2, 9.0, -0.1, 1.0, 0.3, -0.8, 0.4]))
    assert mass.dot(estimate.qd)[1] == pytest.approx(momentum)
    np.testing.assert_allclose(estimate.qd[seen] - 0.5, [0.2, -0.1, 1.0, 0.3, -0.8, 0.4])


def test_a_torque_acts_on_the_estimate_with_the_delay_of_the_arm() -> None:
    carried, push = MODEL.gravity(HOME), np.array([0.0, 30.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    estimate = Estimate(MODEL, HOME, np.zeros(7), [carried, carried])
    speeds = []
    for _ in range(4):
        estimate.advance(carried + push, PERIOD)
        speeds.append(estimate.qd[1])
    assert speeds[:2] == [0.0, 0.0]
    assert 0.0 < speeds[2] < speeds[3]


@pytest.mark.parametrize("begun", [0, 75, 103])
def test_the_estimate_after_false_states_begins_at_the_states_before(begun: int) -> None:
    """Under a growing push an estimate that is late by a few states is 0.1 rad/s off."""
    plausibility, plant = Plausibility(MODEL), Plant(HOME, friction=1.0, delay=2)
    loose = Bound(np.full(7, 1e9), np.full(7, 1e9))
    last, frozen = None, None
    for k in range(140):
        tau = MODEL.gravity(HOME) + min(k, 60) * np.array([0.0, 0.3, 0.0, 0.05, 0.0, 0.0, 0.0])
        stamp, q, qd = plant.state()
        frozen = frozen or (q, qd) if k >= 130 else None
        state = JointState(stamp, *(frozen or (q, qd)), PERIOD, PERIOD)
        if k >= begun:
            plausibility.fault(last, state, tau, loose)
            last = state
        plant.step(tau)
    estimate = plausibility.estimate(last)
    assert plant.qd[1] > 0.5
    np.testing.assert_allclose(estimate.qd, plant.qd, atol=0.045)
    np.testing.assert_allclose(estimate.q, plant.q, atol=0.01)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_no_predicted_speed_is_beyond_the_limit_of_its_joint(sign: float) -> None:
    estimate = Estimate(MODEL, HOME, np.zeros(7))
    for _ in range(40):
        before = estimate.q
        estimate.predict(MODEL.gravity(HOME) + sign * 10.0 * MODEL.tau_max, 0.02)
        assert np.all(np.abs(estimate.qd) <= MODEL.qd_max)
        np.testing.assert_allclose(estimate.q - before, 0.02 * estimate.qd, atol=1e-12)
    reached = np.abs(estimate.qd) == MODEL.qd_max
    assert reached.any()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_position_is_corrected_at_half_a_radian_a_second_in_either_direction(
    sign: float,
) -> None:
    jump = [100.0 * sign, *([0.0] * 4)]  # 0.2 rad, which the estimate does not follow at first
    for steps in (30, 60, 90):
        before, after = (moved(jump + [0.3 * sign] * (steps + k), True).q[3] for k in (0, 1))
        assert (after - before) * sign == pytest.approx((0.3 + 0.5) * PERIOD, rel=1e-3)
