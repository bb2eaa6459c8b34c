# SPDX-License-Identifier: Apache-2.0
"""The movement of the commissioning keeps its limits and holds what the analysis needs."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
import true_arm

from wam_power_ros.commissioning import excitation as module
from wam_power_ros.control.replay_trajectory import sampled
from wam_power_ros.control.safety import limits_of
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import robot_description
from wam_power_ros.params.torque_controller_params import TorqueControllerParams

ARM = true_arm.plain()
LIMITS = limits_of(ARM)


def played(plan: module.Excitation) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, float]:
    """Times, postures, their speeds, and the highest speeds of guarded points and tool [m/s]."""
    t = np.arange(0.0, plan.t[-1], 0.02)
    spline = scipy.interpolate.CubicSpline(plan.t, plan.q)
    q, qd = spline(t), spline(t, 1)
    guarded, tool = zip(*(ARM.speeds(*state) for state in zip(q, qd, strict=True)), strict=True)
    return t, q, qd, max(map(max, guarded)), max(tool)


def test_speeds_and_ranges_are_kept_and_it_ends_where_it_began() -> None:
    plan = true_arm.planned()
    t, q, _, guarded, tool = played(plan)
    assert np.all((q > LIMITS.q_min) & (q < LIMITS.q_max))
    assert guarded < 0.8 and tool < 1.2
    spline = scipy.interpolate.CubicSpline(plan.t, plan.q)
    before = t < plan.sweeps[0, 0]
    assert np.abs(spline(t, 2)[before]).max() < 1.5  # rad/s^2: also a short move is no jerk
    for end in (plan.q[0], plan.q[-1]):
        assert np.allclose(end, true_arm.HOME)


def test_lower_limits_of_an_arm_are_kept_with_room() -> None:
    slow = limits_of(ARM, guarded_speed=0.5, tool_speed=0.6, qd_max=np.full(7, 0.5))
    rng = np.random.default_rng(0)
    plan = module.excitation(ARM, slow, true_arm.HOME, rng, 4, (6.0, 6.0))
    _, _, qd, guarded, tool = played(plan)
    assert tool < 0.9 * 0.6 and guarded < 0.9 * 0.5 and np.abs(qd).max() < 0.9 * 0.5


def test_every_posture_is_reached_from_below_and_from_above() -> None:
    plan = true_arm.planned()
    spline = scipy.interpolate.CubicSpline(plan.t, plan.q)
    for number, (begin, end) in enumerate(plan.rests):
        assert np.allclose(spline(begin + 0.1), spline(end - 0.1), atol=1e-6)
        before = spline(begin - 0.2) - spline(end)
        assert np.all(before < 0.0 if number % 2 == 0 else before > 0.0)
    below, above = plan.rests[0::2, 1], plan.rests[1::2, 1]
    assert np.allclose(spline(below), spline(above), atol=1e-6)


def test_the_arm_of_a_set_up_has_room_for_its_movement() -> None:
    setup = overlay.setup(["franka"], simulated=True)
    params = TorqueControllerParams.from_setup(setup)
    core = params.controller(robot_description(params.urdf))
    home = np.array(setup["wam_sim"]["home"])
    rng = np.random.default_rng(0)
    plan = module.excitation(setup.arm(), core.limits, home, rng, 4, (6.0, 6.0))
    sampled(plan.t, plan.q, params.period, core.limits)  # raises beyond a limit


def test_a_place_without_room_is_refused() -> None:
    table = limits_of(ARM, plane=[0.0, 0.0, 1.0, 1.5])
    with pytest.raises(ValueError, match="keep the limits of the arm: check home, workspace"):
        module.excitation(ARM, table, true_arm.HOME, np.random.default_rng(0))
