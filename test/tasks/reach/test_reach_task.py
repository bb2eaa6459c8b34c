# SPDX-License-Identifier: Apache-2.0
"""Reaching task: Eq. 4 of executed paths that are stopped at the obstacle."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from reproduction.studies.reaching_scenario import midpoint
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.demonstration import Demonstration, from_positions
from wam_power_ros.learning.rollout import EndEffectorPath, Rollout
from wam_power_ros.practice.settings import preset
from wam_power_ros.regions import region_of
from wam_power_ros.tasks.reach.paths import resampled
from wam_power_ros.tasks.reach.returns import reaching_return, reaching_terms
from wam_power_ros.tasks.reach.task import Reach

RADIUS = 0.05
SETTINGS = preset("reach").task_settings


def minimum_jerk(count: int) -> np.ndarray:
    s = np.linspace(0.0, 1.0, count)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def demonstrations(count: int = 2) -> list[Demonstration]:
    s = minimum_jerk(500)[:, None]
    start = np.array([0.7, -0.25, 0.6])
    return [from_positions(start + s * [0.01 * k, 0.5, 0.0], 0.004) for k in range(count)]


DEMONSTRATIONS = demonstrations()
OBSTACLE = [*midpoint(resampled(DEMONSTRATIONS)), RADIUS]
POLICY = Reach.policy_of(DEMONSTRATIONS, "trial-0001")


def task(obstacle: list[float] = OBSTACLE) -> Reach:
    return Reach(SETTINGS, Reach.context_of(DEMONSTRATIONS, region_of("obstacle", obstacle)))


def path(y: np.ndarray, z: np.ndarray) -> EndEffectorPath:
    """Path of the tool that holds its last position during the settle time."""
    t = np.arange(0.0, POLICY.basis.duration + 1.0, 0.01)
    along = np.minimum(t / POLICY.basis.duration, 1.0)
    grid = np.linspace(0.0, 1.0, len(y))
    position = np.stack(
        [np.full_like(t, 0.705), np.interp(along, grid, y), np.interp(along, grid, z)], axis=1
    )
    return EndEffectorPath(POLICY.id, t, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))


def straight() -> EndEffectorPath:
    return path(np.array([-0.25, 0.25]), np.array([0.6, 0.6]))


def around() -> EndEffectorPath:
    return path(np.array([-0.25, 0.0, 0.25]), np.array([0.6, 0.75, 0.6]))


def cut(whole: EndEffectorPath, end: float) -> EndEffectorPath:
    kept = whole.t < end
    return EndEffectorPath(whole.id, whole.t[kept], whole.position[kept], whole.quat_xyzw[kept])


def test_a_path_around_the_obstacle_is_worth_equation_4_and_a_success() -> None:
    assessment = task().assess(POLICY, Rollout(around()))
    assert assessment.success and not assessment.observation["touched"]
    assert sum(assessment.terms.values()) == pytest.approx(assessment.ret)
    t = np.linspace(0.0, POLICY.basis.duration, 200)
    sampled = np.stack([np.interp(t, around().t, x) for x in around().position.T], axis=1)
    demonstrated = resampled(DEMONSTRATIONS).mean(axis=0)
    expected = reaching_return(sampled[np.newaxis], demonstrated, demonstrated[-1])
    assert assessment.ret == pytest.approx(float(expected[0]))
    nearest = float(np.linalg.norm(sampled - OBSTACLE[:3], axis=1).min())
    assert assessment.observation["clearance"] == pytest.approx(nearest - RADIUS) != 0.0


def test_the_margins_of_a_reach_are_its_distance_from_the_goal_and_its_clearance() -> None:
    seen = {"goal_distance": 0.03, "clearance": 0.01}
    row = SimpleNamespace(observation=seen)
    assert task().success_margins(row) == pytest.approx((SETTINGS.goal_tolerance - 0.03, 0.01))
    assert task([*OBSTACLE[:3], 0.0]).success_margins(row) == pytest.approx((0.02,))
    assert task().success_margins(SimpleNamespace(observation=None)) == ()


def test_a_path_into_the_obstacle_is_worth_what_it_is_when_it_stays_there() -> None:
    through = task().assess(POLICY, Rollout(straight()))
    stopped = task().assess(POLICY, Rollout(cut(straight(), 0.45 * POLICY.basis.duration)))
    assert through.observation["touched"] and stopped.observation["touched"]
    assert stopped.ret == pytest.approx(through.ret)  # the path after the contact does not matter
    assert through.ret < task().assess(POLICY, Rollout(around())).ret
    assert not through.success
    free = task([*OBSTACLE[:3], 0.0]).assess(POLICY, Rollout(straight()))
    assert free.success and free.ret > through.ret


def test_a_rollout_that_the_controller_stopped_in_its_region_has_touched_the_obstacle() -> None:
    share = (0.25 - RADIUS - 0.006) / 0.5  # of the way, on which the obstacle is in the middle
    path = cut(straight(), share * POLICY.basis.duration)
    assert task().assess(POLICY, Rollout(path)).ret is None
    assessment = task().assess(POLICY, Rollout(path, stopped_in="obstacle"))
    assert assessment.observation["touched"] and assessment.ret is not None
    assert assessment.why == "stopped at the obstacle"


def test_a_fault_counts_by_its_kind() -> None:
    for kind, ret in ((FaultKind.TOOL_SPEED, 0.0), (FaultKind.STATES_LOST, None)):
        assert task().assess(POLICY, Rollout(around(), None, Fault(kind, "why"))).ret == ret


def test_a_table_names_the_distance_and_the_contact() -> None:
    seen = {"touched": True, "goal_distance": 0.234, "clearance": -0.01}
    row = SimpleNamespace(kind="retest", fault="", why="", observation=seen)
    assert task().outcome(row) == "touched the obstacle, 23 cm from the goal"


def one(path: np.ndarray, demonstrated: np.ndarray, goal: np.ndarray) -> float:
    return float(reaching_return(path[np.newaxis], demonstrated, goal)[0])


def test_equation_4_of_a_perfect_path_is_almost_one() -> None:
    path = np.linspace([0.0, 0.0, 0.0], [0.5, 0.0, 0.0], 200)
    # 199 of the 200 steps earn w1/T, the last earns w2.
    assert one(path, path, path[-1]) == pytest.approx(0.5 * 199 / 200 + 0.5)


def test_equation_4_counts_each_step_by_its_distance() -> None:
    demonstrated = np.zeros((4, 3))
    path = np.array([[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3], [0.4, 0, 0]])
    expected = 0.5 / 4 * sum(math.exp(-d) for d in (1, 2, 3)) + 0.5 * math.exp(-4)
    assert one(path, demonstrated, np.zeros(3)) == pytest.approx(expected)
    following, goal = reaching_terms(path[np.newaxis], demonstrated, np.zeros(3))
    assert goal[0] == pytest.approx(0.5 * math.exp(-4))
    assert following[0] + goal[0] == pytest.approx(expected)


def test_a_path_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="must be"):
        reaching_return(np.zeros((1, 5, 3)), np.zeros((6, 3)), np.zeros(3))
    with pytest.raises(ValueError, match="finite"):
        reaching_return(np.full((1, 5, 3), math.nan), np.zeros((5, 3)), np.zeros(3))
