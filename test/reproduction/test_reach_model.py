# SPDX-License-Identifier: Apache-2.0
"""The model of reaching learns where rollouts were stopped."""

import numpy as np

from reproduction.rivals.reach_model import ReachModel
from reproduction.studies.reaching_runs import NOISE, synthetic
from wam_power_ros.learning.parametrization import parametrization_of

SCENARIO = synthetic()
FULL = parametrization_of(SCENARIO.policy, "full", NOISE["full"])


def test_a_model_predicts_a_free_path_exactly_and_a_stopped_one_better_each_time() -> None:
    model = ReachModel(FULL, SCENARIO)
    z = np.random.default_rng(3).standard_normal((300, FULL.size)) * 6.0
    stiffness, attractors, _ = FULL.arrays(z)
    returns, collided = SCENARIO.evaluate(stiffness, attractors)
    assert 20 < collided.sum() < 280
    np.testing.assert_allclose(model.predict(z[~collided]), returns[~collided], rtol=1e-9)
    before = np.abs(model.predict(z) - returns)[200:].mean()
    for one, ret in zip(z[:200], returns[:200], strict=True):
        model.learn(one, float(ret))
    assert np.abs(model.predict(z) - returns)[200:].mean() < 0.7 * before
