# SPDX-License-Identifier: Apache-2.0
"""Reaching a goal around an obstacle on the demonstrated path (Eq. 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.parametrization import Parametrization, parametrization_of
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.regions import Region, region_of
from wam_power_ros.tasks.errors import Effect, Error
from wam_power_ros.tasks.reach.paths import resampled, stopped_paths
from wam_power_ros.tasks.reach.returns import reaching_terms
from wam_power_ros.tasks.reach.settings import PRESETS, REACH_FIT, ReachSettings
from wam_power_ros.tasks.task import (
    Assessment,
    Goal,
    LoggedRollout,
    Task,
    cut_short,
    fault_assessment,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AXES = ("x", "y", "z")  # of the base frame


class Reach(Task):
    """The tool reaches past an obstacle.

    The controller stops a rollout whose tool enters the obstacle. Its return is that of a path
    which stays at its last sample before the obstacle (Eq. 4).

    Attributes:
        targets: Position of the goal [m].
        demonstrated: x_D, the mean demonstration, towards the goal [m]. Shape (T, 3).
        region: Obstacle, a guarded region of the controller; None for none.
    """

    name: ClassVar[str] = "reach"
    single_policy: ClassVar[bool] = True
    fit_settings = REACH_FIT
    Settings: ClassVar[type[ReachSettings]] = ReachSettings
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = PRESETS
    # The end of the tool: the last attractor, which ends the movement, moves it.
    errors = tuple(Error(axis, "m", 0.01) for axis in AXES)
    effects = tuple(Effect("attractors", 0.2, {axis: 1.0}, k - 3) for k, axis in enumerate(AXES))
    gain = 0.0  # the return is learnt from as it is
    goal = Goal(question="whether the obstacle was touched", observed="touched", true="touched")

    def __init__(self, settings: ReachSettings, context: Mapping[str, Any]) -> None:
        self.demonstrated = np.array(context["demonstrated"], dtype=float)  # (T, 3)
        self.targets = dict(zip(AXES, self.demonstrated[-1].tolist(), strict=True))
        super().__init__(settings, context)
        moved = np.array([self.targets[axis] for axis in AXES]) - self.demonstrated[-1]
        way = np.linalg.norm(np.diff(self.demonstrated, axis=0), axis=1).cumsum() + 1e-9  # (T-1,)
        self.demonstrated[1:] += (way / way[-1])[:, np.newaxis] * moved
        self.region = region_of("obstacle", context["obstacle"])

    @classmethod
    def context_of(
        cls, demonstrations: Sequence[Demonstration], region: Region | None
    ) -> dict[str, Any]:
        """Return the mean demonstration x_D, which ends at the goal, and the obstacle."""
        return {
            "demonstrated": resampled(demonstrations).mean(axis=0).tolist(),
            "obstacle": [0.0] * 4 if region is None else [*region.centre, region.radius],
        }

    def parametrization(self, policy: Policy) -> Parametrization:
        """Learnt parameters of a policy; see `Task`."""
        return parametrization_of(policy, self.settings.variant, self.settings.noise)

    def assess(self, policy: Policy, rollout: Rollout) -> Assessment:
        """Return (Eq. 4) and success of a rollout of `policy`."""
        if rollout.fault is not None:
            return fault_assessment(rollout.fault)
        tool = rollout.tool
        steps = len(self.demonstrated)
        t = np.arange(steps) * (policy.basis.duration / (steps - 1))
        path = np.stack([np.interp(t, tool.t, x) for x in tool.position.T], axis=1)  # (T, 3)
        region = self.region
        centre = np.zeros(3) if region is None else np.array(region.centre)
        radius = 0.0 if region is None else region.radius
        stopped, collided = stopped_paths(path[np.newaxis], centre, radius)
        touched = bool(collided[0] or rollout.stopped_in)  # perhaps between two samples
        why = cut_short(policy, rollout, self.settle_time)
        if why and not touched:
            return Assessment(None, why=why)
        end, wanted = stopped[0, -1], self.demonstrated[-1]
        reached = reaching_terms(stopped, self.demonstrated, wanted)
        tracking, goal = (float(term[0]) for term in reached)
        goal_distance = float(np.linalg.norm(end - wanted))
        clearance = float(np.linalg.norm(path - centre, axis=1).min() - radius)
        seen = {"touched": touched, "goal_distance": goal_distance, "clearance": clearance}
        return Assessment(
            tracking + goal,
            {"following": tracking, "goal": goal},
            {**seen, "end": end.tolist()},
            success=not touched and goal_distance <= self.settings.goal_tolerance,
            why="stopped at the obstacle" if touched else "",
        )

    def measure(self, observation: Mapping[str, Any]) -> Mapping[str, float] | None:
        """Where the tool ended, unless the obstacle stopped it; see `Task`."""
        if observation["touched"] or "end" not in observation:
            return None
        return dict(zip(AXES, observation["end"], strict=True))

    def success_margins(self, record: LoggedRollout) -> Sequence[float]:
        """Distance from the goal within its tolerance, and clearance of the obstacle [m]."""
        seen = record.observation
        if seen is None:
            return ()
        reached = self.settings.goal_tolerance - seen["goal_distance"]
        return (reached,) if self.region is None else (reached, seen["clearance"])

    def outcome(self, record: LoggedRollout) -> str:
        """Distance from the goal and contact with the obstacle; see `Task`."""
        if record.fault:
            return f"fault: {record.fault}"
        if (seen := record.observation) is None:
            return record.why or "not seen"
        if seen["touched"]:
            return f"touched the obstacle, {100 * seen['goal_distance']:.0f} cm from the goal"
        return f"{1000 * seen['goal_distance']:.0f} mm from the goal"

    def figure(self, rollout: Rollout) -> tuple[Figure, str]:
        """Demonstrated and executed path around the obstacle; see `Task`."""
        from wam_power_ros.tasks.reach.figures import executed  # imports matplotlib: slow

        return executed(rollout.tool.position, self.demonstrated, self.region), ""
