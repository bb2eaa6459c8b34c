# SPDX-License-Identifier: Apache-2.0
"""Compare three sessions of one seed: over DDS, over DDS on a busy machine, and in one process.

    python -m benchmark.determinism [--seed 41] [--trials 8] [--demonstrations 4]

Each session teaches its own demonstrations, fits, learns and re-tests. Compared are the fitted
policies and every field of `rollouts.jsonl` except `clock`, which holds the wall-clock times. The
session in one process records no bags and no identity of the arm, so `bag` and `arm` are not
compared with it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmark.sessions import candidates, differences, learn, records, session_parser, verdict


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Run busy processes within a `with` block."""
    command = [sys.executable, "-c", "while True: pass"]
    started = [subprocess.Popen(command) for _ in range(processes)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def in_one_process(
    seed: int, trials: int, demonstrations: int
) -> tuple[list[object], list[object]]:
    """Fitted policies and records of the session in one process."""
    from hardware_sim.scenes import scene_type
    from hardware_sim.settings import WorldSettings
    from hardware_sim.world import World
    from reproduction.studies.flip_sessions import NOVICE, teach
    from wam_power_ros.in_process.environment import Environment
    from wam_power_ros.learning.policy import to_json
    from wam_power_ros.practice.practice import Practice
    from wam_power_ros.practice.settings import preset

    environment = Environment(World(scene_type("flip"), WorldSettings(), seed))
    policies = teach(environment, seed, demonstrations, NOVICE)
    practice = Practice(preset("flip", budget=trials), {}, policies, seed, environment)
    kept = [json.loads(record.to_json()) for record in environment.practise(practice)]
    fitted = [json.loads(to_json(policy)) for policy in policies]
    without = [{key: row[key] for key in row if key not in ("clock", "bag")} for row in kept]
    return [{key: row[key] for key in row if key not in ("id", "arm")} for row in fitted], without


def main() -> int:
    """Run the three sessions and print the differences; status 1 if there are any."""
    options = session_parser(__doc__, seed=41).parse_args()
    cores = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        quiet, loaded = folder / "quiet", folder / "busy"
        took = learn(quiet, options)
        with busy(cores):
            longer = learn(loaded, options)
        begun = time.monotonic()
        fitted, practised = in_one_process(options.seed, options.trials, options.demonstrations)
        alone = time.monotonic() - begun
        count = len(records(quiet))
        print(
            f"seed {options.seed}, {count} rollouts: {took:.0f} s over DDS, {longer:.0f} s beside "
            f"{cores} busy processes, {alone:.0f} s in one process"
        )
        found = []
        for what, pair in {
            "policies fitted, quiet and busy": (candidates(quiet, "id"), candidates(loaded, "id")),
            "rollouts, quiet and busy": (records(quiet, "clock"), records(loaded, "clock")),
            "policies fitted, over DDS and in one process": (
                candidates(quiet, "id", "arm"),
                fitted,
            ),
            "rollouts, over DDS and in one process": (records(quiet, "clock", "bag"), practised),
        }.items():
            found.append(list(differences(*pair)))
            print(verdict(what, found[-1]))
    return int(any(found))


if __name__ == "__main__":
    sys.exit(main())
