# SPDX-License-Identifier: Apache-2.0
"""Mistakes of a driver show in the states of an arm at rest, or guided by hand."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from wam_power_ros.conformance import arm_checks
from wam_power_ros.conformance.arm_checks import ArmRecord, StateSample
from wam_power_ros.conformance.topic_checks import Verdict
from wam_power_ros.control.arm import Arm

NAMES = tuple(f"wam_j{i}" for i in range(1, 8))
POSTURE = np.array([0.3, 0.4, -0.2, 1.9, 0.25, -0.5, 0.4])
UNLOADED = {0, 4, 6}  # joints with gravity torques below the tolerance in this posture
HOME = np.deg2rad([0.0, 20.0, 0.0, 122.0, 0.0, -27.0, 0.0])
TICK = 2_000_000  # [ns]


@cache
def model() -> Arm:
    return Arm((ROOT / "urdf/wam7.urdf").read_text(), NAMES)


def at_rest(q: np.ndarray = POSTURE, names: tuple[str, ...] = NAMES) -> list[StateSample]:
    """States of a correct driver that carries the arm."""
    noise = np.random.default_rng(21).normal(scale=1e-5, size=(50, 7))
    tau = model().gravity(q)
    return [
        StateSample(i * TICK, (i + 1) * TICK, names, q + noise[i], np.zeros(7), tau)
        for i in range(50)
    ]


def led(joint: int, by: float = 0.4, scale: float = 1.0) -> list[StateSample]:
    """States while a person guides one joint by `by` [rad]; velocities times `scale`."""
    phase = np.linspace(0.0, 1.0, 500)
    moves = 0.5 * by * (1.0 - np.cos(np.pi * phase))
    speeds = 0.5 * by * np.pi * np.sin(np.pi * phase)  # movement of one second
    axis = np.eye(7)[joint]
    return [
        StateSample(i * TICK, (i + 1) * TICK, NAMES, POSTURE + axis * q, axis * v * scale, axis * 0)
        for i, (q, v) in enumerate(zip(moves, speeds, strict=True))
    ]


def record(samples: list[StateSample]) -> ArmRecord:
    return arm_checks.collect(samples, NAMES)[0]


def changed(**values: object) -> list[StateSample]:
    """States at rest with other values in every one."""
    return [sample._replace(**values) for sample in at_rest()]


def gravity(samples: list[StateSample], effort: str = "torque") -> tuple[Verdict, str]:
    """Verdict on torques at rest, and the words of the row."""
    row = arm_checks.gravity(record(samples), model(), effort)
    return row.verdict, f"{row.found}; {row.advice}"


def test_joints_are_found_by_name_among_other_devices() -> None:
    order = np.array([3, 6, 0, 2, 5, 1, 4])
    samples = [
        s._replace(names=(*(NAMES[i] for i in order), "finger"), q=np.append(s.q[order], 9.0))
        for s in at_rest()
    ]
    samples.insert(3, samples[0]._replace(names=("lift",), q=np.zeros(1)))
    found, row = arm_checks.collect(samples, NAMES)
    np.testing.assert_allclose(found.q.mean(axis=0), POSTURE, atol=1e-5)
    assert len(found.q) == 50
    assert row.verdict is Verdict.OK
    assert row.found == "in another order, matched by name; also received: finger lift"


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ({"names": tuple(f"q{i}" for i in range(1, 8))}, "q1 q2"),
        ({"names": (*NAMES, "wam_j1"), "q": np.zeros(8)}, "a name twice"),
        ({"q": np.zeros(6)}, "6 positions for 7 names"),
        ({"q": np.full(7, np.nan)}, "not finite"),
    ],
)
def test_states_without_every_joint_once_do_not_conform(
    change: dict[str, object], fragment: str
) -> None:
    found, row = arm_checks.collect(changed(**change), NAMES)
    assert row.verdict is Verdict.FAIL
    assert fragment in row.found
    assert arm_checks.positions(found, model()).verdict is Verdict.UNCHECKED


def test_several_publishers_of_the_same_joints_do_not_conform() -> None:
    assert arm_checks.one_publisher("/states", "").verdict is Verdict.OK
    row = arm_checks.one_publisher("/states", "/driver, /zeros")
    assert (row.verdict, row.found) == (Verdict.FAIL, "/driver, /zeros")


def test_positions_are_radians_within_the_limits() -> None:
    assert arm_checks.positions(record(at_rest()), model()).verdict is Verdict.OK
    for q, said in ((np.rad2deg(POSTURE), "degrees"), (POSTURE + 2.0, "wam_j2, wam_j4")):
        row = arm_checks.positions(record(changed(q=q)), model())
        assert (row.verdict, said in row.advice) == (Verdict.FAIL, True)


def test_a_correct_driver_passes_and_joints_indistinguishable_at_rest_are_named() -> None:
    for q, alike in ((POSTURE, "wam_j1, wam_j5, wam_j7"), (HOME, "wam_j1, wam_j3, wam_j5, wam_j7")):
        verdict, said = gravity(at_rest(q))
        assert verdict is Verdict.OK
        assert f"cannot distinguish {alike} from each other" in said


@settings(max_examples=30)
@given(st.integers(0, 2**31))
def test_a_correct_driver_passes_in_every_posture(seed: int) -> None:
    q = np.random.default_rng(seed).uniform(model().q_min, model().q_max)
    assert gravity(at_rest(q))[0] in (Verdict.OK, Verdict.UNCHECKED)


@settings(max_examples=15)
@given(st.permutations(range(7)))
def test_joints_in_any_other_order_are_named_as_such(order: list[int]) -> None:
    assume({i for place, i in enumerate(order) if i != place} - UNLOADED)
    verdict, said = gravity(changed(names=tuple(NAMES[i] for i in order)))
    assert (verdict, "wrong order of joints" in said) == (Verdict.FAIL, True)


def test_what_is_wrong_with_torques_at_rest_is_named() -> None:
    for joint in (1, 5):
        signs = np.where(np.arange(7) == joint, -1.0, 1.0)
        wrong = [s._replace(q=s.q * signs, tau=s.tau * signs) for s in at_rest()]
        verdict, said = gravity(wrong)
        assert (verdict, said.endswith(f"sign reversed: {NAMES[joint]}")) == (Verdict.FAIL, True)
    tau = model().gravity(POSTURE)
    assert "sign reversed" in gravity(changed(tau=-tau))[1]
    assert "payload" in gravity(changed(tau=1.5 * tau))[1]


def test_gravity_is_not_checked_where_its_torques_are_small() -> None:
    idle, without = changed(tau=np.zeros(7)), changed(tau=np.empty(0))
    for samples in (at_rest(np.zeros(7)), idle, without, led(1)):
        assert gravity(samples)[0] is Verdict.UNCHECKED


@pytest.mark.parametrize(
    ("samples", "expected", "fragment"),
    [
        (at_rest(), Verdict.OK, ""),
        (led(3), Verdict.OK, ""),
        (led(3, scale=180.0 / np.pi), Verdict.FAIL, "degrees a second"),
        (led(3, scale=-1.0), Verdict.FAIL, "sign is reversed"),
        (led(3, scale=0.0), Verdict.FAIL, "not the derivative"),
        (changed(qd=np.full(7, 3.0)), Verdict.FAIL, "other units"),
        (changed(qd=np.empty(0)), Verdict.FAIL, "velocity_topic"),
        (changed(qd=np.full(7, np.nan)), Verdict.FAIL, "velocity_topic"),
        (changed(qd=np.full(7, np.inf)), Verdict.FAIL, "must not"),
    ],
)
def test_velocities_must_be_the_derivative_of_the_positions(
    samples: list[StateSample], expected: Verdict, fragment: str
) -> None:
    row = arm_checks.velocity(record(samples))
    assert row.verdict is expected
    assert fragment in row.advice


def test_velocities_of_a_separate_topic_count() -> None:
    samples = led(2)
    bare = record([s._replace(qd=np.empty(0)) for s in samples])
    received = np.array([s.received_ns for s in samples])
    whole = arm_checks.with_velocity(bare, received, np.array([s.qd for s in samples]))
    assert arm_checks.velocity(whole, "/velocities").verdict is Verdict.OK
    silent = arm_checks.with_velocity(bare, received[:0], np.empty((0, 7)))
    assert arm_checks.velocity(silent, "/velocities").found == "no velocity"


def test_the_guided_joint_must_be_the_one_that_moves_and_in_the_requested_direction() -> None:
    assert arm_checks.hand_movement(record(led(2)), 2).verdict is Verdict.OK
    other = arm_checks.hand_movement(record(led(4)), 2)
    assert (other.verdict, "wam_j5 is the name of this one" in other.advice) == (Verdict.FAIL, True)
    assert "reversed" in arm_checks.hand_movement(record(led(2, by=-0.4)), 2).advice
    assert arm_checks.hand_movement(record(at_rest()), 2).verdict is Verdict.UNCHECKED
    silent = arm_checks.hand_movement(record([]), 2)
    assert (silent.verdict, silent.found) == (Verdict.FAIL, "no states of these joints")


def test_the_direction_in_which_to_guide_a_joint_is_named() -> None:
    q = np.array([0.0, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0])
    for joint, fragment in ((0, "to its left"), (1, "down"), (6, "turns clockwise")):
        assert fragment in arm_checks.tool_direction(model(), q, joint)


@pytest.mark.parametrize(("lag", "expected"), [(0.010, "10 ms"), (0.025, "25 ms")])
def test_the_lag_of_the_velocity_of_a_moved_joint_is_measured(lag: float, expected: str) -> None:
    samples, joint = [], np.eye(7)[2]
    for tick in range(1000):
        now, stamp_ns = 0.002 * tick, 10**18 + TICK * tick
        late = now - lag
        q = POSTURE + 0.3 * np.sin(4.0 * now) ** 3 * joint
        qd = 3.6 * np.sin(4.0 * late) ** 2 * np.cos(4.0 * late) * joint
        samples.append(StateSample(stamp_ns, stamp_ns, NAMES, q, qd, np.zeros(7)))
    row = arm_checks.velocity_lag(record(samples), 2)
    assert row.found == expected
    assert (row.verdict is Verdict.OK) is (lag < 0.016)
    assert arm_checks.velocity_lag(record(samples), 3).verdict is Verdict.UNCHECKED


def test_motor_currents_are_not_taken_for_torques() -> None:
    current = model().gravity(POSTURE) / 12.0
    assert arm_checks.effort(record(changed(tau=current)), "current").verdict is Verdict.OK
    assert gravity(changed(tau=current))[0] is Verdict.FAIL
    upright = at_rest(np.zeros(7))
    wrist, elbow = (np.where(np.arange(7) == joint, -1.0, 1.0) for joint in (6, 3))
    for samples, verdict, *words in (
        (changed(tau=current), Verdict.UNCHECKED, "signs agree at wam_j2, wam_j4", "zero and payl"),
        (changed(tau=current * wrist), Verdict.UNCHECKED, "signs agree"),  # it carries nothing
        (changed(tau=current * elbow), Verdict.FAIL, "reversed at wam_j4"),
        (changed(tau=0.0 * current), Verdict.UNCHECKED, "brakes"),
        (upright, Verdict.UNCHECKED, "stretch"),
    ):
        found, said = gravity(samples, "current")
        assert found is verdict and all(word in said for word in words), said


def test_torques_without_gravity_are_small_and_those_with_it_are_named() -> None:
    g = model().gravity(POSTURE)
    assert arm_checks.effort(record(at_rest()), "external").verdict is Verdict.OK
    for tau, verdict, word in (
        (0.05 * g, Verdict.UNCHECKED, "do not show at rest"),
        (g, Verdict.FAIL, "it contains gravity"),
        (np.full(7, 30.0), Verdict.FAIL, "payload"),
    ):
        found, said = gravity(changed(tau=tau), "external")
        assert (found, word in said) == (verdict, True), said


def test_a_driver_without_effort_is_as_its_set_up_says_or_not() -> None:
    without = changed(tau=np.empty(0))
    assert gravity(without, "none")[0] is Verdict.UNCHECKED
    for quantity, verdict in (("none", Verdict.OK), ("current", Verdict.WARN)):
        assert arm_checks.effort(record(without), quantity).verdict is verdict
    assert "set effort" in arm_checks.effort(record(at_rest()), "none").advice
