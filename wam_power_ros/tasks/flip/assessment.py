# SPDX-License-Identifier: Apache-2.0
"""Assessment of a flip: observed flight, return and success of a rollout."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.tasks.flip import placement
from wam_power_ros.tasks.flip.clock_offset import CORRECTED_MAX, clock_offset, shifted, stamps_off
from wam_power_ros.tasks.flip.flight import Flight, observe_flight
from wam_power_ros.tasks.flip.returns import landing_return, pancake_return
from wam_power_ros.tasks.flip.settings import FlipSettings
from wam_power_ros.tasks.task import Assessment, cut_short, fault_assessment

_GAP_MAX = 0.2  # longest gap in the frames, six at 30 Hz, before the pancake counts as lost [s]
_FALLEN_DEPTH = 0.05  # depth below the pan's floor at which a pancake was dropped, not lost [m]


def assess(policy: Policy, rollout: Rollout, settings: FlipSettings) -> Assessment:
    """Return and success of a rollout of `policy`, or the reason why it cannot be judged."""
    if rollout.fault is not None:
        return fault_assessment(rollout.fault)
    if why := cut_short(policy, rollout, settings.settle_time):
        return Assessment(None, why=why)
    pan, pancake = rollout.tool, rollout.body
    if pancake is None or len(pancake.t) == 0:
        return Assessment(None, why="the pancake was never seen")
    if why := placement.doubt(pan, pancake, rollout.before):
        return Assessment(None, why=why)
    late = clock_offset(pan, pancake, rollout.before)
    if abs(late) > CORRECTED_MAX:
        return Assessment(None, observation={"stamps_late": late}, why=stamps_off(late))
    pancake, before = shifted(pancake, rollout.before, late)
    if why := placement.turned(pan, pancake, before):
        return Assessment(None, why=why)
    pancake, before, off = placement.on_floor(pan, pancake, before)
    flight, doubt = observe_flight(pan, pancake, before)
    observation = dataclasses.asdict(flight)
    if off:
        observation["height_off"] = off
    if late:
        observation["stamps_late"] = late
    if doubt:
        doubt = placement.turned(pan, pancake, before, placement.AXIS_OFF_IN_DOUBT) or doubt
    if why := _lost_from_view(pan, pancake, flight) or doubt:
        return Assessment(None, observation=observation, why=why)
    terms = (pancake_return if settings.ret == "eq5" else landing_return)(flight)
    success = (ret := math.fsum(terms.values())) >= settings.success_return and (
        settings.success_angle == 0.0
        or bool(
            flight.resting
            and flight.flipped
            and settings.success_angle <= abs(flight.angle) <= settings.success_angle_max
        )
    )
    return Assessment(ret, terms, observation, success)


def flight_of(observation: Mapping[str, Any]) -> Flight | None:
    """Flight from an observation of `assess`; None if it lacks fields of `Flight`."""
    names = {field.name for field in dataclasses.fields(Flight)}
    if not names <= observation.keys():
        return None
    known: dict[str, Any] = {name: observation[name] for name in names}
    known |= {name: np.array(v) for name, v in known.items() if isinstance(v, list)}
    return Flight(**known)


def _lost_from_view(pan: EndEffectorPath, pancake: BodyPath, flight: Flight) -> str:
    """Return why the pancake was not seen well enough to judge the rollout; empty if it was."""
    end = float(pan.t[-1])
    seen = np.clip(np.concatenate([[0.0], pancake.t]), 0.0, end)
    needed = min(flight.t_f, end) if flight.tossed else end
    gaps = np.diff(seen)
    too_long = np.flatnonzero((gaps > _GAP_MAX) & (seen[:-1] < needed))
    if len(too_long):
        first = too_long[0]
        return f"the pancake was lost from view for {gaps[first]:.2f} s from {seen[first]:.2f} s on"
    if flight.tossed and not flight.seen:
        return "the descent of the pancake was not seen"
    if end - seen[-1] > _GAP_MAX:
        height = pancake.position[-1, 2] - np.interp(seen[-1], pan.t, pan.position[:, 2])
        if height > -_FALLEN_DEPTH:
            return (
                f"the pancake was lost from view at {seen[-1]:.2f} s and had not fallen until then"
            )
    return ""
