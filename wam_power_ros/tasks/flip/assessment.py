# SPDX-License-Identifier: Apache-2.0
"""What a rollout was worth, and which of the reproduced demonstrations to learn from."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Fault
from wam_power_ros.practice.session_log import Record, plain
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.tasks.flip.flight import Flight, observe_flight
from wam_power_ros.tasks.flip.returns import landing_return, pancake_return

_LONGEST_GAP = 0.2  # s without a frame after which a pancake counts as lost: six frames at 30 Hz
_FALLEN = 0.05  # m under the pan's floor: a pancake last seen there was not lost but dropped
_CUT_SHORT = 0.05  # s a path may be shorter than the rollout


@dataclass(frozen=True)
class Assessment:
    """What a rollout was worth.

    Attributes:
        ret: its return, None when nothing can be said (cut short, lost from view).
        terms: terms of the return.
        flight: fields of `Flight`, as data for JSON; None when there was none to observe.
        success: whether it met the session's success rule.
        why: why nothing can be said, or what is remarkable; may be empty.
    """

    ret: float | None
    terms: Mapping[str, float] = field(default_factory=dict)
    flight: Mapping[str, Any] | None = None
    success: bool = False
    why: str = ""


def assess(
    policy: Policy,
    pan: EndEffectorPath,
    pancake: BodyPath,
    settings: PracticeSettings,
    fault: Fault | None = None,
) -> Assessment:
    """Return and success of a rollout, or why nothing can be said about it.

    Args:
        policy: what was executed.
        pan: path of the pan in the base frame.
        pancake: path of the pancake in the base frame.
        settings: see there.
        fault: the controller's fault if it ended the rollout, else None.
    """
    if fault is not None:
        if fault.kind.of_policy:
            return Assessment(0.0, why=f"{fault.text}: counts as return 0")
        return Assessment(None, why=fault.text)
    duration = policy.basis.duration + settings.settle_time
    if len(pan.t) == 0 or pan.t[-1] < duration - _CUT_SHORT:
        end = pan.t[-1] if len(pan.t) else 0.0
        return Assessment(None, why=f"cut short at {end:.2f} s of {duration:.2f} s")
    if len(pancake.t) == 0:
        return Assessment(None, why="the pancake was never seen")
    flight = observe_flight(pan, pancake, settings.delta_h)
    summary = plain(dataclasses.asdict(flight))
    lost = _lost_from_view(pan, pancake, flight)
    if lost:
        return Assessment(None, flight=summary, why=lost)
    if settings.ret == "eq5":
        result = pancake_return(flight, settings.pancake_weights)
    else:
        result = landing_return(flight, settings.landing_weights)
    success = result.total >= settings.success_return and (
        settings.success_angle == 0.0
        or bool(flight.resting and flight.flipped and abs(flight.angle) >= settings.success_angle)
    )
    return Assessment(result.total, result.terms, summary, success)


def _lost_from_view(pan: EndEffectorPath, pancake: BodyPath, flight: Flight) -> str:
    """Why the pancake was not seen well enough to judge the rollout, empty when it was."""
    end = float(pan.t[-1])
    seen = np.clip(np.concatenate([[0.0], pancake.t]), 0.0, end)
    needed = min(flight.t_f, end) if flight.tossed else end
    gaps = np.diff(seen)
    late = np.flatnonzero((gaps > _LONGEST_GAP) & (seen[:-1] < needed))
    if len(late):
        at = seen[late[0]]
        return f"the pancake was lost from view for {gaps[late[0]]:.2f} s from {at:.2f} s on"
    if flight.tossed and not flight.seen:
        return "the pancake was not seen coming down"
    if end - seen[-1] > _LONGEST_GAP:
        height = pancake.position[-1, 2] - np.interp(seen[-1], pan.t, pan.position[:, 2])
        if height > -_FALLEN:
            return f"the pancake was lost from view at {seen[-1]:.2f} s, not having fallen"
    return ""


def choose_demonstration(
    reproductions: Sequence[Record], settings: PracticeSettings
) -> tuple[int, str]:
    """Which of the reproduced demonstrations to learn from.

    The authors chose one good demonstration of a small series; good is here how it reproduces.

    * "return": the highest return, a person's ratings included.
    * "flick": of those that tossed the pancake, the one nearest to a toss that is good to learn
      from: turned by at least 85 degrees (over 100 there is less left to learn but more speed is
      used up), at least .35 m high, and coming down .10 to .18 m outward of the pan. One that falls
      short makes the pan chase back under it. Missing a range by 15 degrees, .1 m of height or
      .05 m of landing costs one each, half as much for turning too far. If none tossed: the
      highest return.

    Args:
        reproductions: one record for each candidate; those without a return or with a fault are
            not eligible.
        settings: `choice` names the rule.

    Returns:
        Index into `reproductions`, the first of equals, and the reason in words.

    Raises:
        ValueError: none is eligible.
    """
    eligible = [
        index
        for index, record in enumerate(reproductions)
        if record.ret is not None and not record.fault
    ]
    if not eligible:
        reasons = "; ".join(f"{record.demonstration}: {record.why}" for record in reproductions)
        raise ValueError(f"no demonstration could be reproduced ({reasons})")
    of = f"of {len(reproductions)}"
    tossed = [index for index in eligible if (reproductions[index].flight or {}).get("tossed")]
    if settings.choice == "return" or not tossed:
        best = max(eligible, key=lambda index: float(reproductions[index].worth or 0.0))
        rule = "highest return" if settings.choice == "return" else "none tossed; highest return"
        return best, f"{rule} {of} reproductions, {reproductions[best].worth:.3f}"
    best = min(tossed, key=lambda index: _distance_from_flick(reproductions[index].flight or {}))
    flight = reproductions[best].flight or {}
    return best, (
        f"its reproduction is the nearest to a good toss {of}: "
        f"{math.degrees(abs(flight['angle'])):.0f} deg, {flight['apex']:.2f} m high, "
        f"{flight['landing_error'][0]:+.2f} m outward of the pan; "
        f"cost {_distance_from_flick(flight):.1f}"
    )


def _distance_from_flick(flight: Mapping[str, Any]) -> float:
    angle, apex = math.degrees(abs(flight["angle"])), flight["apex"]
    outward, sideways, _ = flight["landing_error"]
    return (
        max(85.0 - angle, 0.0) / 15.0
        + max(angle - 100.0, 0.0) / 30.0
        + max(0.35 - apex, 0.0) / 0.1
        + max(0.10 - outward, outward - 0.18, 0.0) / 0.05
        + abs(sideways) / 0.05
    )
