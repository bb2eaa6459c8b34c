# SPDX-License-Identifier: Apache-2.0
"""The baseline that follows the task's corrections and nothing else."""

import numpy as np
from hill_task import SIZE, rng

from wam_power_ros.learning.corrections_only import CorrectionsOnly


def test_the_last_corrected_rollout_is_tried_next_whatever_its_return() -> None:
    learner = CorrectionsOnly(SIZE, CorrectionsOnly.Settings(), rng(0))
    assert not learner.ask().any()  # the reproduction, as it was demonstrated
    for value, ret in ((0.5, 1.0), (1.0, 0.0)):
        learner.tell(np.full(SIZE, value), ret)
        assert learner.ask().tolist() == learner.mean.tolist() == [value] * SIZE


def test_it_draws_nothing() -> None:
    source = rng(0)
    CorrectionsOnly(SIZE, CorrectionsOnly.Settings(), source).ask()
    assert source.random() == rng(0).random()
