# SPDX-License-Identifier: Apache-2.0
"""A task that says what it measures and what moves it, and nothing else: all else has a default."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from toss_task import demonstrated_policy

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.tasks.errors import Effect, Error
from wam_power_ros.tasks.settings import TaskSettings
from wam_power_ros.tasks.task import Assessment, Pose, Task

POLICY = demonstrated_policy()
END = POLICY.basis.duration + TaskSettings().settle_time  # [s] of a rollout
UPRIGHT = [0.0, 0.0, 0.0, 1.0]


class Push(Task):
    """A puck is pushed to the origin, in a time."""

    name, body = "push", "puck"
    errors = (
        Error("beside", "m", 0.01, limit=0.03),
        Error("off_line", "rad", 0.1, limit=0.2),
        Error("late", "s", 0.5),
    )
    effects = (
        Effect("shift_y", 0.05, {"beside": 1.0}),
        Effect("amplitude", 0.2, {"off_line": 0.5}),
        Effect("tempo", 0.1, {"late": -1.0}),
    )

    def observe(self, rollout: Rollout) -> Mapping[str, Any]:
        """Where it stopped, as named by the body's x, y and z."""
        return dict(zip(("beside", "off_line", "late"), rollout.body.position[-1], strict=True))


TASK = Push(TaskSettings(), {})


def rollout(*stopped: float, seen: float = END, end: float = END, fault: str = "") -> Rollout:
    """Rollout until `end` [s], after which the puck is at `stopped`, seen until then."""
    t = np.array([0.0, end])
    tool = EndEffectorPath("trial", t, np.zeros((2, 3)), np.tile(UPRIGHT, (2, 1)))
    at = np.array([[1.0, 1.0, 1.0], stopped or (0.0, 0.0, 0.0)])
    puck = BodyPath("trial", np.array([0.0, seen]), at, np.tile(UPRIGHT, (2, 1)))
    return Rollout(tool, puck, Fault(FaultKind(fault), "it was too fast") if fault else None)


def assessed(*stopped: float) -> Assessment:
    return TASK.assess(POLICY, rollout(*stopped))


def told(assessment: Assessment, fault: str = "") -> str:
    """Outcome of a logged rollout with this assessment."""
    logged = {name: getattr(assessment, name) for name in ("observation", "why", "success")}
    return TASK.outcome(type("Logged", (), {**logged, "fault": fault})())


def test_its_return_follows_from_the_errors_in_tolerances() -> None:
    found = assessed(0.02, -0.1, 0.0)
    assert found.ret == pytest.approx(1.0 / (1.0 + math.sqrt((4.0 + 1.0) / 3.0)))
    assert found.terms == {"errors": found.ret} and found.success
    assert found.observation == {"beside": 0.02, "off_line": -0.1, "late": 0.0}
    assert assessed(0.0, 0.0, 0.0).ret == 1.0
    far = [assessed(miss, 0.0, 0.0).ret for miss in (0.01, 0.1, 1.0, 10.0)]
    assert far == sorted(far, reverse=True) and far[-1] > 0.0


def test_it_is_a_success_within_all_limits_and_an_unknown_error_is_none() -> None:
    assert assessed(0.0299, -0.199, 9.0).success  # the last has no limit
    for outside in ((0.03, 0.0, 0.0), (-0.05, 0.0, 0.0), (0.0, 0.2, 0.0)):
        assert not assessed(*outside).success
    partly = type("Partly", (Push,), {"observe": lambda self, rollout: {"off_line": 0.0}})
    found = partly(TaskSettings(), {}).assess(POLICY, rollout())
    assert not found.success and found.ret == pytest.approx(1.0 / (1.0 + math.sqrt(128.0 / 3.0)))


@pytest.mark.parametrize("seen", [{}, {"besides": 0.1}, {"beside": math.nan}])
def test_a_rollout_that_tells_nothing_is_not_learnt_from(seen: dict[str, Any]) -> None:
    blind = type("Blind", (Push,), {"observe": lambda self, rollout: seen})(TaskSettings(), {})
    found = blind.assess(POLICY, rollout())
    assert found.ret is None and told(found) == found.why
    assert found.why == (
        f"observe told {', '.join(seen) or 'nothing'}, no known value of beside, off_line, late"
    )


