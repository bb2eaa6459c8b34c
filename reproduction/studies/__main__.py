# SPDX-License-Identifier: Apache-2.0
"""Learners side by side: a line for each place at which they learn, and each learner.

    python -m reproduction.studies grounds [--only PLACE ...] [--learners NAME ...] [--seeds N]

Results are kept in a folder, a JSON file for each run, and are not computed again.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from reproduction import jobs as job_cache
from reproduction.jobs import Job, Results, study_of
from reproduction.studies import (
    ball_in_cup,
    by_positions,
    equal_knowledge,
    grounds,
    new_goals,
    rated,
    two_axes,
)


def runs_of(results: Results, place: str, learner: str) -> Mapping[str, Any]:
    """Runs of a learner at a place, whose study they alone are."""
    return results[study_of(place, learner)]


class Table(NamedTuple):
    """A study of this form.

    Attributes:
        places: Names of the worlds in which the learners learn.
        told: Learner -> what it is told of a rollout.
        seeds: Seeds, which were not used for tuning.
        jobs: Runs on some seeds, at some places, of some learners.
        line: Statistics of the runs of a learner at a place.
        usual: Places and learners that are run if none is named; None for all.
        row: Figures of one run, a line of the file of `--table`; None for no such file.
        runs: Runs of a learner at a place.
    """

    places: Collection[str]
    told: Mapping[str, str]
    seeds: Sequence[int]
    jobs: Callable[[Sequence[int], Sequence[str], Sequence[str]], list[Job]]
    line: Callable[[Sequence[Any]], Mapping[str, Any]]
    usual: tuple[Collection[str] | None, Collection[str] | None] = (None, None)
    row: Callable[[Mapping[str, Any]], Mapping[str, Any]] | None = None
    runs: Callable[[Results, str, str], Mapping[str, Any]] = runs_of


GROUNDS = Table(
    grounds.GROUNDS,
    {name: learner.told for name, learner in grounds.LEARNERS.items()},
    range(grounds.FIRST, grounds.FIRST + 10),
    grounds.jobs,
    grounds.line,
    (
        grounds.GROUNDS.keys() - {"hand 4.0 rad/s", "varied world", *grounds.OTHER},
        ("model_based", "hindsight"),
    ),
    grounds.row,
)
STUDIES = {
    "grounds": GROUNDS,
    "elsewhere": GROUNDS._replace(jobs=partial(grounds.jobs, elsewhere=True)),
    "ball_in_cup": Table(
        ball_in_cup.DEMONSTRATORS,
        {name: learner.told for name, learner in ball_in_cup.LEARNERS.items()},
        ball_in_cup.HELD_OUT,
        ball_in_cup.jobs,
        ball_in_cup.line,
        (("novice",), None),
    ),
    "equal_knowledge": Table(
        equal_knowledge.NOISES,
        equal_knowledge.LEARNERS,
        equal_knowledge.HELD_OUT,
        equal_knowledge.jobs,
        equal_knowledge.line,
    ),
    "new_goals": Table(
        new_goals.GOALS,
        new_goals.WAYS,
        new_goals.HELD_OUT,
        new_goals.jobs,
        new_goals.line,
        runs=new_goals.runs,
    ),
    "two_axes": Table(
        two_axes.PLACES,
        {name: told for name, (told, _) in two_axes.LEARNERS.items()},
        two_axes.HELD_OUT,
        two_axes.jobs,
        two_axes.line,
        row=dict,
    ),
    "by_positions": Table(
        by_positions.PLACES,
        {name: "rollouts" for name in by_positions.OUTPUTS},
        by_positions.HELD_OUT,
        by_positions.jobs,
        by_positions.line,
    ),
    "rated": Table(rated.PERSONS, rated.VARIANTS, rated.HELD_OUT, rated.jobs, rated.line),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a study and print a line for every place and learner."""
    parser = argparse.ArgumentParser(prog="python -m reproduction.studies", description=__doc__)
    chosen = parser.add_subparsers(dest="study", required=True)
    for name, table in STUDIES.items():
        options = chosen.add_parser(name)
        for flag, all_of, usual in zip(
            ("--only", "--learners"), (table.places, table.told), table.usual, strict=True
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
            found, told = table.runs(results, place, learner), table.told[learner]
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
