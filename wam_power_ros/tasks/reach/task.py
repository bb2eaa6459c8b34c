# SPDX-License-Identifier: Apache-2.0
"""Reaching a goal around an obstacle that stands on the demonstrated path (Eq. 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.dmp import fit
from wam_power_ros.learning.learner import Model
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.tasks.reach.obstacle_model import FreePath
from wam_power_ros.tasks.reach.returns import reaching_terms
from wam_power_ros.tasks.reach.scenario import Scenario, stretched
from wam_power_ros.tasks.reach.settings import PRESETS, REACH_FIT, ReachSettings
from wam_power_ros.tasks.task import (
    Assessment,
    BodyState,
    Judged,
    Pose,
    cut_short,
    fault_assessment,
)

_GRAZE = 0.01  # [m] from the obstacle within which a rollout that was ended has touched it


class Reach:
    """The task `reach`; see `tasks.task.Task`.

    A rollout whose tool enters the obstacle is stopped there by the controller and scored by Eq. 4
    as a path that stays at its last sample before the obstacle.

    Attributes:
        settings: Settings of the task.
        demonstrated: x_D, the mean demonstration [m]. Shape (T, 3).
        obstacle: Centre of the sphere [m]. Shape (3,).
        radius: Radius of the sphere, 0 for none [m].
    """

    name: ClassVar[str] = "reach"
    body: ClassVar[str] = ""
    together: ClassVar[bool] = True
    Settings: ClassVar[type[ReachSettings]] = ReachSettings
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = PRESETS

    def __init__(self, settings: ReachSettings, context: Mapping[str, Any]) -> None:
        """Make the task.

        Args:
            settings: Settings of the task.
            context: As `context_of` gave it.
        """
        self.settings = settings
        self.demonstrated = np.array(context["demonstrated"], dtype=float)  # (T, 3)
        *centre, radius = context["obstacle"]
        self.obstacle, self.radius = np.array(centre, dtype=float), float(radius)

    @classmethod
    def policy_of(cls, demonstrations: Sequence[Demonstration], policy_id: str) -> Policy:
        """Fit two primitives to all demonstrations; see `Task`."""
        return fit(demonstrations, REACH_FIT, policy_id)

    @classmethod
    def context_of(
        cls, demonstrations: Sequence[Demonstration], obstacle: Sequence[float]
    ) -> dict[str, Any]:
        """The mean demonstration x_D, whose last position is the goal, and the obstacle."""
        return {
            "demonstrated": stretched(demonstrations).mean(axis=0).tolist(),
            "obstacle": [float(value) for value in obstacle],
        }

    @property
    def settle_time(self) -> float:
        """Time a rollout goes on after the movement [s]."""
        return self.settings.settle_time

    def parametrization(self, policy: Policy) -> Parametrization:
        """What is learnt of a policy."""
        return Parametrization(policy, self.settings.variant, self.settings.noise)

    def ready(self, body: BodyState | None, tool: Pose) -> str:
        """Nothing is needed but the arm at its start; see `Task`."""
        return ""

    def assess(self, policy: Policy, rollout: Rollout) -> Assessment:
        """Return (Eq. 4) and success of a rollout of `policy`."""
        if rollout.fault is not None:
            return fault_assessment(rollout.fault)
        tool = rollout.tool
        scenario = self._scenario(policy, tool.position[0])
        t = np.arange(scenario.steps) * scenario.period
        path = np.stack([np.interp(t, tool.t, x) for x in tool.position.T], axis=1)  # (T, 3)
        stopped, collided = scenario.stopped(path[np.newaxis])
        touched = bool(collided[0])
        why = cut_short(policy, rollout, self.settings.settle_time)
        if why and not touched:  # samples may miss a graze that the controller did not
            away = float(np.linalg.norm(tool.position[-1] - scenario.obstacle))
            touched = self.radius > 0.0 and away < self.radius + _GRAZE
            if not touched:
                return Assessment(None, why=why)
        following, goal = (
            float(term[0]) for term in reaching_terms(stopped, scenario.demonstrated, scenario.goal)
        )
        missed = float(np.linalg.norm(stopped[0, -1] - scenario.goal))
        clearance = np.linalg.norm(path - scenario.obstacle, axis=1).min() - scenario.radius
        return Assessment(
            following + goal,
            {"following": following, "goal": goal},
            {"touched": touched, "goal_distance": missed, "clearance": float(clearance)},
            success=not touched and missed <= self.settings.goal_tolerance,
            why="stopped at the obstacle" if touched else "",
        )

    def hindsight(
        self, assessment: Assessment, parametrization: Parametrization
    ) -> Sequence[np.ndarray]:
        """No correction: Eq. 4 is learnt from as it is."""
        return ()

    def confirms(self, record: Judged) -> bool:
        """Every success counts."""
        return True

    def model(self, parametrization: Parametrization, start: np.ndarray) -> Model | None:
        """The path of Eq. 1, which stops where a rollout was stopped before."""
        scenario = self._scenario(parametrization.policy0, start)
        return FreePath(parametrization, scenario)

    def outcome(self, record: Judged) -> str:
        """Distance from the goal, and whether the obstacle was touched."""
        if record.fault:
            return f"fault: {record.fault}"
        seen = record.observation
        if seen is None:
            return record.why or "not seen"
        if seen["touched"]:
            return f"touched the obstacle, {100 * seen['goal_distance']:.0f} cm from the goal"
        return f"{1000 * seen['goal_distance']:.0f} mm from the goal"

    def summary(self, records: Sequence[Judged]) -> list[str]:
        """Successes and clearance of the re-tests."""
        seen = [r.observation for r in records if r.kind == "retest" and r.observation]
        if not seen:
            return []
        clear = sum(not each["touched"] for each in seen)
        clearance = min(each["clearance"] for each in seen)
        return [
            f"re-tests of the answer: {clear} of {len(seen)} passed the obstacle, "
            f"least clearance {1000 * clearance:.0f} mm"
        ]

    def _scenario(self, policy: Policy, start: np.ndarray) -> Scenario:
        period = policy.basis.duration / (len(self.demonstrated) - 1)
        paths = self.demonstrated[np.newaxis]
        return Scenario(paths, period, self.radius, policy, start, self.obstacle)
