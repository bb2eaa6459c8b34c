# SPDX-License-Identifier: Apache-2.0
"""What every learner behind ask and tell does, and what each is known by."""

import json

import numpy as np
import pytest

from wam_power_ros.learners import (
    AdaptivePower,
    Cma,
    Enac,
    Pi2,
    RandomSearch,
    Reinforce,
    Search,
    Settings,
    ShapedPower,
    restore,
)
from wam_power_ros.power import Learner, Power, PowerSettings

SIZE = 6
TOP = np.full(SIZE, 0.8)
CLIMBERS = [
    ShapedPower(),
    ShapedPower(weights="return", mirrored=False),
    AdaptivePower(),
    Pi2(),
    Cma(),
    Reinforce(),
    Enac(),
]
ALL = [*CLIMBERS, RandomSearch()]


def rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def name(settings: Settings) -> str:
    return f"{settings.kind}-{getattr(settings, 'weights', '')}".rstrip("-")


def hill(z: np.ndarray) -> float:
    return float(np.exp(-0.3 * ((z - TOP) ** 2).sum()))


def climb(learner: Learner, rollouts: int) -> Learner:
    for _ in range(rollouts):
        z = learner.ask()
        learner.tell(z, hill(z))
    return learner


@pytest.mark.parametrize("settings", CLIMBERS, ids=name)
@pytest.mark.parametrize("seed", range(5))
def test_every_learner_climbs_a_hill(settings: Settings, seed: int) -> None:
    learner = climb(Search(SIZE, settings, rng(seed)), 300)
    assert hill(np.zeros(SIZE)) < 0.32
    assert hill(learner.mean) > 0.6


def test_random_search_keeps_the_best_it_saw() -> None:
    learner = Search(SIZE, RandomSearch(), rng(0))
    seen = [learner.ask() for _ in range(50)]
    for z in seen:
        learner.tell(z, hill(z))
    np.testing.assert_array_equal(learner.mean, max(seen, key=hill))


@pytest.mark.parametrize("settings", ALL, ids=name)
@pytest.mark.parametrize("count", [0, 7, 33])
def test_a_resumed_learner_goes_on_bit_for_bit(settings: Settings, count: int) -> None:
    learner = climb(Search(SIZE, settings, rng(1)), count)
    resumed = restore(json.loads(json.dumps(learner.state())))
    for _ in range(25):
        z = learner.ask()
        np.testing.assert_array_equal(resumed.ask(), z)
        learner.tell(z, hill(z))
        resumed.tell(z, hill(z))
        np.testing.assert_array_equal(resumed.mean, learner.mean)


def test_power_is_restored_too() -> None:
    learner = climb(Power(SIZE, PowerSettings(), rng(1)), 9)
    np.testing.assert_array_equal(restore(learner.state()).ask(), learner.ask())


@pytest.mark.parametrize("settings", ALL, ids=name)
def test_the_seed_decides_and_telling_draws_nothing(settings: Settings) -> None:
    first, second = (climb(Search(SIZE, settings, rng(4)), 30) for _ in range(2))
    np.testing.assert_array_equal(first.mean, second.mean)
    before = first.state()["generator"]
    first.tell(np.ones(SIZE), 0.5)
    assert first.state()["generator"] == before
    other = climb(Search(SIZE, settings, rng(5)), 30)
    assert not np.array_equal(second.mean, other.mean)


@pytest.mark.parametrize("settings", ALL, ids=name)
def test_what_cannot_be_learnt_from_is_refused_and_changes_nothing(settings: Settings) -> None:
    learner = climb(Search(SIZE, settings, rng(0)), 5)
    before = learner.state()
    for z, ret in [
        (np.zeros(SIZE + 1), 1.0),
        (np.full(SIZE, np.nan), 1.0),
        (np.zeros(SIZE), -0.1),
        (np.zeros(SIZE), np.inf),
    ]:
        with pytest.raises(ValueError, match="must be finite"):
            learner.tell(z, ret)
    assert learner.state() == before


@pytest.mark.parametrize("settings", ALL, ids=name)
def test_returns_that_are_all_zero_are_survived(settings: Settings) -> None:
    learner = Search(SIZE, settings, rng(0))
    for _ in range(40):
        learner.tell(learner.ask(), 0.0)
    assert np.isfinite(learner.mean).all() and np.isfinite(learner.ask()).all()


@pytest.mark.parametrize("settings", ALL, ids=name)
def test_the_scale_of_returns_does_not_matter(settings: Settings) -> None:
    learners = [Search(SIZE, settings, rng(3)) for _ in range(2)]
    for _ in range(30):
        for learner, factor in zip(learners, (1.0, 2.0**-30), strict=True):
            z = learner.ask()
            learner.tell(z, factor * hill(z))
    np.testing.assert_allclose(learners[0].mean, learners[1].mean, rtol=1e-9, atol=1e-12)


def test_a_mirrored_pair_is_symmetric_about_the_mean_it_was_drawn_about() -> None:
    learner = climb(Search(SIZE, ShapedPower(warm_up=4), rng(2)), 20)
    centre = learner.mean
    first = learner.ask()
    learner.tell(first, 1.0)
    np.testing.assert_allclose(learner.ask(), 2.0 * centre - first, atol=1e-12)


def test_the_mean_rests_during_the_warm_up() -> None:
    learner = Search(SIZE, ShapedPower(warm_up=10), rng(0))
    np.testing.assert_array_equal(climb(learner, 9).mean, np.zeros(SIZE))
    assert climb(learner, 1).mean.any()


def test_rank_weights_see_only_the_order_of_returns() -> None:
    first, second = (Search(SIZE, ShapedPower(), rng(0)) for _ in range(2))
    for _ in range(30):
        for learner, power in ((first, 1.0), (second, 3.0)):
            z = learner.ask()
            learner.tell(z, hill(z) ** power)
    np.testing.assert_array_equal(first.mean, second.mean)


def test_the_natural_gradient_of_a_slope_points_up_it() -> None:
    slope = np.array([3.0, -1.0, 0.5])
    learner = Search(3, Enac(population=10), rng(0))
    for _ in range(10):
        z = learner.ask()
        learner.tell(z, 50.0 + float(slope @ z))
    cosine = slope @ learner.mean / np.linalg.norm(slope) / np.linalg.norm(learner.mean)
    assert cosine == pytest.approx(1.0, abs=1e-9)


def test_adapted_noise_stays_within_its_bounds() -> None:
    learner = Search(SIZE, AdaptivePower(sigma=1, variance_sigma=1), rng(0))
    learner.tell(np.zeros(SIZE), 1.0)
    learner.tell(np.zeros(SIZE), 1.0)
    draws = np.stack([learner.ask() for _ in range(2000)])
    np.testing.assert_allclose(draws.var(axis=0), 0.1, rtol=0.2)


def test_an_unknown_state_is_refused() -> None:
    with pytest.raises(ValueError, match="kind"):
        restore({"learner": "x", "settings": {"kind": "x"}})
    with pytest.raises(ValueError, match="at least 2"):
        Search(1, Cma(), rng(0))
