# SPDX-License-Identifier: Apache-2.0
"""Planned tosses, against tosses of the simulated arm."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from toss_task import demonstrated_policy

from hardware_sim.scenes import scene_type
from hardware_sim.world import World
from reproduction.rivals.toss_model import Tosses, TossModel, plan_tosses, planned_terms
from reproduction.studies.flip_sessions import teach
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.assessment import assess
from wam_power_ros.tasks.flip.parametrization import FlipNoise, flip_parametrization
from wam_power_ros.tasks.flip.returns import pancake_return

NOISE = FlipNoise(stiffness=0.1, attractor=0.01, rotation=0.05, flick=0.03, catch_shift=0.02)


def some(count: int, size: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, size))


def test_a_pan_that_rests_tosses_nothing() -> None:
    policy = demonstrated_policy()
    p = flip_parametrization(policy, "attractors", NOISE)
    z = np.zeros(p.size)
    still = np.tile(policy.attractors[0], policy.basis.count)
    z = z + (still - p.theta0) / p.scale
    tosses = plan_tosses(p, z[np.newaxis], policy.attractors[0])
    assert not tosses.tossed[0]
    assert tosses.angle[0] == 0.0 and not tosses.landing_error.any()
    assert tosses.apex[0] == pytest.approx(0.0, abs=0.02)


def test_a_pan_moved_towards_the_landing_reduces_the_miss_and_beyond_it_reverses_it() -> None:
    upwards = np.outer([0.0, 0.0, 0.0, 1.2, 1.2, -0.5, 0.0, 0.0], [0.0, 0.0, 1.0])
    start = np.array([0.6, 0.0, 0.5])
    policy = replace(
        demonstrated_policy(),
        stiffness=np.tile(400.0 * np.eye(3), (8, 1, 1)),
        attractors=start + upwards,
        rotation_attractors=np.zeros((8, 3)),
    )
    p = flip_parametrization(policy, "planar", NOISE)
    shifts = np.array([-0.1, 0.0, 0.05, 0.1])  # shift of the pan along x at the catch [m]
    z = np.zeros((len(shifts), p.size))
    z[:, p.groups["catch_shift"]] = shifts[:, np.newaxis] / p.scale[p.groups["catch_shift"]]
    tosses = plan_tosses(p, z, start)
    assert tosses.tossed.all()
    # Pancake minus pan, as `observe_flight` measures it and `landing_correction` needs it.
    np.testing.assert_allclose(tosses.landing_error[:, 0], -shifts, atol=1e-3)
    np.testing.assert_allclose(tosses.landing_error[:, 1], 0.0, atol=1e-9)


def test_a_faster_toss_is_planned_as_that_of_the_faster_policy() -> None:
    p = flip_parametrization(demonstrated_policy(), "planar", NOISE)
    start, z = np.array([0.6, 0.0, 0.5]), np.zeros((2, p.size))
    z[1, p.groups["tempo"]] = 0.2 / NOISE.tempo
    faster = flip_parametrization(p.policy(z[1], "faster")[0], "planar", NOISE)
    planned = plan_tosses(p, z, start)
    alone = plan_tosses(faster, z[:1], start)
    assert planned.apex[1] > planned.apex[0] + 0.02
    assert planned.apex[1] == pytest.approx(alone.apex[0], abs=0.003)  # sampled at other times
    assert planned.tossed[1] == alone.tossed[0]
    assert planned.angle[1] == pytest.approx(alone.angle[0], abs=0.05)


def test_policies_are_planned_as_if_alone() -> None:
    p = flip_parametrization(demonstrated_policy(), "planar", NOISE)
    start, z = np.array([0.6, 0.0, 0.5]), some(6, p.size)
    many = plan_tosses(p, z, start)
    for k in range(len(z)):
        one = plan_tosses(p, z[k : k + 1], start)
        assert one.tossed[0] == many.tossed[k]
        np.testing.assert_allclose(one.angle[0], many.angle[k], rtol=1e-9)
        np.testing.assert_allclose(one.landing_error[0], many.landing_error[k], atol=1e-9)


def test_what_rises_more_than_delta_h_is_tossed_and_every_number_is_finite() -> None:
    p = flip_parametrization(demonstrated_policy(), "full", NOISE)
    tosses = plan_tosses(p, 5.0 * some(200, p.size), np.array([0.6, 0.0, 0.5]))
    assert (tosses.angle[~tosses.tossed] == 0.0).all() and (tosses.angle >= 0.0).all()
    for values in vars(tosses).values():
        assert np.isfinite(values).all()
    terms = planned_terms(tosses)
    assert (terms >= 0.0).all() and (terms[:, :2] <= 0.5).all()


def test_a_planned_toss_is_worth_what_one_seen_like_it_is() -> None:
    angle, apex = np.array([2.0, 4.0, 7.0]), np.array([0.3, 0.9, 0.4])
    miss = np.array([[0.03, 0.04], [-0.1, 0.0], [0.0, 0.2]])
    terms = planned_terms(Tosses(angle > 0.0, angle, apex, miss))
    for k, turned in enumerate(angle):
        seen = SimpleNamespace(
            tossed=True,
            seen=True,
            normal_start=np.array([0.0, 0.0, 1.0]),
            normal=np.array([np.sin(turned), 0.0, np.cos(turned)]),
            position=np.append(miss[k], 0.0),
            pan_position=np.zeros(3),
            apex=apex[k],
        )
        np.testing.assert_allclose(terms[k], list(pancake_return(seen).terms.values()), rtol=1e-12)


def test_a_model_learns_what_the_plan_misses() -> None:
    p = flip_parametrization(demonstrated_policy(), "full", NOISE)
    start, z = np.array([0.6, 0.0, 0.5]), some(40, p.size)
    terms = planned_terms(plan_tosses(p, z, start))
    returns = terms @ np.array([0.6, 1.2, 0.9]) + 0.05
    model = TossModel(p, start)
    before = np.abs(model.predict(z) - returns).mean()
    for one, ret in zip(z, returns, strict=True):
        model.learn(one, float(ret))
    assert np.abs(model.predict(z) - returns).mean() < 0.2 * before


def test_the_plan_tells_good_tosses_from_bad_ones() -> None:
    """Before any rollout, which is what screening needs."""
    bench = Environment(World(scene_type("flip"), seed=21))
    settings = preset("flip", "paper").task_settings
    (policy,) = teach(bench, 21, 1)
    p = flip_parametrization(policy, "full", NOISE)
    start, _ = bench.arm.tool_pose(policy.q_start)
    z = some(12, p.size)
    planned = TossModel(p, start).predict(z)
    returns = []
    for k in range(len(z)):
        tried, _ = p.policy(z[k], f"trial-{k}")
        rollout, _ = bench.run(tried)
        returns.append(assess(tried, rollout, settings).ret)
    assert np.corrcoef(planned, returns)[0, 1] > 0.5
