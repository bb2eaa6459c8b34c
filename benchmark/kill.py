# SPDX-License-Identifier: Apache-2.0
"""Kill the learner (-9) repeatedly: its session must end with the records of an undisturbed one.

    python -m benchmark.kill [--seed 42] [--kills 10] [--trials 8] [--demonstrations 4]

First an undisturbed session is run. Then another session learns from the same bags, on nodes that
keep running. Its learner is killed at random moments (drawn from the seed), up to five seconds
after its start or after its first rollout, and restarted with the same folder. No line that
`rollouts.jsonl` had before a kill may change. In the end all fields must be equal except `clock`
and `bag`: a recording that a kill cut short keeps its name, so the repeated rollout is in
rollout_<id>_2.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmark.nodes import environment, node_command
from benchmark.sessions import differences, learn, lines, records, session_parser, verdict
from wam_power_ros.bags.layout import UNFINISHED
from wam_power_ros.cli.processes import Processes
from wam_power_ros.ros.domain import private_domain

ROLLOUT_TIMEOUT = 120.0  # [s]


def learn_killed(
    folder: Path, bags: list[str], seed: int, trials: int, kills: int
) -> tuple[list[str], list[str]]:
    """Run a session whose learner is killed `kills` times, or until the session is over.

    Returns:
        Descriptions of lost lines, and a report line for every kill.
    """
    rng = np.random.default_rng(seed)
    lost, report, kept = [], [], []
    command = node_command(
        "learner",
        use_sim_time=True,
        session=str(folder),
        seed=seed,
        trials=trials,
        demonstrations=bags,
    )
    with private_domain() as domain:
        others = Processes(folder / "logs", environment(domain))
        learners = Processes(folder / "logs", environment(domain))
        with others, learners:
            others.start("wam_sim", node_command("wam_sim", "optitrack_sim", seed=seed))
            for name in ("torque_controller", "pancake_tracker"):
                others.start(name, node_command(name, use_sim_time=True))
            directory = str(folder / "bags")
            recorder = "demonstration_recorder"
            given = {"use_sim_time": True, "directory": directory}
            others.start(recorder, node_command(recorder, **given))
            for kill in range(1, kills + 1):
                rollouts, life = int(rng.integers(2)), float(rng.uniform(0.2, 5.0))
                learner = learners.start("learner", command)
                end = time.monotonic() + ROLLOUT_TIMEOUT
                while len(lines(folder)) < len(kept) + rollouts and time.monotonic() < end:
                    time.sleep(0.01)
                time.sleep(life)
                if learner.process.poll() == 0:  # finished before it was killed
                    report.append(f"  the session was over after {kill - 1} kills")
                    break
                if learner.process.poll() is not None or time.monotonic() > end:
                    raise RuntimeError(f"no session to kill ({kill})\n{learner.tail}")
                before = lines(folder)
                learner.process.kill()
                learner.process.wait()
                others.check()
                recording = any((folder / "bags").glob(f"*{UNFINISHED}"))
                for old in (kept, before):
                    if lines(folder)[: len(old)] != old:
                        lost.append(f"kill {kill}: a line that was on disk has changed")
                kept = lines(folder)
                report.append(
                    f"  {kill:2d}: {life:3.1f} s after its {('start', 'first rollout')[rollouts]}, "
                    f"{len(kept)} records{', recording' * recording}"
                )
            last = Processes(folder / "logs", environment(domain))
            with last:
                last.finish(last.start("learner", command))
            others.check()
    if lines(folder)[: len(kept)] != kept:
        lost.append("a line that was on disk has changed after the last kill")
    return lost, report


def main() -> int:
    """Run both sessions and print the differences; status 1 if there are any."""
    parser = session_parser(__doc__, seed=42)
    parser.add_argument("--kills", type=int, default=10)
    options = parser.parse_args()
    seed = options.seed
    with tempfile.TemporaryDirectory() as scratch:
        folder = (options.folder or Path(scratch)).resolve()
        undisturbed, killed = folder / "undisturbed", folder / "killed"
        took = learn(undisturbed, options)
        bags = json.loads((undisturbed / "demonstrations.json").read_text())
        begun = time.monotonic()
        lost, report = learn_killed(killed, bags, seed, options.trials, options.kills)
        longer = time.monotonic() - begun
        found = [
            *lost,
            *differences(records(undisturbed, "clock", "bag"), records(killed, "clock", "bag")),
        ]
        for record in records(killed):
            if not (killed / "bags" / str(record["bag"]) / "metadata.yaml").exists():
                found.append(f"{record['id']}: no bag {record['bag']!r}")
        bags_left = sorted(path.name for path in (killed / "bags").iterdir())
        print(
            f"seed {seed}, {len(lines(undisturbed))} rollouts: {took:.0f} s undisturbed,", end=" "
        )
        kills = sum(" records" in line for line in report)
        print(f"{longer:.0f} s with {kills} kills", *report, sep="\n")
        print(f"bags: {len(bags_left)}, including rollouts that a kill cut short")
        print(verdict("rollouts, undisturbed and killed", found))
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
