# SPDX-License-Identifier: Apache-2.0
"""Orientations that cameras report wrongly: a rollout is judged as without them, or not at all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as some
from simulated_toss import capture, toss
from toss_task import demonstrated_policy

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.params import overlay
from wam_power_ros.params.body_tracker_params import BodyTrackerParams
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.assessment import assess
from wam_power_ros.tasks.task import Assessment
from wam_power_ros.tracking.tracker import Tracker

POLICY = demonstrated_policy("trial-0001")
SETTINGS = preset("flip").task_settings
TRACKER = BodyTrackerParams.from_setup(overlay.setup())
START = 10**9
OVER = np.array([1.0, 0.0, 0.0, 0.0])  # half a turn
KINDS = {
    "alternates": lambda quat, on, turn: np.where(on & 1, rotations.multiply(quat, OVER), quat),
    "switches": lambda quat, on, turn: np.where(on > 0, rotations.multiply(quat, OVER), quat),
    "jumps": lambda quat, on, turn: np.where(on > 0, rotations.multiply(quat, turn), quat),
    "freezes": lambda quat, on, turn: np.where(on > 0, quat[np.argmax(on > 0)], quat),
    "other order": lambda quat, on, turn: np.where(on > 0, np.roll(quat, 1, axis=1), quat),
    "conjugate": lambda quat, on, turn: np.where(on > 0, quat * [-1, -1, -1, 1], quat),
    "spikes": lambda quat, on, turn: np.where(on % 7 == 3, rotations.multiply(quat, turn), quat),
    "other sign": lambda quat, on, turn: np.where(on & 1, -quat, quat),
}


def judged(pan: EndEffectorPath, seen: BodyPath, rate: float) -> Assessment:
    tracker = Tracker(TRACKER.model_copy(update={"rate": rate}))
    rest = np.arange(-0.5, seen.t[0] - 0.5 / rate, 1.0 / rate)  # at rest before the start
    rng = np.random.default_rng(0)
    for t in rest:
        place = seen.position[0] + rng.normal(0.0, 0.00025, 3)
        wobble = rotations.quat_of_vector(rng.normal(0.0, 0.0035, 3))
        tracker.add(START + round(t * 1e9), place, rotations.multiply(wobble, seen.quat_xyzw[0]))
    for t, position, quat in zip(seen.t, seen.position, seen.quat_xyzw, strict=True):
        tracker.add(START + round(t * 1e9), position, quat)
    body = tracker.path(POLICY.id, START, START + round(float(pan.t[-1]) * 1e9))
    own = EndEffectorPath(POLICY.id, pan.t, pan.position, pan.quat_xyzw)
    return assess(POLICY, Rollout(own, body), SETTINGS)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=2, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    rate=some.sampled_from([30.0, 60.0, 120.0, 240.0]),
    seed=some.integers(0, 1000),
    begin=some.floats(0.1, 1.2),
    lasts=some.one_of(some.floats(0.03, 0.5), some.just(9.0)),
    axis=some.integers(0, 2),
    angle=some.floats(0.5, 3.1),
)
def test_a_rollout_with_a_wrong_orientation_is_judged_as_without_or_not_at_all(
    kind: str, rate: float, seed: int, begin: float, lasts: float, axis: int, angle: float
) -> None:
    rng = np.random.default_rng(seed)
    truth = toss(rng, half_turns=1.0)
    seen = capture(truth, rng, rate)
    level = rotations.multiply(seen.quat_xyzw, rotations.quat_xyzw(truth.matrix[0].T))
    on = np.where((seen.t > begin) & (seen.t < begin + lasts), np.arange(1, len(seen.t) + 1), 0)
    turn = rotations.quat_of_vector(angle * np.eye(3)[axis])
    quat = KINDS[kind](level, on[:, None], turn)
    without = judged(truth.pan, BodyPath("t", seen.t, seen.position, level), rate)
    found = judged(truth.pan, BodyPath("t", seen.t, seen.position, quat), rate)
    assert without.ret is not None
    if found.ret is not None:
        assert found.ret == pytest.approx(without.ret, abs=0.05)
        assert found.success == without.success
    assert kind != "other sign" or found.ret is not None
