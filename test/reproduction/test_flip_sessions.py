# SPDX-License-Identifier: Apache-2.0
"""Pancake sessions of the reproduction, and their chapter."""

from typing import Any

import numpy as np
import pytest

from hardware_sim.scenes.flip import HOME
from reproduction.chapter import Chapter, Claim
from reproduction.chapters.flip import STUDY, Sessions
from reproduction.studies import flip_sessions


def test_a_pan_believed_heavier_is_heavier_only_in_the_controllers_model() -> None:
    true, wrong = flip_sessions.stand_in(21), flip_sessions.stand_in(21, believed_pan=1.2)
    carried = np.abs(wrong.arm.gravity(HOME)) - np.abs(true.arm.gravity(HOME))
    assert carried[1] > 0.3  # 0.12 kg at more than half a metre
    np.testing.assert_array_equal(wrong.world.model.body_mass, true.world.model.body_mass)
    assert wrong.world.urdf == true.world.urdf


def test_the_papers_rule_fires_at_the_third_good_return_in_a_row() -> None:
    assert flip_sessions._fires([0.95, 0.91, 0.89, 0.9, None, 0.9, 0.9, 0.9, 1.0]) == 8
    assert flip_sessions._fires([0.95, 0.91, 0.89]) is None


@pytest.mark.parametrize("scale", ["quick", "full"])
def test_ablated_sessions_have_full_ones_alike_and_only_the_full_study_held_out_seeds(
    scale: str,
) -> None:
    jobs = flip_sessions.jobs(scale)
    seeds, held_out = {job.arguments["seed"] for job in jobs}, set(flip_sessions.HELD_OUT)
    assert seeds & held_out == (held_out if scale == "full" else set())
    ablated = [job for job in jobs if job.study.startswith(flip_sessions.ABLATION)]
    papers = {job.key: job.arguments for job in jobs if job.study == flip_sessions.PAPER}
    assert ablated
    for job in ablated:
        changes = {key: x for key, x in job.arguments["changes"].items() if key != "variant"}
        session = {**job.arguments, "changes": changes}
        paper = {key: x for key, x in papers[job.key].items() if key != "keep_paths"}
        assert session == paper


def rollout(kind: str, ret: float, landed: bool = True, angle: float = 175.0) -> dict[str, Any]:
    return {
        "kind": kind,
        "ret": ret,
        "landed": landed,
        "true_flip": landed and angle > 150.0,
        "angle_deg": angle,
        "apex": 0.4,
        "miss": 0.02,
        "peak_qd": [0.1] * 7,
        "elbow_speed": 0.5,
        "forearm_speed": 1.25,
        "beyond_no_load": False,
        "fault": "",
    }


def held(seed: int, landed: bool = True, angle: float = 175.0) -> dict[str, Any]:
    """A session's result without a simulation."""
    rng = np.random.default_rng(seed)
    curve = (0.6 + 0.01 * np.arange(50) + 0.01 * rng.standard_normal(50)).tolist()
    retests = [rollout("retest", 1.0, landed, angle)] * 10
    return {
        "ended_by": "confirmation",
        "used": 20,
        "trials": [rollout("explore", ret) for ret in curve],
        "retests": retests,
        "curve": curve,
        "fires": 33,
        "carried": {"wind 0.2 m/s": retests, "80 V": retests},
        "k33": {"demonstrated": [300.0] * 41, "learnt": [290.0, *[300.0] * 40]},
        "paths": {},
    }


def results(default: list[dict[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    few = {f"seed-{seed}": held(seed) for seed in range(6)}
    return {
        "pancake-hindsight": {f"seed-{seed}": session for seed, session in enumerate(default)},
        "pancake-paper": few,
        "pancake-ablation-diagonal": few,
    }


def claim(chapter: Chapter, words: str) -> Claim:
    (found,) = [claim for claim in chapter.claims if words in claim.what]
    return found


def test_a_claim_of_the_chapter_is_met_only_if_the_sessions_meet_it() -> None:
    short = [held(seed, angle=147.0) for seed in range(4)]  # caught, and turned too little
    chapter = STUDY.chapter(results([*(held(seed) for seed in range(4, 10)), *short]))
    assert claim(chapter, "hindsight: landed in at least 90%").met
    assert claim(chapter, "hindsight: true flips").met is False
    assert claim(chapter, "hindsight: true flips").ours == "6 of 10 sessions"
    assert claim(chapter, "gain of the mean return").ours == "0.45"
    assert "fig5-learning-curve" in chapter.figures
    assert "was a true flip in 0 of 10 sessions" in " ".join(chapter.html.split())
    assert Sessions(short[:1]).count == "1 session"


@pytest.mark.parametrize(("angles", "count"), [((95.0, 170.0), 1), ((170.0, 95.0), 0)])
def test_the_reproduction_that_is_learnt_from_is_counted_and_no_other(
    angles: tuple[float, float], count: int
) -> None:
    first = [rollout("reproduction", 0.5 + k, angle=angle) for k, angle in enumerate(angles)]
    taught = {**held(0), "trials": [*first, rollout("explore", 1.9)]}
    assert Sessions([taught, held(1)]).reproduced == count
