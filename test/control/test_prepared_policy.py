# SPDX-License-Identifier: Apache-2.0
"""Checks of a policy against an arm."""

import re
from dataclasses import replace

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, MODEL, make_policy

from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.policy_preparation import prepare
from wam_power_ros.learning.policy import with_id

SETTINGS = ControllerSettings()
POLICY = replace(make_policy(), stiffness=np.tile(300.0 * np.eye(3), (8, 1, 1)))


def test_a_policy_that_does_not_fit_is_refused_with_value_and_limit() -> None:
    for wrong, text in (
        ({"q_start": HOME[:6]}, "is for 6 joints, the arm has 7"),
        ({"rotation_stiffness": 3000.0}, "stiffness 3000"),
        ({"damping": 101.0}, "damping 101 .* above the limit 100"),
        ({"rotation_damping": 101.0}, "damping 101 .* above the limit 100"),
    ):
        with pytest.raises(ControllerError, match=text) as refused:
            prepare(replace(POLICY, **wrong), LIMITS, SETTINGS)
        assert refused.value.refusal is Refusal.REFUSED


def test_a_policy_at_the_limits_fits() -> None:
    flat = np.deg2rad(30.0)
    turn = np.array([[np.cos(flat), -np.sin(flat)], [np.sin(flat), np.cos(flat)]])
    stiff = 300.0 * np.eye(3)
    stiff[:2, :2] = turn @ np.diag([2499.0, 200.0]) @ turn.T  # stiff along a diagonal
    for change in (
        {"q_start": LIMITS.q_min},
        {"q_start": LIMITS.q_max},
        {"rotation_stiffness": SETTINGS.stiffness_max},
        {"damping": SETTINGS.damping_max},
        {"rotation_damping": SETTINGS.damping_max},
        {"stiffness": np.tile(stiff, (8, 1, 1))},
    ):
        policy = replace(POLICY, **change)
        assert prepare(policy, LIMITS, SETTINGS).id == policy.id


def test_one_joint_beyond_a_limit_or_one_stiff_matrix_is_enough_to_be_refused() -> None:
    low, high, stiffness = HOME.copy(), HOME.copy(), POLICY.stiffness.copy()
    low[0], high[6] = LIMITS.q_min[0] - 1e-6, LIMITS.q_max[6] + 1e-6
    stiffness[7] *= 9.0
    for change, text in (
        ({"q_start": low}, "outside the limits"),
        ({"q_start": high}, "outside the limits"),
        ({"stiffness": stiffness}, "stiffness 2700 .* above the limit 2500"),
    ):
        with pytest.raises(ControllerError, match=text):
            prepare(replace(POLICY, **change), LIMITS, SETTINGS)


def test_the_digest_of_a_policy_ignores_its_id_and_exists_only_with_hold_to_run() -> None:
    held = SETTINGS.model_copy(update={"hold_to_run": True})
    first, second = (prepare(policy, LIMITS, held) for policy in (POLICY, with_id(POLICY, "again")))
    other = prepare(replace(POLICY, damping=31.0), LIMITS, held)
    assert first.content == second.content != other.content
    assert prepare(POLICY, LIMITS, SETTINGS).content == ""


@pytest.mark.requirement("S-59")
def test_a_policy_of_another_arm_is_refused_and_both_are_named() -> None:
    ours = MODEL.identity()
    theirs = ours._replace(name="cobot7", kinematics="c" * 64)
    settings = SETTINGS.model_copy(update={"arm": ours})
    why = f"policy trial-0001 belongs to another arm: {theirs}; this arm is {ours}"
    with pytest.raises(ControllerError, match=re.escape(why)):
        prepare(replace(POLICY, arm=theirs), LIMITS, settings)
    for arm in (ours, None):
        assert prepare(replace(POLICY, arm=arm), LIMITS, settings).id == POLICY.id
    assert prepare(replace(POLICY, arm=theirs), LIMITS, SETTINGS).id == POLICY.id
