# SPDX-License-Identifier: Apache-2.0
"""Learners side by side: a line for each place at which they learn, and each learner.

    python -m reproduction.studies grounds [--only PLACE ...] [--learners NAME ...] [--seeds N]

Results are kept in a folder, a JSON file for each run, and are not computed again.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reproduction import jobs as job_cache
from reproduction.studies import (
    ball_in_cup,
    by_positions,
    equal_knowledge,
    grounds,
    new_goals,
    rated,
    stopping,
    two_axes,
)
from reproduction.studies.table import study_of

STUDIES = {
    "grounds": grounds.TABLE,
    "ball_in_cup": ball_in_cup.TABLE,
    "equal_knowledge": equal_knowledge.TABLE,
    "new_goals": new_goals.TABLE,
    "stopping": stopping.TABLE,
    "two_axes": two_axes.TABLE,
    "by_positions": by_positions.TABLE,
    "rated": rated.TABLE,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a study and print a line for every place and learner."""
    parser = argparse.ArgumentParser(prog="python -m reproduction.studies", description=__doc__)
    chosen = parser.add_subparsers(dest="study", required=True)
    for name, table in STUDIES.items():
        options = chosen.add_parser(name)
        for flag, all_of, usual in zip(
            ("--only", "--learners"), (table.places, table.learners), table.usual, strict=True
        ):
            default = [each for each in all_of if usual is None or each in usual]
            options.add_argument(flag, nargs="+", choices=[*all_of], default=default)
        options.add_argument("--first", type=int, default=table.seeds[0], help="seed")
        options.add_argument("--seeds", type=int, default=len(table.seeds), help="of each line")
        options.add_argument("--folder", type=Path, default=Path(name), help="of the results")
        options.add_argument("--workers", type=int, default=1)
        options.set_defaults(table=None)
        if table.row is not None:
            options.add_argument("--table", type=Path, help="CSV file, a line for each run")
    given = parser.parse_args(arguments)
    table = STUDIES[given.study]
    seeds = range(given.first, given.first + given.seeds)
    wanted = table.jobs(seeds, given.only, given.learners)
    results = job_cache.run(wanted, given.folder, workers=given.workers)
    rows: list[dict[str, Any]] = []
    for place in given.only:
        for learner in given.learners:
            found, told = results[study_of(place, learner)], table.learners[learner].told
            line = table.line(list(found.values()))
            sys.stdout.write(f"{place}, {learner} (learns from {told}): {line}\n")
            for key, one in found.items() if given.table else ():
                seed = {"ground": place, "learner": learner, "seed": key.removeprefix("seed-")}
                rows.append({**seed, **table.row(one)})
    if given.table:
        with given.table.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
