# SPDX-License-Identifier: Apache-2.0
"""What follows from the errors that a task declares, and from what moves them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toss_task import demonstrated_policy

from wam_power_ros import installed
from wam_power_ros.learning.parametrization import Attractors, Direction, Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import EndEffectorPath, Rollout, SimulatedRollout
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.errors import Effect, Error
from wam_power_ros.tasks.reach.settings import REACH_FIT
from wam_power_ros.tasks.settings import TaskSettings
from wam_power_ros.tasks.task import Assessment, LoggedRollout, Task

POLICY = demonstrated_policy()
SIDE, LIFT = -2.0, 0.5  # true effects [m]


class Push(Task):
    """A body is pushed: where it stops is measured."""

    name, body, single_policy, fit_settings = "push", "body", False, REACH_FIT
    errors = (Error("x", "m", 0.01, 0.05, 0.004), Error("y", "m", 0.02, 0.05, 0.004))
    effects = (Effect("sway", 0.1, {"x": SIDE}), Effect("lift", 0.2, {"y": LIFT}))
    presets: ClassVar[Mapping[str, Any]] = {
        "push": {"budget": 20, "mean_every": 3, "confirm": 5, "retests": 2}
    }

    def parametrization(self, policy: Policy) -> Parametrization:
        """Attractors, a sway along y and a lift along z."""
        n = policy.basis.count
        sway, lift, still = np.zeros((3, n, 3))
        sway[:, 1] = lift[:, 2] = 1.0
        groups = (
            Attractors(0.01),
            Direction(0.02, "sway", attractors=sway, rotation=still),
            Direction(0.05, "lift", attractors=lift, rotation=still),
        )
        return Parametrization(policy, groups)

    def assess(self, policy: Policy, rollout: Rollout) -> Assessment:
        """Nothing can be judged here."""
        return Assessment(None)

    def measure(self, observation: Mapping[str, Any]) -> Mapping[str, float] | None:
        """What was observed, if anything was."""
        return observation or None

    def outcome(self, record: LoggedRollout) -> str:
        """Nothing to say."""
        return ""


TASK = Push(TaskSettings(), {})
PARAMETRIZATION = TASK.parametrization(POLICY)


def change(shifts: list[np.ndarray]) -> dict[str, float]:
    """Sum of shifts of z, by group, in its unit."""
    total = PARAMETRIZATION.scale * sum(shifts, np.zeros(PARAMETRIZATION.size))
    return {name: float(total[PARAMETRIZATION.groups[name]][0]) for name in ("sway", "lift")}


@settings(max_examples=20)
@given(st.floats(-0.15, 0.15), st.floats(-0.08, 0.08), st.floats(0.0, 1.0))
def test_a_correction_takes_away_its_share_of_the_error(x: float, y: float, gain: float) -> None:
    model = TASK.rough_errors(PARAMETRIZATION)
    moved = change(model.correction(TASK.error({"x": x, "y": y}), gain))
    assert moved["sway"] * SIDE == pytest.approx(-gain * x, abs=1e-12)
    assert moved["lift"] * LIFT == pytest.approx(-gain * y, abs=1e-12)


def test_no_parameter_is_corrected_by_more_than_its_step_and_none_for_an_unknown_error() -> None:
    model = TASK.rough_errors(PARAMETRIZATION)
    far = change(model.correction(TASK.error({"x": 1.0, "y": -1.0}), 1.0))
    assert far == pytest.approx({"sway": 0.1, "lift": 0.2})
    assert change(model.correction(TASK.error({"y": 0.01}), 1.0))["sway"] == 0.0
    assert TASK.error({}) is None and TASK.error(None) is None


def test_a_task_is_corrected_judged_and_planned_by_its_errors_alone() -> None:
    plain = Parametrization(POLICY, (Attractors(0.01),))  # without what moves them
    assert TASK.error_model(plain, lambda policy: None) is None
    seen = Assessment(0.5, {}, {"x": 0.02, "y": -0.01})
    half = change(list(TASK.error_correction(seen, PARAMETRIZATION)))
    assert half["sway"] * SIDE == pytest.approx(-0.01)
    assert list(TASK.corrections) == ["x", "y"]
    record = type("Logged", (), {"observation": seen.observation})()
    assert TASK.success_margins(record) == pytest.approx([0.03, 0.04])
    assert list(TASK.scatter) == [0.004, 0.004]
    record.observation = {"x": 0.02}
    assert list(TASK.success_margins(record)) == []
    model = TASK.error_model(PARAMETRIZATION, lambda policy: None)
    assert model.predict is None
    np.testing.assert_allclose(model.slopes, [[SIDE * 0.1 / 0.01, 0.0], [0.0, LIFT * 0.2 / 0.02]])


def test_the_learner_of_a_task_with_errors_plans_unless_its_preset_says_otherwise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(installed, "task_type", lambda name: Push)
    assert preset("push").learner == "model_based"
    monkeypatch.setattr(Push, "errors", ())
    assert preset("push").learner == "power"
    assert TASK.error_model(PARAMETRIZATION, lambda policy: None) is None
    assert list(TASK.error_correction(Assessment(0.5, {}, {"x": 1.0}), PARAMETRIZATION)) == []


def test_an_error_that_nothing_moves_is_a_margin_alone_and_without_a_limit_it_is_refused() -> None:
    """As a misspelt one would be, which would never be learnt from."""
    watched = Error("depth", "m", 0.01, limit=0.04)
    deep = type("Deep", (Push,), {"errors": (*Push.errors, watched)})(TaskSettings(), {})
    seen = {"x": 0.02, "y": -0.01, "depth": 0.01}
    record = type("Logged", (), {"observation": seen})()
    assert list(deep.success_margins(record)) == pytest.approx([0.03, 0.04, 0.03])
    assert deep.error(seen) == pytest.approx([2.0, -0.5])
    model = deep.error_model(PARAMETRIZATION, lambda policy: None)
    assert model.slopes.shape == (2, 2)
    with pytest.raises(TypeError, match=r"Typo: error 'xx' has no limit, .* move only x, y"):
        type("Typo", (Push,), {"errors": (Error("xx", "m", 0.01),)})


def test_an_error_or_effect_that_makes_no_sense_is_refused() -> None:
    for changes in ({"tolerance": math.nan}, {"unit": 1.0}, {"limit": 0.01}, {"scatter": -0.01}):
        with pytest.raises(ValueError, match="must be"):
            Error(**{"name": "x", "unit": "m", "tolerance": 0.02, **changes})
    for step, slope in ((-0.1, 1.0), (0.1, 0.0), (0.1, math.nan)):
        with pytest.raises(ValueError, match=r"step must be above 0|by a finite number, not 0"):
            Effect("amplitude", step, {"x": slope})


def test_an_effect_of_a_place_that_its_group_does_not_have_is_refused() -> None:
    beyond = Effect("sway", 0.1, {"x": SIDE}, place=1)
    far = type("Far", (Push,), {"effects": (beyond,), "errors": Push.errors[:1]})
    with pytest.raises(ValueError, match=r"place=1\): the group has 1 parameters"):
        far(TaskSettings(), {}).rough_errors(PARAMETRIZATION)


def test_what_a_task_predicts_sharpens_its_slopes() -> None:
    def predict(self: Task, simulated: SimulatedRollout) -> list[dict[str, float]]:
        x = float(simulated.tool.position[0, 0])
        return [{"x": x, "y": 0.02}, {"x": x + 0.005, "y": 0.02}, {"x": x + 0.01}]

    tool = EndEffectorPath("t", np.zeros(1), np.full((1, 3), 0.03), np.array([[0.0, 0, 0, 1]]))
    knowing = type("Knowing", (Push,), {"predict": predict})(TaskSettings(), {})
    model = knowing.error_model(
        PARAMETRIZATION, lambda policy: SimulatedRollout(tool, np.array([-0.1]))
    )
    found = model.predict(np.zeros(PARAMETRIZATION.size))
    assert found.error == pytest.approx([3.0, 1.0]) and found.limit_excess == pytest.approx([-0.1])
    # The last of the numbers decides whether y has a value: that tells nothing of x.
    np.testing.assert_allclose(found.uncertain, [[0.5, 0.0], [0.0, 0.0]])
    alone = type("Alone", (Push,), {"predict": lambda self, simulated: [{"x": 0.01}]})
    model = alone(TaskSettings(), {}).error_model(
        PARAMETRIZATION, lambda policy: SimulatedRollout(tool, np.empty(0))
    )
    found = model.predict(np.zeros(PARAMETRIZATION.size))
    assert np.isnan(found.error[1]) and found.uncertain.shape == (1, 0)
