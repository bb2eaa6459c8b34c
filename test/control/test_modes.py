# SPDX-License-Identifier: Apache-2.0
"""The table of transitions, and refusals with reason codes."""

import pytest

from wam_power_ros.control.modes import (
    MOVING_MODES,
    PASSIVE_MODES,
    TRANSITIONS,
    ControllerError,
    Mode,
    Refusal,
    check_transition,
)
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.ros.outcomes import Code

FAULT = Fault(FaultKind.PLANE, "wrist is 0.012 m behind the plane")


def test_every_refusal_is_a_code_of_an_answer() -> None:
    assert {refusal.value for refusal in Refusal} <= {code.value for code in Code}


def test_the_way_out_of_a_fault_is_its_reset_to_hold() -> None:
    check_transition(Mode.FAULT, Mode.HOLD, FAULT, reset=True)
    for target in set(Mode) - {Mode.HOLD}:
        with pytest.raises(ControllerError):
            check_transition(Mode.FAULT, target, FAULT, reset=True)


def test_every_moving_mode_can_end_in_hold_and_in_a_fault() -> None:
    assert set(TRANSITIONS) == set(Mode)
    for mode in set(Mode) - set(PASSIVE_MODES):
        assert {Mode.FAULT, Mode.INACTIVE} <= TRANSITIONS[mode]
    for mode in MOVING_MODES:
        assert TRANSITIONS[mode] == {Mode.INACTIVE, Mode.HOLD, Mode.FAULT}
