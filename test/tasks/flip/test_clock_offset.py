# SPDX-License-Identifier: Apache-2.0
"""Offset of the cameras' stamps, from simulated tosses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from simulated_toss import capture, toss

from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.tasks.flip.clock_offset import clock_offset, shifted
from wam_power_ros.tasks.flip.flight import observe_flight


@settings(max_examples=16, deadline=None, derandomize=True)
@given(
    rate=some.sampled_from([30.0, 60.0, 120.0, 240.0]),
    late=some.floats(-0.05, 0.05),
    seed=some.integers(0, 1000),
)
def test_stamps_up_to_50_ms_early_or_late_are_found_to_3_ms_and_change_no_flight(
    rate: float, late: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    truth = toss(rng, half_turns=1.0)
    path = capture(truth, rng, rate)
    given, before = shifted(path, None, -late)
    found = clock_offset(truth.pan, given, before)
    assert found == pytest.approx(late, abs=0.003)
    flight, doubt = observe_flight(truth.pan, *shifted(given, before, found))
    expected, _ = observe_flight(truth.pan, path)
    assert not doubt
    assert flight.angle == pytest.approx(expected.angle, abs=0.1)
    assert flight.t_f == pytest.approx(expected.t_f, abs=0.006)


def test_few_frames_before_a_quick_start_are_no_evidence_of_another_offset() -> None:
    rng = np.random.default_rng(3)
    truth = toss(rng, half_turns=1.0)
    path = capture(truth, rng)
    few = path.part(path.t > truth.release - 0.2)
    assert clock_offset(truth.pan, few, None) == 0.0


def test_a_pan_at_rest_shows_no_offset() -> None:
    rng = np.random.default_rng(1)
    truth = toss(rng)
    count = (len(truth.pan.t), 1)
    position, quat = truth.pan.position[0], truth.pan.quat_xyzw[0]
    still = EndEffectorPath("t", truth.pan.t, np.tile(position, count), np.tile(quat, count))
    assert clock_offset(still, capture(truth, rng), None) == 0.0
