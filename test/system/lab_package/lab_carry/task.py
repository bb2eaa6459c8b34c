# SPDX-License-Identifier: Apache-2.0
"""The task `carry`: bring the cup to where it was brought, the ball staying in its middle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel

from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.dmp import fit
from wam_power_ros.learning.parametrization import NoiseScales, Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.tasks.reach.settings import REACH_FIT
from wam_power_ros.tasks.task import (
    Assessment,
    BodyState,
    LoggedRollout,
    Pose,
    cut_short,
    fault_assessment,
)


class CarrySettings(BaseModel):
    """Settings: what is learnt, and the time a rollout goes on after the movement [s]."""

    noise: NoiseScales = NoiseScales(stiffness=0.2, attractor=0.01, rotation=0.05)
    settle_time: float = 0.5


class Carry:
    """See `wam_power_ros.tasks.task.Task`."""

    name = "carry"
    body = "ball"
    single_policy = False
    Settings = CarrySettings
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
        self.settings, self._goal = settings, np.array(context["goal"])
        self.settle_time = settings.settle_time

    @classmethod
    def policy_of(cls, demonstrations: Sequence[Demonstration], policy_id: str) -> Policy:
        return fit(demonstrations, REACH_FIT, policy_id)

    @classmethod
    def context_of(
        cls, demonstrations: Sequence[Demonstration], obstacle: Sequence[float]
    ) -> dict[str, Any]:
        return {"goal": np.mean([d.position[-1] for d in demonstrations], axis=0).tolist()}

    def parametrization(self, policy: Policy) -> Parametrization:
        return Parametrization(policy, "full", self.settings.noise)

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

    def hindsight(self, assessment: Assessment, parametrization: Parametrization) -> tuple[()]:
        return ()

    def confirms(self, record: LoggedRollout) -> bool:
        return True

    def model(self, parametrization: Parametrization, start: np.ndarray) -> None:
        return None

    def outcome(self, record: LoggedRollout) -> str:
        seen = record.observation
        return record.why if seen is None else f"ball {1000 * seen['off']:.0f} mm off"

    def summary(self, records: Sequence[LoggedRollout]) -> list[str]:
        return [f"calm in {sum(record.success for record in records)} of {len(records)} rollouts"]
