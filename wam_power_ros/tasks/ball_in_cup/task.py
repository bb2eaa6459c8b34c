# SPDX-License-Identifier: Apache-2.0
"""Ball-in-a-cup: swing the ball up, and let it fall into the cup."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from wam_power_ros.learning.demonstration import Demonstration, ToolPose
from wam_power_ros.learning.parametrization import (
    Attractors,
    Direction,
    Parametrization,
    parametrization_of,
    seen_from,
)
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.regions import Region
from wam_power_ros.tasks.ball_in_cup import reset_body
from wam_power_ros.tasks.ball_in_cup.settings import CUP_FIT, PRESETS, CupSettings
from wam_power_ros.tasks.ball_in_cup.swing import (
    CUP_RADIUS,
    STRING,
    in_cup,
    observe_swing,
    swing_of,
)
from wam_power_ros.tasks.errors import Effect, Error
from wam_power_ros.tasks.heading import forward_of_stroke, heading, turned
from wam_power_ros.tasks.reset import Action, BodyState
from wam_power_ros.tasks.task import (
    Assessment,
    Goal,
    LoggedRollout,
    Pose,
    Task,
    cut_short,
    fault_assessment,
)

SWING_PLANE = (0, 2)  # axes of the movement, from its heading: outward and up
SIDEWAYS_PROFILE = (0.5, 1.0)  # of the last attractors, at the catch, per unit of the shift [1]
HANGING_TOLERANCE = 0.05  # [m] of the ball from below the cup before a rollout
REST_SPEED = 0.03  # [m/s] of a ball at rest: a swing of 6 mm, or less and the noise of the cameras
STRINGS = (0.2, 0.6)  # [m] shortest and longest string of a goal
TAUT = 0.03  # [m] by which a ball on a taut string may be nearer or farther than its length
SWING_MIN = 0.005  # [m] amplitude of a swing that is stilled; a smaller one is noise
SWING_MAX = 0.3  # [m] the same; a larger one loses height by itself
# Effect of the corrected parameters, measured on demonstrated swings. The ball swings up on the far
# side: with too little amplitude it falls short, which is outward, with too much beyond the cup.
MISS_OF_AMPLITUDE = -2.5  # [m] change of the miss along x per unit of amplitude
APEX_OF_AMPLITUDE = 1.0  # [m] change of the apex per unit of amplitude
MISS_OF_SHIFT = -0.9  # change of the miss along y per shift [1]


class BallInCup(Task):
    """A ball on a string is swung up into a cup.

    The return is that of [Kober2011]: exp(-alpha d^2), with the horizontal distance d of ball and
    cup when the ball comes down through the plane of the rim. A ball that never does counts as one
    a string's length beside, and worse the lower it stays: with a return of 0 for all of them, as
    in [Kober2011], a demonstration that is too weak teaches nothing. A ball may fall beside the cup
    and be snapped into it, so a success needs both: a small d, and the ball in the cup at the end.
    """

    name: ClassVar[str] = "ball_in_cup"
    body: ClassVar[str] = "ball"
    fit_settings = CUP_FIT
    Settings: ClassVar[type[CupSettings]] = CupSettings
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = PRESETS
    errors = (
        Error("miss_x", "m", 0.015),
        Error("miss_y", "m", 0.015),
        Error("distance", "m", 0.015, limit=CUP_RADIUS),
    )
    effects = (
        Effect("amplitude", 0.05, {"miss_x": MISS_OF_AMPLITUDE}),
        Effect("sideways", 0.05, {"miss_y": MISS_OF_SHIFT}),
    )
    targets = MappingProxyType({"string": STRING})
    goal = Goal(
        achieved="caught the ball",
        first="first catch",
        retests="in the cup",
        question="whether the ball was in the cup",
        observed="caught",
        true="caught",
    )

    def __init__(self, settings: CupSettings, context: Mapping[str, Any]) -> None:
        super().__init__(settings, context)
        self.gain = settings.gain
        self.string = self.targets["string"]
        if not STRINGS[0] <= self.string <= STRINGS[1]:
            raise ValueError(f"string = {self.string} m must be {STRINGS[0]} to {STRINGS[1]} m")
        self.rest_time = math.pi / reset_body.swing_rate(self.string)  # half a swing

    @classmethod
    def context_of(
        cls, demonstrations: Sequence[Demonstration], region: Region | None
    ) -> dict[str, Any]:
        """Heading of the swings; see `Task`."""
        return {"heading": heading(demonstrations, forward_of_stroke)}

    def carried(self, policy: Policy, former: Mapping[str, float]) -> Policy:
        """Scale the path with the string, and time with its root: accelerations stay, see `Task`.

        A ball on a string of any length swings alike then. The stiffness stays, too: the damping is
        scaled so that the tool lags behind the attractors by its share of the path.
        """
        size, basis, start = self.string / former["string"], policy.basis, policy.attractors[0]
        slower = math.sqrt(size)
        return replace(
            policy,
            basis=replace(basis, duration=slower * basis.duration, variance=size * basis.variance),
            attractors=start + size * (policy.attractors - start),
            damping=slower * policy.damping,
        )

    def parametrization(self, policy: Policy) -> Parametrization:
        """Learnt parameters of a policy; see `Task`.

        The variant "swing" has the attractors mu_x and mu_z, in the plane of the swing, and
            amplitude: Scales the demonstrated movement, mu_i - mu_1 and r_i - r_1, by 1 + this [1].
            sideways: Moves the last attractors along y, out of the plane of the swing [m]. A shift
                in the plane would throw the ball as far again.

        Raises:
            ValueError: If the variant is "swing" and there are fewer attractors than are shifted.
        """
        variant, noise = self.settings.variant, self.settings.noise
        if variant != "swing":
            return parametrization_of(policy, variant, noise)
        n, last = policy.basis.count, len(SIDEWAYS_PROFILE)
        if n < last:
            text = f"variant {variant!r} shifts the last {last} attractors"
            raise ValueError(f"{text}, policy {policy.id!r} has {n}")
        sideways, still = np.zeros((2, n, 3))
        sideways[-last:, 1] = SIDEWAYS_PROFILE
        seen = seen_from(policy, self.heading)
        swing = seen.attractors - seen.attractors[0]
        turn = seen.rotation_attractors - seen.rotation_attractors[0]
        groups = (
            Attractors(noise.attractor, SWING_PLANE),
            Direction(noise.amplitude, "amplitude", attractors=swing, rotation=turn),
            Direction(noise.sideways, "sideways", attractors=sideways, rotation=still),
        )
        return Parametrization(policy, groups, self.heading)

    def ready(self, body: BodyState | None, tool: Pose) -> str:
        """Check that the ball hangs below the cup, at rest; see `Task`."""
        if body is None:
            return "the ball is not seen"
        offset = body.position - tool.position
        if in_cup(tool.rotation.T @ offset):
            return "the ball is in the cup: empty it"
        beside = float(np.linalg.norm(offset + np.array([0.0, 0.0, self.string])))
        speed = float(np.linalg.norm(body.velocity))
        if speed > REST_SPEED:
            return f"the ball swings at {speed:.2f} m/s"
        if beside > HANGING_TOLERANCE:
            return f"the ball is {beside:.2f} m from where it hangs, {self.string} m below the cup"
        return ""

    def reset(self, body: BodyState | None, arm: ToolPose, q_start: np.ndarray) -> Action:
        """Empty the cup, or still a swinging ball; see `Task`."""
        if body is None:
            return "person"
        tool = Pose(*arm.tool_pose(q_start))
        offset = body.position - tool.position
        if in_cup(tool.rotation.T @ offset):
            return reset_body.empty_cup(q_start)
        taut = abs(float(np.linalg.norm(offset)) - self.string) < TAUT and offset[2] < 0.0
        if not taut:
            return "person"
        rate = reset_body.swing_rate(self.string)
        swing = reset_body.swing_phasor(offset[:2], body.velocity[:2], rate)
        stills = SWING_MIN < np.abs(swing).max() < SWING_MAX
        return reset_body.damp_swing(arm, q_start, swing, rate) if stills else "wait"

    def assess(self, policy: Policy, rollout: Rollout) -> Assessment:
        """Return and success of a rollout of `policy`."""
        if rollout.fault is not None:
            return fault_assessment(rollout.fault)
        if why := cut_short(policy, rollout, self.settle_time):
            return Assessment(None, why=why)
        rollout = turned(rollout, self.heading)
        swing = None if rollout.body is None else observe_swing(rollout.tool, rollout.body)
        if swing is None:
            return Assessment(None, why="the ball was not seen when it came down or at the end")
        distance, why = swing.distance, ""
        if swing.t_c is None:
            distance = math.hypot(self.string, swing.apex)
            why = "the ball did not rise above the rim"
        ret = math.exp(-self.settings.sharpness * distance**2)
        success = swing.caught and swing.distance <= self.settings.success_distance
        return Assessment(ret, {"distance": ret}, swing.to_json(), success, why)

    def measure(self, observation: Mapping[str, Any]) -> Mapping[str, float]:
        """Where the ball fell; one that stayed low: as if a string's length short, straight."""
        swing = swing_of(observation)
        x, y = swing.miss or (self.string + MISS_OF_AMPLITUDE / APEX_OF_AMPLITUDE * swing.apex, 0.0)
        return {"miss_x": x, "miss_y": y, "distance": swing.distance}

    def outcome(self, record: LoggedRollout) -> str:
        """Distance from the cup and end of the ball, as tracked; see `Task`."""
        if record.fault:
            return f"fault: {record.fault}"
        if (seen := record.observation) is None:
            return record.why or "not seen"
        swing = swing_of(seen)
        if swing.t_c is None:
            return f"{-100 * swing.apex:.0f} cm below the rim"
        end = "in the cup" if swing.caught else "missed"
        return f"{100 * swing.distance:.1f} cm beside, {end}"

    def achieved(self, record: LoggedRollout) -> bool:
        """Whether the ball was in the cup at the end; see `Task`."""
        return bool(not record.fault and (record.observation or {}).get("caught"))
