# SPDX-License-Identifier: Apache-2.0
"""Ball-in-a-cup: when a rollout may begin, what it is worth, and what its miss teaches."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.demonstration import from_positions
from wam_power_ros.learning.dmp import fit
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.ball_in_cup.settings import CUP_FIT
from wam_power_ros.tasks.ball_in_cup.swing import GRAVITY, PLANE, STRING, Swing
from wam_power_ros.tasks.ball_in_cup.task import MISS_OF_AMPLITUDE, MISS_OF_SHIFT, BallInCup
from wam_power_ros.tasks.task import Assessment, Pose

SETTINGS = preset("ball_in_cup").task_settings
CUP = np.array([0.5, 0.0, 0.8])
INSIDE, HANGING = np.array([0.0, 0.0, 0.02]), np.array([0.0, 0.0, -STRING])


def to_and_fro() -> np.ndarray:
    t = np.linspace(0.0, 2.0, 500)
    x, z = 0.1 * np.sin(np.pi * t) ** 2, 0.05 * (1.0 - np.cos(np.pi * t))
    return CUP + np.stack([x, 0.0 * t, z], axis=1)


POLICY = fit([from_positions(to_and_fro(), 0.004)], CUP_FIT, "trial-0001")


def task(**changes: float) -> BallInCup:
    return BallInCup(SETTINGS.model_copy(update=changes), {})


def rollout(miss: float, caught: bool, lower: float = 0.0, fault: Fault | None = None) -> Rollout:
    """A cup that stays and a ball that falls at 1.5 s, `miss` beside its middle, or stays low."""
    end = POLICY.basis.duration + SETTINGS.settle_time
    t = np.arange(0.0, end, 0.002)
    cup = EndEffectorPath(
        POLICY.id, t, np.tile(CUP, (len(t), 1)), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    )
    frames = t[::16]
    since = frames - 1.5
    height = PLANE - 1.8 * since - 0.5 * GRAVITY * since**2 - lower
    position = CUP + np.stack([miss + 0.0 * since, 0.0 * since, height], axis=1)
    position[since > 0.0] = CUP + (INSIDE if caught else HANGING)
    ball = BodyPath(POLICY.id, frames, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(frames), 1)))
    return Rollout(cup, ball, fault)


@pytest.mark.parametrize(
    ("miss", "caught", "success"),
    [
        (0.0, True, True),
        (-0.025, True, True),
        (0.01, False, False),  # out again
        (0.06, True, False),  # snapped back into the cup by the string
    ],
)
def test_a_success_comes_down_onto_the_cup_and_ends_in_it(
    miss: float, caught: bool, success: bool
) -> None:
    assessment = task().assess(POLICY, rollout(miss, caught))
    assert assessment.success is success
    assert assessment.ret == pytest.approx(math.exp(-SETTINGS.sharpness * miss**2), abs=0.01)
    assert sum(assessment.terms.values()) == assessment.ret


def test_a_ball_that_stays_low_is_worth_less_the_lower_it_stays() -> None:
    low, lower = (task().assess(POLICY, rollout(0.0, False, by)) for by in (0.2, 0.3))
    beside = task().assess(POLICY, rollout(0.39, False))
    assert beside.ret > low.ret > lower.ret > 0.0 and not low.success
    assert low.observation is not None and "rise" in low.why and not beside.why


def test_a_ball_that_is_not_seen_is_neither_judged_nor_ready_nor_put_back() -> None:
    whole = rollout(0.0, True)
    for unseen in (None, whole.body.part(whole.body.t < 1.0)):
        assessment = task().assess(POLICY, Rollout(whole.tool, unseen))
        assert assessment.ret is None and "not seen" in assessment.why
    assert "not seen" in task().ready(None, Pose(CUP, np.eye(3)))
    assert task().reset(None, HeldCup(), np.zeros(7)) == "person"


def test_a_fault_of_the_policy_is_worth_nothing_and_any_other_is_not_judged() -> None:
    for kind, ret in ((FaultKind.JOINT_SPEED, 0.0), (FaultKind.STATES_LOST, None)):
        assert task().assess(POLICY, rollout(0.0, True, fault=Fault(kind, "fault"))).ret == ret


@pytest.mark.parametrize(
    ("ball", "speed", "why"),
    [
        ((0.0, 0.0, -STRING), 0.0, ""),
        ((0.0, 0.02, -STRING), 0.02, ""),
        ((0.0, 0.0, -STRING), 0.2, "swings"),
        ((0.2, 0.0, -STRING), 0.0, "from where it hangs"),
        ((0.0, 0.0, 0.02), 0.0, "empty it"),
    ],
)
def test_a_rollout_begins_with_the_ball_at_rest_below_the_cup(
    ball: tuple[float, ...], speed: float, why: str
) -> None:
    state = SimpleNamespace(position=CUP + ball, velocity=np.array([0.0, speed, 0.0]))
    answer = task().ready(state, Pose(CUP, np.eye(3)))
    assert why in answer and bool(answer) == bool(why)


class HeldCup:
    """An arm whose upright cup is displaced by its first three joints."""

    n = 7

    def tool_pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the cup."""
        return CUP + q[:3], np.eye(3)


