# SPDX-License-Identifier: Apache-2.0
"""Reaching past an obstacle, the paper's simulated experiment (Sec. III-A).

    python -m wam_power_ros.experiments.studies.reaching --first 0 --runs 10   timed
    python -m wam_power_ros.experiments.studies.reaching --tune full        noise scales
    python -m wam_power_ros.experiments.studies.reaching --speed            rollouts per second

The paper gives neither its demonstrations nor its obstacle. Ours are random here
(`synthetic_reach`), and taught on the simulated arm in `reaching_arm`. No ROS, no physics.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from scipy.stats import ranksums

from wam_power_ros.experiments.jobs import Job
from wam_power_ros.experiments.studies import reaching_arm
from wam_power_ros.experiments.studies.reaching_runs import (
    CHUNK,
    NOISE,
    VARIANTS,
    as_data,
    evaluate,
    scales,
    study,
)
from wam_power_ros.experiments.studies.synthetic_reach import synthetic
from wam_power_ros.learning.dmp import activations
from wam_power_ros.learning.parametrization import NoiseScales, Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.tasks.reach.scenario import Scenario

SYNTHETIC = "reaching-synthetic"  # study
GRID = [
    scales(stiffness, attractor)
    for stiffness in (0.3, 0.6, 1.0)
    for attractor in (0.003125, 0.00625, 0.0125, 0.025, 0.05, 0.1, 0.2)
]
TUNING = range(1_000_000, 1_000_060)
HELD_OUT = range(401, 441)


def tune(
    variant: str, seeds: Sequence[int] = TUNING, rollouts: int = 100, workers: int = 1
) -> list[tuple[float, NoiseScales]]:
    """Mean final return for a grid of noise scales, the same for both variants; best first.

    Args:
        variant: Variant of the parametrization.
        seeds: Tuning seeds, disjoint from those of the study; fewer than 60 select settings that
            fail on others.
        rollouts: Number of rollouts of each run.
        workers: Number of processes.
    """
    scenario = synthetic()
    scores = []
    for noise in GRID:
        runs = study(variant, seeds, rollouts, scenario, noise, workers)
        scores.append((float(np.mean([run.final for run in runs])), noise))
    return sorted(scores, key=lambda score: -score[0])


def jobs(scale: Literal["full", "quick"]) -> list[Job]:
    """Runs of the chapter: held-out seeds; in "quick", few rollouts with two tuning seeds."""
    full = scale == "full"
    seeds: Sequence[int] = HELD_OUT if full else TUNING[:2]
    rollouts = 100 if full else 10
    found = []
    for variant in VARIANTS:
        for k in range(0, len(seeds), CHUNK):
            chunk = list(seeds[k : k + CHUNK])
            arguments = {"variant": variant, "seeds": chunk, "rollouts": rollouts}
            key = f"{variant}-{chunk[0]}-{chunk[-1]}"
            found.append(Job(SYNTHETIC, key, synthetic_runs, arguments))
    return found + reaching_arm.jobs(seeds[:CHUNK], rollouts)


def synthetic_runs(variant: str, seeds: list[int], rollouts: int) -> dict[str, Any]:
    """PoWER on the synthetic scenario, as data."""
    scenario = synthetic()
    return as_data(study(variant, seeds, rollouts, scenario), seeds, variant, scenario)


def plain_path(policy: Policy, scenario: Scenario) -> np.ndarray:
    """Path of Eq. 1 computed literally, one policy and one step at a time: reference for batching.

    Returns:
        Positions without the obstacle [m]. Shape (T, 3).
    """
    h = activations(policy.basis, np.arange(scenario.steps - 1) * scenario.period)
    x, xd = np.array(scenario.start), np.zeros(3)
    path = [x]
    for weights in h:
        xdd = -policy.damping * xd
        for weight, stiffness, attractor in zip(
            weights, policy.stiffness, policy.attractors, strict=True
        ):
            xdd = xdd + weight * (stiffness @ (attractor - x))
        xd = xd + scenario.period * xdd
        x = x + scenario.period * xd
        path.append(x)
    return np.stack(path)


def rollouts_per_second(scenario: Scenario, count: int = 500) -> tuple[float, float]:
    """Rollouts a second with their returns, `count` of them batched, and plain one by one."""
    parameters = Parametrization(scenario.policy, "full", NOISE["full"])
    z = np.random.default_rng(0).standard_normal((count, parameters.size))
    few = [parameters.policy(one, "speed")[0] for one in z[:20]]
    batched, plain = [], []
    for _ in range(5):
        began = time.perf_counter()
        evaluate(z, parameters, scenario)
        batched.append(time.perf_counter() - began)
        began = time.perf_counter()
        for policy in few:
            path, _ = scenario.stopped(plain_path(policy, scenario)[np.newaxis])
            scenario.worth(path)
        plain.append(time.perf_counter() - began)
    return count / min(batched), len(few) / min(plain)


def main(argv: Sequence[str] | None = None) -> None:
    """Compare full with diagonal stiffness and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10, help="runs of each variant")
    parser.add_argument("--rollouts", type=int, default=100, help="rollouts of each run")
    parser.add_argument("--first", type=int, default=TUNING[0], help="first seed")
    parser.add_argument("--workers", type=int, default=2, help="number of processes")
    parser.add_argument("--tune", choices=VARIANTS, help="print a grid of noise scales instead")
    parser.add_argument("--speed", action="store_true", help="print rollouts per second instead")
    args = parser.parse_args(argv)
    if args.tune:
        for score, noise in tune(args.tune, workers=args.workers):
            _print(f"{args.tune:9} {score:.3f}  K {noise.stiffness:4}  mu {noise.attractor:7} m")
        return
    if args.speed:
        batched, plain = rollouts_per_second(synthetic())
        _print(f"rollouts/s: batched {batched:.0f}, plain {plain:.0f}, ratio {batched / plain:.0f}")
        return
    scenario = synthetic()
    seeds = range(args.first, args.first + args.runs)
    final = {}
    began = time.perf_counter()
    for variant in VARIANTS:
        runs = study(variant, seeds, args.rollouts, scenario, workers=args.workers)
        final[variant] = np.array([run.final for run in runs])
        _print(
            f"{variant:9} final mean {final[variant].mean():.3f} "
            f"median {np.median(final[variant]):.3f} sd {final[variant].std(ddof=1):.3f} "
            f"best rollout {np.mean([run.best for run in runs]):.3f} "
            f"stuck {np.mean([run.stuck for run in runs]):.0%}"
        )
    took = time.perf_counter() - began
    p = ranksums(final["full"], final["diagonal"], alternative="greater").pvalue
    _print(f"full > diagonal: rank-sum p = {p:.2g} (one-sided)")
    _print(f"{args.runs} x {args.rollouts} x {len(VARIANTS)} rollouts in {took:.1f} s")


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
