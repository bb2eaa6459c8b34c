# SPDX-License-Identifier: Apache-2.0
"""Extensions that the paper proposes in its Sec. IV, with and without each of them.

An elite of automatic size against fixed sizes, with and without noise on the returns; a person who
rewards and punishes; a demonstration given while the robot learns.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hardware_sim.settings import PITCH_RATE
from reproduction.jobs import Job, Scale
from reproduction.rivals.learners import RIVALS, AutoPower
from reproduction.studies.flip_sessions import NOVICE, stand_in, teach
from reproduction.studies.reaching_runs import NOISE, POWER, evaluate, generator, synthetic
from wam_power_ros.learning.parametrization import parametrization_of
from wam_power_ros.learning.policy import with_id
from wam_power_ros.learning.power import Power
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset

REACHING, REACHING_NOISY = "extensions-sigma-reaching", "extensions-sigma-reaching-noisy"  # studies
SIGMA, PERSON = "extensions-sigma-pancake-", "extensions-person"
DEMONSTRATION = "extensions-demonstration-"
AUTO = "auto"
LATER = "demonstration-later"  # id of the policy of a demonstration given while learning
HELD_OUT = range(501, 509)  # seeds not used for tuning
HELD_OUT_REACHING = range(501, 531)
TUNING = range(21, 22)  # for "quick"
SIZES: tuple[int | str, ...] = (AUTO, 3, 6, 10, 20)
RETURN_NOISE = 0.1  # standard deviation, as of the returns of one pancake policy
RATING, RATINGS_MAX = 0.3, 20  # of the simulated person
POOR = 4.0  # [rad/s] pitch rate of a demonstrator that hardly turns the pancake
GIVEN_AFTER = 20  # rollouts before the later demonstration


def search(sigma: int | str, seeds: list[int], noise: float, rollouts: int) -> dict[str, Any]:
    """Run PoWER on the reach with full matrices and an elite of size `sigma`, for every seed.

    `noise` is the standard deviation of the noise on each return.

    Returns:
        Of each run, the noise-free return of the "final" mean and the median elite size "sigma".
    """
    scenario = synthetic()
    parameters = parametrization_of(scenario.policy, "full", NOISE["full"])
    kind, size = (AutoPower, {}) if sigma == AUTO else (Power, {"sigma": sigma})
    settings = kind.Settings(**size, decay=POWER.decay)
    learners = [kind(parameters.size, settings, generator(seed)) for seed in seeds]
    noise_rngs = [np.random.default_rng([seed, 1]) for seed in seeds]
    sizes = []
    for _ in range(rollouts):
        drawn = np.stack([parameters.clip(learner.ask()) for learner in learners])
        returns, _ = evaluate(drawn, parameters, scenario)
        for learner, z, ret, rng in zip(learners, drawn, returns, noise_rngs, strict=True):
            learner.tell(z, max(float(ret) + noise * float(rng.standard_normal()), 0.0))
        sizes.append([learner.sigma for learner in learners])
    means = np.stack([parameters.clip(learner.mean) for learner in learners])
    final, _ = evaluate(means, parameters, scenario)
    return {"final": final.tolist(), "sigma": np.median(sizes, axis=0).tolist()}


def session(
    seed: int,
    name: str,
    changes: Mapping[str, Any],
    demonstrations: int = 3,
    pitch_rate: float = PITCH_RATE,
    ratings: int = 0,
    given_after: int = 0,
) -> dict[str, Any]:
    """Run a session of the pancake in which a person may take part; see `flip_sessions.session`.

    The person rates `ratings` rollouts at most: rewards true flips and punishes drops, by the
    simulator's ground truth. After rollout `given_after` a practised demonstrator demonstrates; 0:
    never.
    """
    environment = stand_in(seed)
    candidates = teach(environment, seed, demonstrations, pitch_rate=pitch_rate)
    practice = Practice(preset("flip", name, **changes), {}, candidates, seed, environment)
    rated, refused, sizes = 0, "", []
    for record in environment.practise(practice):
        truth = record.truth or {}
        if practice.learner is not None:
            sizes.append(practice.learner.sigma)
        if practice.stopped:
            continue
        amount = RATING if truth["true_flip"] else 0.0 if truth["caught"] else -RATING
        if rated < ratings and amount and record.ret is not None:
            practice.rate(amount)
            rated += 1
        if record.number == given_after:
            (later,) = teach(environment, seed + 10_000, 1)  # another throw
            try:
                practice.add_demonstration(with_id(later, LATER))
            except ValueError as error:
                refused = str(error)
    chosen = practice.parametrization
    retests = [record for record in practice.records if record.kind == "retest"]
    truths = [record.truth or {} for record in retests]
    return {
        "stopped": practice.stopped,
        "choice": practice.choice,
        "learnt_from": "" if chosen is None else chosen.policy0.id,
        "used": practice.used,
        "rated": rated,
        "refused": refused,
        "sigma": float(np.median(sizes)) if sizes else None,
        "returns": [r.ret for r in practice.records if r.kind != "retest"],
        "retests": [record.ret for record in retests],
        "landed": [truth["caught"] and truth["flipped"] for truth in truths],
        "true_flip": [truth["true_flip"] for truth in truths],
        "angle_deg": [truth["angle_deg"] for truth in truths],
    }


def jobs(scale: Scale) -> list[Job]:
    """Runs of the chapter; "quick" is the same code with few seeds and tiny budgets."""
    quick = scale == "quick"
    seeds = TUNING if quick else HELD_OUT
    sizes = SIZES[:2] if quick else SIZES
    wanted = []
    for study, noise in ((REACHING, 0.0), (REACHING_NOISY, RETURN_NOISE)):
        arguments = {
            "seeds": [1_000_000, 1_000_001] if quick else list(HELD_OUT_REACHING),
            "noise": noise,
            "rollouts": 12 if quick else 100,
        }
        wanted += [Job(study, f"sigma-{s}", search, {"sigma": s, **arguments}) for s in sizes]
    series = 1 if quick else 3
    # The paper's rollouts do not include reproductions of demonstrations that are not chosen.
    budget = series - 1 + (4 if quick else 50)
    paper = {"budget": budget, "confirm": 0, "retests": 1 if quick else 10}
    flip = {"retests": paper["retests"], **({"budget": 6} if quick else {})}
    common = {"demonstrations": series}
    for seed in seeds:
        novice = {"seed": seed, "name": "paper", "pitch_rate": NOVICE, **common}
        poor = {"seed": seed, "name": "hindsight", "changes": flip, "pitch_rate": POOR, **common}
        studies = {}
        for size in (AUTO, 6) if quick else (AUTO, 6, 20):  # a session takes half a minute
            learner = {"name": RIVALS["auto_power"]} if size == AUTO else {"sigma": size}
            changes = {**paper, "learner": learner}
            studies[f"{SIGMA}{size}"] = {**novice, "changes": changes}
        most = 2 if quick else RATINGS_MAX
        studies[PERSON] = {**novice, "changes": paper, "ratings": most}
        studies[f"{DEMONSTRATION}without"] = {**poor, "given_after": 0}
        studies[f"{DEMONSTRATION}with"] = {**poor, "given_after": 2 if quick else GIVEN_AFTER}
        wanted += [Job(s, f"seed-{seed}", session, chosen) for s, chosen in studies.items()]
    return wanted
