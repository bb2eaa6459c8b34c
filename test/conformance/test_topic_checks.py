# SPDX-License-Identifier: Apache-2.0
"""The checks that apply to any topic or service, and the verdict on a table."""

import numpy as np
import pytest

from wam_power_ros.conformance import topic_checks
from wam_power_ros.conformance.topic_checks import Endpoint, Row, Verdict

MS = 1_000_000  # [ns]
STATE = "sensor_msgs/msg/JointState"
SEE = "its publishers cannot be received: see the row on QoS"
TEXT = "node 'driver' is of another type"
START = 1_700_000_000_000 * MS
DRIVER = Endpoint("driver", True, False)
OTHER = Endpoint("teleop", True, False)


def grid(count: int, period_ms: int) -> np.ndarray:
    return START + np.arange(count) * period_ms * MS


@pytest.mark.parametrize(
    ("stamps", "hertz", "expected", "found"),
    [
        (grid(500, 2), 500.0, Verdict.OK, "500.0 Hz, 0.0% missing"),
        (grid(500, 10), 500.0, Verdict.FAIL, "100.0 Hz"),
        (grid(500, 1), 500.0, Verdict.FAIL, "1000.0 Hz"),
        (np.delete(grid(500, 2), np.s_[::5]), 500.0, Verdict.WARN, "500.0 Hz, 19.8% missing"),
        (START + (np.arange(60) * 1000 // 30 // 2) * 2 * MS, 30.0, Verdict.OK, ""),  # by 2 ms
    ],
)
def test_the_rate_is_computed_from_the_stamps_whatever_is_lost(
    stamps: np.ndarray, hertz: float, expected: Verdict, found: str
) -> None:
    row = topic_checks.rate("rate", stamps, hertz)
    assert (row.verdict, found in row.found) == (expected, True)


@pytest.mark.parametrize(
    ("stamps", "expected", "fragment"),
    [
        (grid(100, 2), Verdict.OK, "in order"),
        (np.zeros(100, dtype=np.int64), Verdict.FAIL, "not set"),
        (np.repeat(grid(50, 2), 2), Verdict.FAIL, "repeated"),
        (grid(100, 2)[::-1], Verdict.FAIL, "go back"),
        (np.sort(np.append(grid(50, 20), grid(50, 20) + 100_000)), Verdict.WARN, "1 ms"),
        (grid(0, 2), Verdict.UNCHECKED, "none"),
    ],
)
def test_stamps_must_be_set_and_increase(
    stamps: np.ndarray, expected: Verdict, fragment: str
) -> None:
    row = topic_checks.stamps("stamps", stamps)
    assert (row.verdict, fragment in row.found) == (expected, True)


def test_stamps_of_another_clock_are_a_warning() -> None:
    stamps = grid(10, 2)
    assert topic_checks.clock("clock", stamps + 5 * MS, stamps).verdict is Verdict.OK
    assert topic_checks.clock("clock", stamps + 500 * MS, stamps).verdict is Verdict.WARN
    assert "began at its start" in topic_checks.clock("clock", stamps, stamps - START).found


def test_late_messages_are_a_warning_and_never_a_failure() -> None:
    assert topic_checks.jitter("jitter", grid(100, 2), 0.002).verdict is Verdict.OK
    late = topic_checks.jitter("jitter", grid(100, 9), 0.002)
    assert (late.verdict, late.found) == (Verdict.WARN, "median 9.00, 99 % 9.00, worst 9.00 ms")


@pytest.mark.parametrize(
    ("ends", "unmatched", "expected"),
    [
        ([Endpoint("driver", False, False)], [], Verdict.OK),
        ([DRIVER], [TEXT], Verdict.FAIL),
        ([DRIVER, OTHER], [], Verdict.WARN),
        ([DRIVER, OTHER], [TEXT], Verdict.FAIL),
        ([], [], Verdict.UNCHECKED),
    ],
)
def test_publishers_that_our_subscriptions_cannot_receive_fail(
    ends: list[Endpoint], unmatched: list[str], expected: Verdict
) -> None:
    row = topic_checks.publishers("QoS", STATE, ends, unmatched)
    assert row.verdict is expected
    assert (row.found == TEXT) == bool(unmatched)


def test_without_messages_publishers_that_cannot_be_received_change_the_advice() -> None:
    ends = [DRIVER]
    assert topic_checks.reception("states", "/states", 0, 5.0, ends, [TEXT]).advice == SEE
    assert "start the driver" in topic_checks.reception("states", "/s", 0, 5.0, [], []).advice
    assert topic_checks.reception("states", "/s", 9, 5.0, ends, [TEXT]).verdict is Verdict.OK


@pytest.mark.parametrize(
    ("drivers", "commanders", "count", "unmatched", "expected", "fragment"),
    [
        ([DRIVER], [], 0, [], Verdict.OK, "driver"),
        ([], [], 0, [], Verdict.FAIL, "nobody"),
        ([DRIVER], [OTHER], 0, [], Verdict.FAIL, "teleop may command"),
        ([DRIVER], [], 7, [], Verdict.FAIL, "7 torques"),
        ([DRIVER], [], 0, [TEXT], Verdict.FAIL, TEXT),
        ([DRIVER, OTHER], [], 0, [], Verdict.WARN, "driver, teleop"),
    ],
)
def test_a_command_path_has_one_driver_and_no_commander(
    drivers: list[Endpoint],
    commanders: list[Endpoint],
    count: int,
    unmatched: list[str],
    expected: Verdict,
    fragment: str,
) -> None:
    row = topic_checks.command_path("/commands", STATE, drivers, commanders, count, unmatched)
    assert row.verdict is expected
    assert fragment in row.found


def test_a_configured_service_must_be_offered_with_its_type() -> None:
    services = {"/wam/idle": "std_srvs/srv/Trigger", "/other": "std_srvs/srv/SetBool"}
    found = [
        topic_checks.service("idle", "std_srvs/srv/Trigger", services, name).verdict
        for name in ("/wam/idle", "/other", "/none", "")
    ]
    assert found == [Verdict.OK, Verdict.FAIL, Verdict.FAIL, Verdict.WARN]


def rows(*verdicts: Verdict) -> list[Row]:
    return [Row(f"row {i}", "", "", verdict, "do") for i, verdict in enumerate(verdicts)]


def test_one_failure_decides_and_every_warning_is_named() -> None:
    failed = topic_checks.verdict(rows(Verdict.OK, Verdict.FAIL, Verdict.WARN))
    assert failed == (Verdict.FAIL, "DOES NOT CONFORM, do not move the arm: row 1.")
    result, fragment = topic_checks.verdict(rows(Verdict.OK, Verdict.WARN, Verdict.UNCHECKED))
    assert result is Verdict.WARN
    assert "row 1" in fragment and "Not checked: row 2" in fragment
    assert topic_checks.verdict(rows(Verdict.OK)) == (Verdict.OK, "CONFORMS.")


def test_only_existing_rows_can_be_accepted() -> None:
    table = topic_checks.accept(rows(Verdict.OK, Verdict.FAIL), ["row 1", "row 0"])
    assert [row.verdict for row in table] == [Verdict.OK, Verdict.WARN]
    assert table[1].advice == "accepted. do"
    with pytest.raises(ValueError, match=r"no row \['row 9'\].*row 1"):
        topic_checks.accept(rows(Verdict.OK, Verdict.FAIL), ["row 9"])


@pytest.mark.parametrize(("jitter_ms", "expected"), [(0.5, Verdict.OK), (0.75, Verdict.WARN)])
def test_the_jitter_of_stamps_is_measured_around_their_rate(
    jitter_ms: float, expected: Verdict
) -> None:
    noise = np.random.default_rng(0).standard_normal(2000)
    jittered = np.sort(grid(2000, 2) + np.round(jitter_ms * MS * noise).astype(np.int64))
    row = topic_checks.stamp_jitter("stamp jitter", np.delete(jittered, [500, 501, 900]))
    assert row.verdict is expected
    assert float(row.found.split()[0]) == pytest.approx(jitter_ms, abs=0.05)


def test_the_order_of_a_forwarder_is_that_of_the_torques() -> None:
    names = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
    for joints, interface, verdict, advice in (
        (names, "effort", Verdict.OK, ""),
        (names, "", Verdict.OK, ""),  # a group has no interface_name
        (sorted(names), "effort", Verdict.FAIL, "set joints"),
        (names, "position", Verdict.FAIL, "interface_name"),
        ((), "", Verdict.UNCHECKED, "compare"),
    ):
        row = topic_checks.torque_order("/forwarder", joints, interface, names)
        assert (row.verdict, advice in row.advice) == (verdict, True)


def test_a_driver_of_poses_is_asked_for_its_frames() -> None:
    ours = "base_link", "pan"
    assert topic_checks.pose_frames("/motion", ours, ours).verdict is Verdict.OK
    for theirs in (("world", "pan"), ("base_link", "tool0")):
        assert topic_checks.pose_frames("/motion", theirs, ours).verdict is Verdict.FAIL
    assert topic_checks.pose_frames("/bridge", (), ours).verdict is Verdict.UNCHECKED
