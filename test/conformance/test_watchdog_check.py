# SPDX-License-Identifier: Apache-2.0
"""The watchdog test detects a watchdog and cannot move the arm."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from conftest import ROOT

from wam_power_ros.conformance.topic_checks import Row, Verdict
from wam_power_ros.conformance.watchdog_check import FRICTION_SHARE, MOTION_MAX, CommandCheck
from wam_power_ros.control.arm import Arm

NAMES = tuple(f"wam_j{i}" for i in range(1, 8))
Q = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])
TICK = 2_000_000  # [ns]


@cache
def model() -> Arm:
    return Arm((ROOT / "urdf/wam7.urdf").read_text(), NAMES)


def run_check(
    adds: bool = False,
    configured: bool | None = None,
    watchdog: int | None = 5,
    delay: int = 3,
    slip: float = 0.0,
    ignores: bool = False,
    order: np.ndarray | None = None,
    period_ns: int = TICK,
) -> tuple[Row, list[np.ndarray]]:
    """Run the test on a simulated driver; returns the row and the torques sent.

    The driver adds gravity or not, reports commands after `delay` ticks unless it ignores them,
    and returns to its own torque `watchdog` ticks after the last command, or never.
    """
    gravity = model().gravity(Q)
    check = CommandCheck(model(), NAMES, adds if configured is None else configured, Q, gravity)
    sent: list[np.ndarray] = []
    in_transit: list[np.ndarray | None] = [None] * delay
    command, silent, q = None, 10**6, Q.copy()
    for tick in range(1, 2000):
        arrived = in_transit.pop(0)
        silent = 0 if arrived is not None else silent + 1
        command = command if arrived is None else arrived
        if arrived is not None and order is not None:
            command = arrived[order]
        own = command is None or ignores or (watchdog is not None and silent > watchdog)
        tau = gravity if own else command + (gravity if adds else 0.0)
        q = q + (0.0 if own else slip)
        torque = check.step(tick * period_ns, q, tau)
        in_transit.append(torque)
        if torque is not None:
            sent.append(torque.copy())
        if check.finished:
            break
    assert check.finished
    return check.row, sent


@pytest.mark.parametrize("adds", [False, True])
def test_a_driver_with_a_watchdog_passes_and_gets_no_offset_above_friction(adds: bool) -> None:
    row, sent = run_check(adds)
    assert row.verdict is Verdict.OK
    carrier = np.zeros(7) if adds else model().gravity(Q)
    extra = np.abs(np.array(sent) - carrier)
    assert (extra <= FRICTION_SHARE * model().friction + 1e-9).all()
    assert extra.max() > 0.1
    np.testing.assert_array_equal(sent[-1], carrier)  # a driver may hold this one from now on


@pytest.mark.parametrize("adds", [False, True])
def test_a_driver_that_holds_the_last_torque_fails_and_ends_with_the_torque_that_carries_the_arm(
    adds: bool,
) -> None:
    row, sent = run_check(adds, watchdog=None)
    assert (row.verdict, "no watchdog" in row.found) == (Verdict.FAIL, True)
    np.testing.assert_array_equal(sent[-1], np.zeros(7) if adds else model().gravity(Q))


def test_a_slow_watchdog_is_a_warning_also_on_a_machine_that_is_busy() -> None:
    for watchdog, period_ns, found in ((100, TICK, "206 ms"), (40, 10 * TICK, "860 ms")):
        row, _ = run_check(watchdog=watchdog, period_ns=period_ns)
        assert (row.verdict, found in row.found) == (Verdict.WARN, True)


@pytest.mark.parametrize("adds", [False, True])
def test_gravity_that_is_carried_twice_or_by_nobody_ends_the_test_at_once(adds: bool) -> None:
    row, sent = run_check(adds, configured=not adds)
    said = f"driver_compensates_gravity: {str(adds).lower()}"
    assert (row.verdict, said in row.advice) == (Verdict.FAIL, True)
    assert len(sent) <= 5
    np.testing.assert_array_equal(sent[-1], np.zeros(7) if adds else model().gravity(Q))


def test_an_arm_that_moves_ends_the_test() -> None:
    row, sent = run_check(slip=0.2 * MOTION_MAX)
    assert (row.verdict, "moved by" in row.found) == (Verdict.FAIL, True)
    assert len(sent) < 15


def test_a_driver_that_does_not_report_commands_cannot_be_checked() -> None:
    row, _ = run_check(ignores=True)
    assert row.verdict is Verdict.UNCHECKED


def test_without_friction_in_the_urdf_nothing_is_sent() -> None:
    text = (ROOT / "urdf/wam7.urdf").read_text().replace('friction="', 'friction="0" was="')
    with pytest.raises(ValueError, match="no friction"):
        CommandCheck(Arm(text, NAMES), NAMES, False, Q, np.zeros(7))


def test_torques_that_act_on_other_joints_are_named() -> None:
    row, _ = run_check(adds=True, order=np.array([2, 1, 0, 3, 4, 5, 6]))
    assert row.verdict is Verdict.FAIL
    assert row.found == "sent to wam_j1, reported of wam_j3"
    assert "joint_names" in row.advice
