# SPDX-License-Identifier: Apache-2.0
"""Offset of the cameras' stamps, from simulated tosses."""

import numpy as np
import pytest
from simulated_toss import capture, toss

from wam_power_ros.tasks.flip.clock_offset import clock_offset, shifted


@pytest.mark.parametrize("rate", [30.0, 60.0, 120.0, 240.0])
def test_stamps_from_50_ms_early_to_50_ms_late_are_found_to_2_ms_and_corrected(rate: float) -> None:
    for seed, late in enumerate(np.linspace(-0.05, 0.05, 9)):
        rng = np.random.default_rng(seed)
        truth = toss(rng, half_turns=1.0)
        path = capture(truth, rng, rate)
        given, before = shifted(path, None, -late)
        found = clock_offset(truth.pan, given, before)
        assert found == pytest.approx(late, abs=0.002), late
        again, _ = shifted(given, before, found)
        assert again.t[-1] == pytest.approx(path.t[-1], abs=0.002)


def test_a_pan_at_rest_shows_no_offset() -> None:
    rng = np.random.default_rng(1)
    truth = toss(rng)
    still = type(truth.pan)(
        "t",
        truth.pan.t,
        np.tile(truth.pan.position[0], (len(truth.pan.t), 1)),
        np.tile(truth.pan.quat_xyzw[0], (len(truth.pan.t), 1)),
    )
    assert clock_offset(still, capture(truth, rng), None) == 0.0
