# SPDX-License-Identifier: Apache-2.0
"""The task `carry`: bring the cup to where it was brought, the ball staying in its middle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydantic import BaseModel, ConfigDict

from wam_power_ros import plotting
from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.parametrization import NoiseScales, Parametrization, parametrization_of
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.regions import Region
from wam_power_ros.tasks.reach.settings import REACH_FIT
from wam_power_ros.tasks.task import (
    Assessment,
    BodyState,
    Goal,
    LoggedRollout,
    Pose,
    Task,
    cut_short,
    fault_assessment,
)


class CarrySettings(BaseModel):
    """Settings: what is learnt, and the time a rollout goes on after the movement [s]."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    noise: NoiseScales = NoiseScales(stiffness=0.2, attractor=0.01, rotation=0.05)
    settle_time: float = 0.5


class Carry(Task):
    """See `wam_power_ros.tasks.task.Task`."""

    name = "carry"
    body = "ball"
    single_policy = False
    fit_settings = REACH_FIT
    Settings = CarrySettings
    goal = Goal(achieved="kept the ball in the middle", first="first calm one", retests="calm")
    presets = {
        "carry": {
            "learner": {"name": "power"},
            "budget": 6,
            "mean_every": 3,
            "confirm": 0,
            "retests": 0,
        }
    }

    def __init__(self, settings: CarrySettings, context: Mapping[str, Any]) -> None:
        super().__init__(settings, context)
        self._goal = np.array(context["goal"])

    @classmethod
    def context_of(
        cls, demonstrations: Sequence[Demonstration], region: Region | None
    ) -> dict[str, Any]:
        return {"goal": np.mean([d.position[-1] for d in demonstrations], axis=0).tolist()}

    def parametrization(self, policy: Policy) -> Parametrization:
        return parametrization_of(policy, "full", self.settings.noise)

    def ready(self, body: BodyState | None, tool: Pose) -> str:
        off = np.inf if body is None else float(np.linalg.norm(body.position - tool.position))
        return "" if off < 0.12 else f"the ball is {off:.2f} m from the middle of the cup"

    def assess(self, policy: Policy, rollout: Rollout) -> Assessment:
        if rollout.fault is not None:
            return fault_assessment(rollout.fault)
        if why := cut_short(policy, rollout, self.settle_time):
            return Assessment(None, why=why)
        pan, ball = rollout.tool, rollout.body
        if ball is None or len(ball.t) < 10:
            return Assessment(None, why="the ball was not seen")
        middle = np.stack([np.interp(ball.t, pan.t, x) for x in pan.position.T], axis=1)
        off = float(np.linalg.norm(ball.position - middle, axis=1).mean())
        missed = float(np.linalg.norm(pan.position[-1] - self._goal))
        terms = {"calm": 0.5 * np.exp(-off / 0.05), "goal": 0.5 * np.exp(-missed / 0.1)}
        return Assessment(sum(terms.values()), terms, {"off": off}, off < 0.06)

    def outcome(self, record: LoggedRollout) -> str:
        seen = record.observation
        return record.why if seen is None else f"ball {1000 * seen['off']:.0f} mm off"

    def summary(self, records: Sequence[LoggedRollout]) -> list[str]:
        return [f"calm in {sum(record.success for record in records)} of {len(records)} rollouts"]

    def figure(self, rollout: Rollout) -> tuple[Figure, str]:
        figure, (axes,) = plotting.side_by_side(7.2, 3.0, 1.0)
        for name, path in (("pan", rollout.tool), ("ball", rollout.body)):
            axes.plot(path.t, path.position[:, 1], label=f"y of the {name}")
        plotting.legend(axes)
        return figure, "The ball follows the pan."
