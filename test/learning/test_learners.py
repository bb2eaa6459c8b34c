# SPDX-License-Identifier: Apache-2.0
"""What every learner behind ask and tell does, and what each is known by."""

import json

import numpy as np
import pytest

from wam_power_ros.learning.learners import (
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
from wam_power_ros.learning.power import Learner, Power, PowerSettings
from wam_power_ros.learning.screened_power import Model, Screened

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
    Screened(candidates=20),
]
ALL = [*CLIMBERS, RandomSearch()]


def rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def name(settings: Settings) -> str:
    return f"{settings.kind}-{getattr(settings, 'weights', '')}".rstrip("-")


def hill(z: np.ndarray) -> float:
    return float(np.exp(-0.3 * ((z - TOP) ** 2).sum()))


class Crude:
    """A model that knows roughly where the top is, and remembers how often it was told."""

    def __init__(self) -> None:
        self.told = 0

    def predict(self, z: np.ndarray) -> np.ndarray:
        """Any scale will do."""
        return -((z - 0.5) ** 2).sum(axis=1) / (1 + self.told)

    def learn(self, z: np.ndarray, ret: float) -> None:
        """Count."""
        self.told += 1


def model_of(settings: Settings) -> Model | None:
    return Crude() if isinstance(settings, Screened) else None


def search(settings: Settings, seed: int, size: int = SIZE) -> Search:
    return Search(size, settings, rng(seed), model_of(settings))


def climb(learner: Learner, rollouts: int) -> Learner:
    for _ in range(rollouts):
        z = learner.ask()
        learner.tell(z, hill(z))
    return learner


@pytest.mark.parametrize("settings", CLIMBERS, ids=name)
@pytest.mark.parametrize("seed", range(5))
def test_every_learner_climbs_a_hill(settings: Settings, seed: int) -> None:
    learner = climb(search(settings, seed), 300)
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
    learner = climb(search(settings, 1), count)
    resumed = restore(json.loads(json.dumps(learner.state())), model_of(settings))
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
    first, second = (climb(search(settings, 4), 30) for _ in range(2))
    np.testing.assert_array_equal(first.mean, second.mean)
    before = first.state()["generator"]
    first.tell(np.ones(SIZE), 0.5)
    assert first.state()["generator"] == before
    other = climb(search(settings, 5), 30)
    assert not np.array_equal(second.mean, other.mean)


@pytest.mark.parametrize("settings", ALL, ids=name)
def test_what_cannot_be_learnt_from_is_refused_and_changes_nothing(settings: Settings) -> None:
    learner = climb(search(settings, 0), 5)
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
    learner = search(settings, 0)
    for _ in range(40):
        learner.tell(learner.ask(), 0.0)
    assert np.isfinite(learner.mean).all() and np.isfinite(learner.ask()).all()


@pytest.mark.parametrize("settings", ALL, ids=name)
def test_the_scale_of_returns_does_not_matter(settings: Settings) -> None:
    learners = [search(settings, 3) for _ in range(2)]
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


def test_a_model_where_none_is_used_or_none_where_one_is_needed_is_refused() -> None:
    with pytest.raises(ValueError, match="'screened' needs one"):
        Search(SIZE, Screened(), rng(0))
    with pytest.raises(ValueError, match="'screened' needs one"):
        Search(SIZE, Pi2(), rng(0), Crude())


def test_screening_tries_the_candidate_that_promises_most() -> None:
    settings = Screened(candidates=50)
    learner, model = Search(SIZE, settings, rng(7), Crude()), Crude()
    candidates = rng(7).standard_normal((50, SIZE))  # about the mean, which is 0 yet
    promised = candidates[np.argmax(model.predict(candidates))]
    np.testing.assert_array_equal(learner.ask(), promised)


def test_the_more_was_tried_the_fewer_candidates_a_model_is_asked_about() -> None:
    asked: list[int] = []

    class Counting(Crude):
        def predict(self, z: np.ndarray) -> np.ndarray:
            asked.append(len(z))
            return super().predict(z)

    climb(Search(SIZE, Screened(candidates=16, half_life=2), rng(1), Counting()), 12)
    assert asked == [16, 11, 8, 6, 4, 3, 2]  # then one, which is tried without asking


def test_one_candidate_is_power_itself() -> None:
    screened = climb(search(Screened(candidates=1, sigma=3, decay=0.97), 5), 40)
    power = climb(Power(SIZE, PowerSettings(sigma=3, decay=0.97), rng(5)), 40)
    np.testing.assert_allclose(screened.mean, power.mean, rtol=1e-12)


def test_a_good_model_helps_and_a_wrong_one_cannot_pass_for_success() -> None:
    class Wrong(Crude):
        def predict(self, z: np.ndarray) -> np.ndarray:
            return -super().predict(z)

    right, wrong = (
        climb(Search(SIZE, Screened(candidates=50), rng(1), model), 30)
        for model in (Crude(), Wrong())
    )
    assert hill(right.mean) > 0.8
    tried = [hill(np.array(z)) for z in wrong.state()["z"]]
    assert tried == wrong.state()["returns"]
