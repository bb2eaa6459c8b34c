# SPDX-License-Identifier: Apache-2.0
"""Assessment of a rollout of the flip: return, success, and rollouts that cannot be judged."""

from __future__ import annotations

import math

import numpy as np
import pytest
from toss_task import at_rest, demonstrated_policy

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.assessment import assess, flight_of

POLICY = demonstrated_policy("trial-0001")
SETTINGS = preset("flip").task_settings


def toss(half_turns: float, aside: float = 0.0) -> tuple[EndEffectorPath, BodyPath]:
    """A pancake thrown at 0.5 s that comes down 0.6 s later, flat, `aside` of the pan [m]."""
    t = np.arange(0.005, 1.85, 1 / 120)
    pan, still = at_rest(POLICY.id, 1.86, t)
    free = np.clip(t - 0.5, 0.0, 0.6)
    rise = 2.943 * free - 4.905 * free**2
    half = 0.5 * np.pi * half_turns * free / 0.6
    position = still.position + np.stack([aside * free / 0.6, 0.0 * t, rise], axis=1)
    quat_xyzw = np.stack([0.0 * half, np.sin(half), 0.0 * half, np.cos(half)], axis=1)
    return pan, BodyPath(POLICY.id, t, position, quat_xyzw)


@pytest.mark.parametrize(
    ("half_turns", "aside", "least_turn", "most_turn", "success"),
    [
        (1.0, 0.0, 150.0, 240.0, True),
        (1.0, 0.0, 100.0, 140.0, False),  # more rotation than allowed
        (2.0, 0.0, 150.0, 400.0, False),  # rests in the pan with the same side up
        (1.0, 0.2, 150.0, 240.0, False),  # the other side up, but beside the pan
        (1.0, 0.0, 190.0, 240.0, False),  # less rotation than required
        (2.0, 0.0, 0.0, 240.0, True),  # the side does not matter if no rotation is required
    ],
)
def test_a_success_rests_in_the_pan_the_other_side_up_having_turned_far_enough_and_no_further(
    half_turns: float, aside: float, least_turn: float, most_turn: float, success: bool
) -> None:
    update = {"success_angle": math.radians(least_turn), "success_return": 0.01}
    update["success_angle_max"] = math.radians(most_turn)
    assessment = assess(
        POLICY, Rollout(*toss(half_turns, aside)), SETTINGS.model_copy(update=update)
    )
    assert assessment.observation["tossed"] and assessment.observation["seen"]
    assert assessment.success is success
    # With a required return above its own, no rollout is a success.
    for least, met in ((assessment.ret, success), (assessment.ret + 1e-6, False)):
        asked = SETTINGS.model_copy(update={**update, "success_return": least})
        assert assess(POLICY, Rollout(*toss(half_turns, aside)), asked).success is met


@pytest.mark.requirement("S-47")
def test_a_rollout_that_cannot_be_judged_says_why() -> None:
    frames = np.arange(0.01, 1.85, 1 / 30)

    def why(end: float = 1.86, seen: np.ndarray = frames, fault: Fault | None = None) -> str:
        assessment = assess(POLICY, Rollout(*at_rest(POLICY.id, end, seen), fault), SETTINGS)
        assert assessment.ret is None
        return assessment.why

    assert why(end=1.2) == "cut short at 1.19 s of 1.85 s"
    assert why(seen=np.zeros(0)) == "the pancake was never seen"
    gap = frames[(frames < 0.5) | (frames > 0.9)]
    assert why(seen=gap).startswith("the pancake was lost from view for 0.43 s from 0.48 s")
    assert why(seen=frames[frames < 1.0]) == (
        "the pancake was lost from view at 0.98 s and had not fallen until then"
    )
    assert why(fault=Fault(FaultKind.STATES_LOST, "no state for 12 ms")) == "no state for 12 ms"


@pytest.mark.parametrize(("depth", "judged"), [(0.04, False), (0.06, True)])
def test_a_pancake_last_seen_under_the_pan_was_dropped_and_not_lost(
    depth: float, judged: bool
) -> None:
    pan, pancake = at_rest(POLICY.id, 1.86, np.arange(0.01, 1.3, 1 / 30))
    position = pancake.position.copy()
    position[-1, 2] -= 0.003 + depth
    dropped = BodyPath(POLICY.id, pancake.t, position, pancake.quat_xyzw)
    assert (assess(POLICY, Rollout(pan, dropped), SETTINGS).ret is not None) == judged


def test_the_flight_comes_back_out_of_an_observation() -> None:
    rollout = Rollout(*at_rest(POLICY.id, 1.86, np.arange(0.01, 1.85, 1 / 30)))
    observation = dict(assess(POLICY, rollout, SETTINGS).observation)
    flight = flight_of(observation)
    assert flight is not None and not flight.tossed
    np.testing.assert_array_equal(flight.position, observation["position"])
    assert flight_of({"angle": 1.0}) is None
