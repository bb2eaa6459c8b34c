# SPDX-License-Identifier: Apache-2.0
"""A session that failed knows why: each cause, from a session that has it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from toss_task import demonstrated_policy, practice_of

from wam_power_ros.faults import FaultKind
from wam_power_ros.practice.failure import Cause, Failure, why_failed
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session_log import Trial
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.task import Assessment

POLICY = demonstrated_policy()
SETTINGS = preset("flip", "hindsight", budget=30, confirm=0, retests=2)
TASK = SETTINGS.make_task({})
MODEL = TASK.rough_errors(TASK.parametrization(POLICY))
STEPS = np.linalg.pinv(MODEL.directions)
BEGAN = np.array([-4.0, 3.0, -2.0, 1.0])  # error of the demonstration [tolerances]
Outcome = tuple[Assessment, dict[str, Any]]
Change = Callable[[int, Assessment], Outcome]


def judged(trial: Trial, rng: np.random.Generator, mirrored: bool = False) -> Assessment:
    """A toss whose errors are those of the task's model, with noise."""
    moved = MODEL.slopes @ (trial.z @ STEPS)
    moved[1] *= -1.0 if mirrored else 1.0
    error = BEGAN + moved + rng.normal(0.0, 0.3, len(moved))
    turned, x, y, pitch = (e.tolerance * v for e, v in zip(MODEL.errors, error, strict=True))
    seen = {"tossed": True, "seen": True, "angle": math.pi + turned, "landing_error": [x, y, 0.12]}
    seen |= {"catch_pitch": pitch, "climb": 0.0, "apex": 0.4, "resting": False, "flipped": False}
    return Assessment(1.0 / (1.0 + float(np.linalg.norm(error))), observation=seen)


def session(change: Change, mirrored: bool = False) -> Practice:
    practice, rng = practice_of([POLICY], SETTINGS, seed=3), np.random.default_rng(0)
    while (trial := practice.next_trial()) is not None:
        assessment, logged = change(trial.number, judged(trial, rng, mirrored))
        practice.learn_assessed(trial, assessment, **logged)
    return practice


def why(change: Change, name: str = "hindsight", mirrored: bool = False) -> Failure | None:
    records = session(change, mirrored).records
    return why_failed(records, TASK, preset("flip", name, budget=30, retests=2), POLICY)


def plain(number: int, toss: Assessment) -> Outcome:
    return toss, {}


def drifting(number: int, toss: Assessment) -> Outcome:
    x, y, z = toss.observation["landing_error"]
    return replace(
        toss, observation={**toss.observation, "landing_error": [x + 0.01 * number, y, z]}
    ), {}


def lost(why: str, every: int, **observation: float) -> Change:
    nothing = Assessment(None, observation=observation or None, why=why)
    return lambda number, toss: (nothing if number % every == 0 else toss, {})


def ended(kind: FaultKind, ret: float | None) -> Change:
    logged = {"fault": kind.value, "fault_kind": kind}
    return lambda number, toss: (Assessment(ret), logged) if number % 2 == 0 else (toss, {})


def worst_succeeds(number: int, toss: Assessment) -> Outcome:
    success = number % 3 == 0
    return replace(toss, success=success, ret=toss.ret * (0.5 if success else 1.0)), {}


@pytest.mark.parametrize(
    ("change", "cause", "detail"),
    [
        (lost("80 ms", 2, stamps_late=0.08), Cause.CLOCKS, ""),
        (lost("never seen", 2), Cause.UNSEEN, "never seen"),
        (lost("never seen", 4), Cause.UNKNOWN, ""),  # too few
        # not the stamps, which were corrected
        (lost("never seen", 2, stamps_late=0.03, tossed=False), Cause.UNSEEN, "never seen"),
        (ended(FaultKind.PLANE, 0.0), Cause.PLANE, "plane"),
        (ended(FaultKind.JOINT_SPEED, 0.0), Cause.LIMITS, "joint_speed"),
        (ended(FaultKind.TRACKING, None), Cause.FAULTS, "tracking"),
        (ended(FaultKind.EXTERNAL_TORQUE, None), Cause.TORQUE, "external_torque"),
        (drifting, Cause.DRIFT, "landing_x"),
        (worst_succeeds, Cause.DISAGREE, ""),
        (plain, Cause.UNKNOWN, ""),
    ],
)
def test_the_cause_of_a_failure_is_found(change: Change, cause: Cause, detail: str) -> None:
    found = why(change)
    assert found is not None
    assert (found.cause, found.detail) == (cause, detail)
    assert cause in (Cause.UNKNOWN, Cause.DISAGREE) or 4 * found.count > found.total


def test_an_error_that_is_mirrored_does_not_follow_the_model() -> None:
    found = why(plain, mirrored=True)
    assert (found.cause, found.detail) == (Cause.IGNORED, "landing_x")
    assert found.size < 0.0


def test_an_error_that_mostly_has_no_value_is_named() -> None:
    class Blind(type(TASK)):
        def measure(self, observation: dict[str, Any]) -> dict[str, float]:
            return {**super().measure(observation), "landing_x": math.nan}

    records = session(plain).records
    found = why_failed(records, Blind(SETTINGS.task_settings, {}), SETTINGS, POLICY)
    assert (found.cause, found.detail) == (Cause.UNMEASURED, "landing_x")
    assert found.count == found.total
    by_return = preset("flip", "return_only", budget=30, retests=2)
    found = why_failed(records, Blind(by_return.task_settings, {}), by_return, POLICY)
    assert found.cause is Cause.UNKNOWN, "what is not learnt from is no cause"


def test_rollouts_that_power_chose_are_a_cause_with_a_learner_that_plans() -> None:
    assert why(plain, "model_based").cause is Cause.FELL_BACK


def test_a_session_that_goes_on_or_succeeded_has_not_failed() -> None:
    records = session(plain).records
    for part in (20, 31):  # while it learns, and after the first re-test
        assert why_failed(records[:part], TASK, SETTINGS, POLICY) is None
    good = [r.model_copy(update={"success": r.kind == "retest"}) for r in records]
    assert why_failed(good, TASK, SETTINGS, POLICY) is None


def test_a_session_without_one_usable_rollout_has_failed() -> None:
    nothing = Assessment(None, why="the pancake was never seen")
    found = why(lambda number, toss: (nothing, {}))
    assert (found.cause, found.count, found.total) == (Cause.UNSEEN, 3, 3)


def test_a_heavy_tool_whose_demonstration_cannot_be_reproduced_is_named() -> None:
    heavy = {"fault": "4 N m are not explained", "fault_kind": FaultKind.EXTERNAL_TORQUE}
    found = why(lambda number, toss: (Assessment(None if number == 1 else 0.0), heavy))
    assert (found.cause, found.count, found.total) == (Cause.TORQUE, 2, 2)


@pytest.mark.parametrize(("share", "soft"), [(1.0, False), (0.5, False), (0.12, True)])
def test_springs_that_cannot_follow_what_is_learnt_are_named(share: float, soft: bool) -> None:
    start = replace(POLICY, stiffness=share * POLICY.stiffness)
    found = why_failed(session(plain).records, TASK, SETTINGS, start)
    assert (found.cause is Cause.SOFT) is soft
    assert not soft or 0.0 < found.size < 1 / 3