@pytest.mark.parametrize(
    ("seen", "says"),
    [
        (None, "observe of task 'push' told None, must be a mapping"),
        ({"beside": np.zeros(3)}, r"push: beside = array\(.*\) must be a number or None"),
    ],
)
def test_what_is_observed_must_be_numbers_by_name(seen: Any, says: str) -> None:  # noqa: ANN401
    odd = type("Odd", (Push,), {"observe": lambda self, rollout: seen})(TaskSettings(), {})
    with pytest.raises(TypeError, match=says):
        odd.assess(POLICY, rollout())


def test_a_rollout_counts_only_whole_and_with_the_body_seen_at_its_end() -> None:
    fault = TASK.assess(POLICY, rollout(fault="tool_speed"))
    assert fault.ret == 0.0 and told(fault, "it was too fast") == "fault: it was too fast"
    short = TASK.assess(POLICY, rollout(end=0.5 * END, seen=0.5 * END))
    assert short.ret is None and short.why.startswith("cut short")
    assert TASK.assess(POLICY, rollout(seen=END - 0.2)).ret is not None
    unseen = [rollout(seen=END - 0.3), Rollout(rollout().tool)]
    for each in unseen:
        found = TASK.assess(POLICY, each)
        assert found.ret is None and told(found) == "the puck was not seen at the end"
    untracked = type("Untracked", (Push,), {"body": "", "observe": lambda *_: {"late": 0.0}})
    assert untracked(TaskSettings(), {}).assess(POLICY, unseen[1]).ret is not None


def test_its_outcome_is_told_by_its_errors_with_their_units() -> None:
    assert told(assessed(-0.0123, 0.1, 2.0)) == "beside -12.3 mm, off line 5.7°, late 2 s"
    own = {"name": "alone", "assess": lambda self, policy, rollout: Assessment(1.0, {}, {"x": 1})}
    alone = type("Alone", (Task,), own)(TaskSettings(), {})
    other = type("Other", (Push,), own)(TaskSettings(), {})  # whose errors are not its return's
    logged = type("Logged", (), {"fault": "", "observation": {"x": 1}, "why": "", "success": True})
    assert alone.outcome(logged()) == other.outcome(logged()) == "success"


def test_it_learns_what_the_settings_say_and_what_its_effects_move() -> None:
    parametrization = TASK.parametrization(POLICY)
    assert list(parametrization.groups) == [
        "stiffness",
        "attractors",
        "shift_y",
        "amplitude",
        "tempo",
    ]
    scales = [parametrization.scale[parametrization.groups[each.group]] for each in Push.effects]
    assert np.ravel(scales) == pytest.approx([0.01, 0.04, 0.02])  # a fifth of the steps
    attractors = type(TASK)(TaskSettings(variant="attractors"), {}).parametrization(POLICY)
    assert "stiffness" not in attractors.groups

    def moved(group: str, amount: float) -> Any:  # noqa: ANN401 - a policy
        z = np.zeros(parametrization.size)
        index = parametrization.groups[group].start
        z[index] = amount / parametrization.scale[index]
        return parametrization.policy(z, "moved")[0]

    n = POLICY.basis.count
    shift = moved("shift_y", 0.05).attractors - POLICY.attractors
    np.testing.assert_allclose(shift[:, 1], 0.05 * np.arange(1, n + 1) / n)
    assert not shift[:, [0, 2]].any()
    vigorous = moved("amplitude", 0.1)
    for name in ("attractors", "rotation_attractors"):
        before, after = getattr(POLICY, name), getattr(vigorous, name)
        np.testing.assert_allclose(after - after[0], 1.1 * (before - before[0]), atol=1e-12)
        np.testing.assert_allclose(after[0], before[0])
    assert moved("tempo", math.log(2.0)).basis.duration == pytest.approx(0.5 * END - 0.5, abs=0.01)


def test_it_is_ready_once_its_body_is_seen() -> None:
    tool = Pose(np.zeros(3), np.eye(3))
    seen = type("State", (), {"position": np.zeros(3), "velocity": np.zeros(3), "stamp_ns": 0})()
    assert TASK.ready(None, tool) == "the puck is not seen" and TASK.ready(seen, tool) == ""
