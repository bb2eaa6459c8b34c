# SPDX-License-Identifier: Apache-2.0
"""Flipping a pancake: toss it, half a turn in the air, catch it (Eq. 5)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout, SimulatedRollout
from wam_power_ros.regions import Region
from wam_power_ros.tasks.flip import assessment as flip_assessment
from wam_power_ros.tasks.flip.frames import DELTA_H, REST_HEIGHT_MAX
from wam_power_ros.tasks.flip.pan_toss import predict_toss
from wam_power_ros.tasks.flip.parametrization import flip_parametrization
from wam_power_ros.tasks.flip.placement import ONE_MARKER, misplaced
from wam_power_ros.tasks.flip.returns import pancake_return
from wam_power_ros.tasks.flip.settings import FLIP_FIT, PRESETS, TRUE_TURN, FlipSettings
from wam_power_ros.tasks.flip.toss_errors import EFFECTS, ERRORS, PANCAKES, measured_errors
from wam_power_ros.tasks.heading import forward_of_turn, heading, turned, turned_path
from wam_power_ros.tasks.task import Assessment, BodyState, Goal, LoggedRollout, Pose, Task

_OFFSET_MAX = 0.10  # largest distance of the pancake from the pan's centre before a rollout [m]
_RIM_OFFSET_MIN = 0.06  # from which on one above the floor lies on the rim [m]
_MISPLACED_MAX = 0.15  # height up to which a body at rest is in the pan, seen wrongly [m]
_REST_SPEED_MAX = 0.05  # largest speed at rest [m/s]
_TURN_NOISE = 1e-9  # of an angular velocity or speed: less is not measured [rad/s, m/s]


class Flip(Task):
    """A pancake is tossed, turns over and is caught."""

    name: ClassVar[str] = "flip"
    body: ClassVar[str] = "pancake"
    fit_settings = FLIP_FIT
    errors, effects = ERRORS, EFFECTS
    rest_time = 0.3  # frames of it show which side is up, and the clocks of the cameras
    targets = MappingProxyType({"apex": math.nan})
    Settings: ClassVar[type[FlipSettings]] = FlipSettings
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = PRESETS
    goal = Goal(
        achieved="flipped the pancake",
        first="first flip",
        retests="flipped",
        question="whether the pancake was caught",
        observed="resting",
        true="caught",
    )

    def __init__(self, settings: FlipSettings, context: Mapping[str, Any]) -> None:
        """See `Task`."""
        super().__init__(settings, context)
        self.gain = settings.gain
        if (apex := self.targets["apex"]) <= DELTA_H:
            raise ValueError(f"apex = {apex} m must be above delta_h = {DELTA_H} m")

    @classmethod
    def context_of(
        cls, demonstrations: Sequence[Demonstration], region: Region | None
    ) -> dict[str, Any]:
        """Heading of the tosses; see `Task`."""
        return {"heading": heading(demonstrations, forward_of_turn)}

    def parametrization(self, policy: Policy) -> Parametrization:
        """Learnt parameters of a policy; see `Task`."""
        settings = self.settings
        return flip_parametrization(policy, settings.variant, settings.noise, self.heading)

    def ready(self, body: BodyState | None, tool: Pose) -> str:
        """Check that the pancake rests in the pan, which may be tilted; see `Task`."""
        if body is None:
            return "the pancake is not seen"
        x, y, height = in_pan = tool.rotation.T @ (body.position - tool.position)
        aside, speed = math.hypot(x, y), float(np.linalg.norm(body.velocity))
        above = aside < _OFFSET_MAX and abs(height) < _MISPLACED_MAX
        if above and aside > _RIM_OFFSET_MIN and height > REST_HEIGHT_MAX:
            return f"the pancake lies on the rim of the pan, {height * 1e3:.0f} mm above its floor"
        wrong = misplaced(in_pan)
        if not above or (wrong and speed >= _REST_SPEED_MAX):
            return f"the pancake is not in the pan: {x:.3f}, {y:.3f}, {height:.3f} m in its frame"
        if speed >= _REST_SPEED_MAX:
            return f"the pancake moves at {speed:.2f} m/s"
        blind = float(np.linalg.norm(body.angular_velocity)) < _TURN_NOISE < speed
        return wrong or (ONE_MARKER if blind else "")

    def assess(self, policy: Policy, rollout: Rollout) -> Assessment:
        """Return and success of a rollout of `policy`, less far from a goal's apex."""
        found = flip_assessment.assess(policy, turned(rollout, self.heading), self.settings)
        apex, seen = self.targets["apex"], found.observation
        if math.isnan(apex) or found.ret is None or seen is None:
            return found
        off = abs(seen["apex"] - apex) / ERRORS[-1].limit
        share, success = math.exp(-off), found.success and off < 1.0
        terms = {name: share * term for name, term in found.terms.items()}
        return replace(found, ret=share * found.ret, terms=terms, success=success)

    def success_margins(self, record: LoggedRollout) -> Sequence[float]:
        """Those of the errors, unless another rotation is a success, or none is needed."""
        low, high = self.settings.success_angle, self.settings.success_angle_max
        least, most = math.pi - ERRORS[0].limit, math.pi + ERRORS[0].limit
        within = 0.0 < low <= least + 1e-9 and most <= high + 1e-9
        return super().success_margins(record) if within else ()

    def measure(self, observation: Mapping[str, Any]) -> Mapping[str, float] | None:
        """Errors of rotation, landing and catch; see `Task`."""
        return measured_errors(observation)

    def predict(self, simulated: SimulatedRollout) -> Sequence[Mapping[str, float]]:
        """Tosses of the usual pancake, and of others that it may be, along the simulated path."""
        pan = turned_path(simulated.tool, self.heading)
        return [predict_toss(pan, pancake) for pancake in PANCAKES]

    def outcome(self, record: LoggedRollout) -> str:
        """Rotation and end state of the pancake, as tracked; see `Task`."""
        if record.fault:
            return f"fault: {record.fault}"
        if (flight := record.observation) is None or "tossed" not in flight:
            return record.why or "not seen"
        caught = "caught" if flight.get("resting") else "dropped"
        if not flight.get("tossed"):
            return "not tossed" if flight.get("resting") else "not tossed, dropped"
        turned = f"{abs(math.degrees(flight.get('angle', 0.0))):.0f}° "
        if self.achieved(record):
            return f"{turned}flipped, {caught}"
        over = flight.get("flipped") and flight.get("resting")
        return turned + (f"turned over, {caught}" if over else caught)

    def summary(self, records: Sequence[LoggedRollout]) -> list[str]:
        """Flips and Eq. 5 of the re-tests, and in simulation their true flips; see `Task`."""
        retests = [record for record in records if record.kind == "retest"]
        if not retests:
            return []
        seen = [record.observation for record in retests if record.observation]
        flips = sum(self.achieved(record) for record in retests)
        flights = [flight for each in seen if (flight := flip_assessment.flight_of(each))]
        returns = [math.fsum(pancake_return(flight).values()) for flight in flights]
        eq5 = f"; Eq. 5: mean {np.mean(returns):.3f}, lowest {min(returns):.3f}" if returns else ""
        lines = [f"re-tests of the final policy: {flips} of {len(retests)} flipped{eq5}"]
        truths = [record.truth for record in retests if record.truth]
        if truths:
            over = sum(bool(t.get("caught") and t.get("flipped")) for t in truths)
            true = sum(bool(t.get("true_flip")) for t in truths)
            others = f"; {over - true} more turned over and caught" if over > true else ""
            lines.append(
                f"simulator's ground truth: {true} of {len(truths)} flipped (150 to 240 degrees in "
                f"the air, and caught){others}"
            )
        return lines

    def achieved(self, record: LoggedRollout) -> bool:
        """Whether the observed pancake made a true flip: caught, and turned by `TRUE_TURN`."""
        seen = record.observation or {}
        turned_over = not record.fault and seen.get("flipped") and seen.get("resting")
        low, high = map(math.radians, TRUE_TURN)
        return bool(turned_over and low <= abs(seen.get("angle", 0.0)) <= high)
