# SPDX-License-Identifier: Apache-2.0
"""Peak values of the arm in the log of a rollout."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import CALM, begin, run

from hardware_sim.ground_truth import LOG_TIME
from hardware_sim.scenes.flip import Flip
from hardware_sim.wam import PERIOD
from hardware_sim.world import World


@pytest.fixture(scope="module")
def calm() -> World:
    return World(Flip, CALM, seed=3)


def test_a_torque_beyond_the_envelope_is_clipped_and_counted(calm: World) -> None:
    gravity = begin(calm)
    run(calm, gravity, 10)
    assert calm.truth()["saturated"] == 0.0
    run(calm, gravity + 60.0 * np.eye(7)[3], 20)
    truth = calm.truth()
    assert truth["peak_tau"][3] == pytest.approx(28.8)
    assert truth["saturated"] > 0.5
    assert not truth["beyond_no_load"]
    calm.data.qvel[3] = 8.0
    calm.step(gravity)
    assert calm.truth()["beyond_no_load"]


def test_peaks_are_those_since_the_release_and_of_its_first_10_s(calm: World) -> None:
    torque = begin(calm)
    calm.data.qvel[3] = 1.0
    run(calm, torque, 5)
    first = calm.truth()
    assert first["peak_qd"][3] == pytest.approx(1.0, abs=0.3)
    assert first["peak_pan_speed"] > 0.2
    run(calm, None, round(LOG_TIME / PERIOD))
    calm.data.qvel[3] = 2.0
    run(calm, None, 5)
    assert calm.truth()["peak_qd"][3] == first["peak_qd"][3]  # the log is full
    begin(calm)
    assert calm.truth()["peak_qd"] == [0.0] * 7
