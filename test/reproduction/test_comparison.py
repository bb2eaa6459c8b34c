# SPDX-License-Identifier: Apache-2.0
"""Learners side by side: small runs of every one, and the chapter of the comparison."""

import json

import numpy as np
import pytest

from reproduction.chapters.comparison import LEARNERS, STUDY, TASKS
from reproduction.studies import comparison
from reproduction.studies.comparison import (
    BASELINES,
    EFFORT,
    GRID,
    HELD_OUT,
    REFINED,
    TUNED,
    UNCLAIMED_SEEDS,
)
from reproduction.studies.comparison_runs import learner_of, reaching_runs


@pytest.mark.parametrize("name", LEARNERS)
def test_every_learner_runs_on_the_reach_and_the_same_twice(name: str) -> None:
    arguments = {**TUNED["reaching"][name]._asdict(), "seeds": [1_000_000], "rollouts": 3}
    once, again = reaching_runs(**arguments), reaching_runs(**arguments)
    assert json.loads(json.dumps(once)) == again
    assert np.shape(once["returns"]) == (1, 3)


@pytest.mark.parametrize("name", LEARNERS)
def test_each_name_stands_for_its_learner(name: str) -> None:
    class Silent:
        def predict(self, z: np.ndarray) -> np.ndarray:
            return np.zeros(len(z))

        def learn(self, z: np.ndarray, ret: float) -> None: ...

    for settings in GRID[name]:
        learner = learner_of(settings, 4, 0, Silent())
        assert type(learner).__name__.lower().startswith(name)


@pytest.mark.parametrize("task", TASKS)
def test_no_learner_is_tuned_on_a_seed_it_is_judged_on(task: str) -> None:
    tuning = {*EFFORT[task].few, *EFFORT[task].many}
    assert not tuning & set(HELD_OUT[task])
    assert set(TUNED[task]) == set(GRID) == set(LEARNERS)


def test_every_learner_with_a_claim_runs_on_every_held_out_seed() -> None:
    seeds: dict[str, set[int]] = {}
    for job in comparison.jobs("full"):
        if job.study == "comparison-pancake":
            seeds.setdefault(job.key.split("-")[0], set()).add(job.arguments["seed"])
    claimed = {*BASELINES, *REFINED}
    for name in LEARNERS:
        assert seeds[name] <= set(HELD_OUT["pancake"])
        assert len(seeds[name]) == (
            len(HELD_OUT["pancake"]) if name in claimed else UNCLAIMED_SEEDS
        )


@pytest.mark.parametrize("task", TASKS)
def test_every_tuned_choice_is_in_the_grid(task: str) -> None:
    for name, choice in TUNED[task].items():
        assert choice.settings in GRID[name]
        assert (choice.stiffness, choice.attractor) in comparison.NOISE[task]


def made_up(better: float) -> dict:
    """Results in which ours is better than the others by so much."""
    rng = np.random.default_rng(0)
    results: dict = {f"comparison-{task}": {} for task in TASKS}
    for name in LEARNERS:
        lift = better if name == "screened" else 0.0
        final = 0.7 + lift + 0.02 * rng.standard_normal(12)
        returns = np.tile(np.linspace(0.2, 0.7 + lift, 5), (12, 1))
        results["comparison-reaching"][f"{name}-401-412"] = {
            "seeds": list(range(12)),
            "final": final.tolist(),
            "returns": returns.tolist(),
            "means": returns.tolist(),
        }
        for k in range(12):
            results["comparison-pancake"][f"{name}-{k}"] = {
                "returns": returns[k].tolist(),
                "repeats": [float(final[k])] * 3,
                "faults": 0,
            }
    return results


@pytest.mark.parametrize(("better", "met"), [(0.1, True), (0.0, False), (-0.1, False)])
def test_the_claim_is_met_only_if_ours_is_ahead(better: float, met: bool) -> None:
    chapter = STUDY.chapter(made_up(better))
    ours = [claim for claim in chapter.claims if claim.what.startswith("screened")]
    refined = [claim for claim in chapter.claims if claim not in ours]
    assert [claim.met for claim in ours] == [met] * 4
    assert [claim.met for claim in refined] == [False] * 4
    assert len(chapter.figures) == 2


def test_a_learner_is_judged_by_its_rollouts_apart_from_its_answer() -> None:
    results = made_up(0.0)
    for key, run in results["comparison-pancake"].items():
        if key.startswith("screened"):
            run["returns"] = [ret + 0.1 for ret in run["returns"]]
    claims = STUDY.chapter(results).claims
    met = [claim.what for claim in claims if claim.met]
    assert len(met) == 1 and "Pancake" in met[0] and "while it learns" in met[0]
