# SPDX-License-Identifier: Apache-2.0
"""A study that puts learners side by side: its runs, and what the command prints of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

from reproduction.jobs import Job

Arguments = Mapping[str, Any]  # of `Table.session`


class Row(NamedTuple):
    """A learner: what it is told of a rollout, and the arguments of its runs."""

    told: str
    arguments: Arguments


@dataclass(frozen=True)
class Table:
    """A study with a line for each place at which learners learn, and each learner.

    Attributes:
        places: Arguments of the runs at each place, by its name.
        learners: Learners by name.
        seeds: Seeds, which were not used for tuning.
        session: Run of one seed, its argument `seed`; of all of them, `seeds`, if `together`.
        line: Statistics of the runs of a learner at a place.
        usual: Places and learners that are run if none is named; None for all.
        row: Figures of one run, a line of the file of `--table`; None for no such file.
        together: Whether one run has all seeds.
    """

    places: Mapping[str, Arguments]
    learners: Mapping[str, Row]
    seeds: Sequence[int]
    session: Callable[..., Any]
    line: Callable[[Sequence[Any]], Mapping[str, Any]]
    usual: tuple[Collection[str] | None, Collection[str] | None] = (None, None)
    row: Callable[[Mapping[str, Any]], Mapping[str, Any]] | None = None
    together: bool = False

    def jobs(
        self, seeds: Sequence[int], places: Sequence[str], learners: Sequence[str]
    ) -> list[Job]:
        """Runs of every learner at every place, ordered by seed."""
        runs: dict[str, Arguments] = {f"seed-{seed}": {"seed": seed} for seed in seeds}
        if self.together:
            runs = {"runs": {"seeds": [*seeds]}}
        found = []
        for (key, own), place, learner in product(runs.items(), places, learners):
            arguments = {**own, **self.places[place], **self.learners[learner].arguments}
            found.append(Job(study_of(place, learner), key, self.session, arguments))
        return found


def study_of(place: str, learner: str) -> str:
    """Name of the study of a learner at a place, of which both may hold any characters."""
    return re.sub(r"[^\w.]", "-", f"{place}-{learner}")
