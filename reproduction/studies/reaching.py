# SPDX-License-Identifier: Apache-2.0
"""Reaching past an obstacle: the paper's simulated experiment (Sec. III-A).

The paper gives neither its demonstrations nor its obstacle. Here they are random
(`reaching_runs.synthetic`); in `reaching_arm` they are taught on the simulated arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from reproduction.jobs import Job, Scale
from reproduction.studies import reaching_arm
from reproduction.studies.reaching_runs import CHUNK, VARIANTS, as_data, study, synthetic

SYNTHETIC = "reaching-synthetic"  # study
TUNING = range(1_000_000, 1_000_060)
HELD_OUT = range(401, 441)


def jobs(scale: Scale) -> list[Job]:
    """Runs of the chapter on held-out seeds; in "quick", few rollouts on two tuning seeds."""
    full = scale == "full"
    seeds: Sequence[int] = HELD_OUT if full else TUNING[:2]
    rollouts = 100 if full else 10
    found = []
    for variant in VARIANTS:
        for k in range(0, len(seeds), CHUNK):
            chunk = list(seeds[k : k + CHUNK])
            one = {"variant": variant, "seeds": chunk, "rollouts": rollouts}
            found.append(Job(SYNTHETIC, f"{variant}-{chunk[0]}-{chunk[-1]}", synthetic_runs, one))
    return found + reaching_arm.jobs(seeds[:CHUNK], rollouts)


def synthetic_runs(variant: str, seeds: list[int], rollouts: int) -> dict[str, Any]:
    """PoWER on the synthetic scenario, as data."""
    scenario = synthetic()
    return as_data(study(variant, seeds, rollouts, scenario), seeds, variant, scenario)