@pytest.mark.parametrize(
    ("ball", "speed", "does"),
    [
        ((0.0, 0.0, 0.02), 0.0, "rolls"),
        ((0.0, 0.0, -STRING), 0.5, "steps"),
        ((0.05, 0.0, -0.397), 0.0, "steps"),
        ((0.0, 0.0, -STRING), 2.0, "wait"),
        ((0.3, 0.0, -0.1), 0.0, "person"),  # on the forearm
        ((0.0, 0.0, 0.2), 0.0, "person"),
    ],
)
def test_the_arm_empties_the_cup_and_stills_a_ball_on_a_taut_string(
    ball: tuple[float, ...], speed: float, does: str
) -> None:
    state = SimpleNamespace(position=CUP + ball, velocity=np.array([0.0, speed, 0.0]))
    action = task().reset(state, HeldCup(), np.zeros(7))
    if isinstance(action, str):
        assert action == does
    else:
        moves = np.ptp(action.q, axis=0) > 1e-9
        assert moves.tolist() == [does == "steps" and moves[0], moves[1], *[False] * 4, moves[6]]
        assert moves[6] == (does == "rolls") and moves[:2].any() == (does == "steps")


def corrected(swing: Swing, **changes: float) -> dict[str, float]:
    """Sum of the corrections of each parameter, in its unit."""
    practised = task(**changes)
    parametrization = practised.parametrization(POLICY)
    shifts = practised.error_correction(Assessment(0.5, {}, swing.to_json()), parametrization)
    total = parametrization.scale * sum(shifts, np.zeros(parametrization.size))
    assert not total[parametrization.groups["attractors"]].any()
    return {n: float(total[parametrization.groups[n]][0]) for n in ("amplitude", "sideways")}


def test_a_fall_beside_the_cup_is_corrected_by_what_would_have_moved_it_back() -> None:
    short = corrected(Swing(0.1, 2.0, (0.02, -0.01), False), gain=1.0)
    assert short["amplitude"] * MISS_OF_AMPLITUDE == pytest.approx(-0.02)
    assert short["amplitude"] > 0.0  # it fell short
    assert short["sideways"] * MISS_OF_SHIFT == pytest.approx(0.01)
    half = corrected(Swing(0.1, 2.0, (0.02, -0.01), False), gain=0.5)
    assert half == pytest.approx({name: 0.5 * value for name, value in short.items()})
    assert corrected(Swing(0.1, 2.0, (-0.02, 0.0), False))["amplitude"] < 0.0


def record(**changes: object) -> SimpleNamespace:
    swing = Swing(0.1, 2.0, (0.03, 0.0), True).to_json()
    known = {"kind": "retest", "ret": 0.9, "observation": swing, "success": True}
    return SimpleNamespace(**{**known, "why": "", "fault": "", "truth": None, **changes})


def test_reports_say_how_far_beside_the_cup_and_whether_in_it() -> None:
    practised = task()
    low = Swing(-0.12, None, None, False).to_json()
    missed = Swing(0.1, 2.0, (0.0, 0.2), False).to_json()
    assert practised.outcome(record()) == "3.0 cm beside, in the cup"
    assert practised.outcome(record(observation=missed)) == "20.0 cm beside, missed"
    assert practised.outcome(record(observation=low)) == "12 cm below the rim"
    assert practised.measured([record(), record(observation=missed)]) == {
        "median error of the re-tests: distance": "115.0 mm"
    }
    assert practised.measured([record(observation=low)]) == {}
    assert [practised.achieved(r) for r in (record(), record(fault="x"))] == [True, False]
