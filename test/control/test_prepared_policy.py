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

SETTINGS = ControllerSettings()
POLICY = replace(make_policy(), stiffness=np.tile(300.0 * np.eye(3), (8, 1, 1)))


def test_a_policy_that_does_not_fit_is_refused_with_value_and_limit() -> None:
    low, high, stiffness = HOME.copy(), HOME.copy(), POLICY.stiffness.copy()
    low[0], high[6] = LIMITS.q_min[0] - 1e-6, LIMITS.q_max[6] + 1e-6
    stiffness[7] *= 9.0  # one matrix is enough
    for wrong, text in (
        ({"q_start": HOME[:6]}, "is for 6 joints, the arm has 7"),
        ({"q_start": low}, "outside the limits"),
        ({"q_start": high}, "outside the limits"),
        ({"stiffness": stiffness}, "stiffness 2700 .* above the limit 2500"),
        ({"rotation_stiffness": 3000.0}, "stiffness 3000"),
        ({"damping": 101.0}, "damping 101 .* above the limit 100"),
        ({"rotation_damping": 101.0}, "damping 101 .* above the limit 100"),
    ):
        with pytest.raises(ControllerError, match=text) as refused:
            prepare(replace(POLICY, **wrong), LIMITS, SETTINGS)
        assert refused.value.refusal is Refusal.REFUSED


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
