# SPDX-License-Identifier: Apache-2.0
"""Recorded calls are answered the same again; a torque that differs in its last bit is found."""

from __future__ import annotations

import numpy as np
import pytest
import recorded_calls

from wam_power_ros.control import safety
from wam_power_ros.control.modes import Mode


@pytest.fixture(scope="module")
def recorded() -> list[recorded_calls.Drive]:
    return list(recorded_calls.drives(every=7))


def test_a_new_controller_answers_recorded_calls_the_same_bit_for_bit(
    recorded: list[recorded_calls.Drive],
) -> None:
    answers = [call.answer for drive in recorded for call in drive.calls]
    assert {answer.mode for answer in answers} == set(Mode)
    assert len({answer.fault.kind for answer in answers if answer.fault}) >= 2
    assert [found for drive in recorded for found in recorded_calls.differences(drive)] == []


def test_one_changed_bit_of_a_torque_is_a_difference(
    recorded: list[recorded_calls.Drive], monkeypatch: pytest.MonkeyPatch
) -> None:
    exact = safety.damped_gravity
    monkeypatch.setattr(
        safety, "damped_gravity", lambda *given: np.nextafter(exact(*given), np.inf)
    )
    assert all(recorded_calls.differences(drive) for drive in recorded)
