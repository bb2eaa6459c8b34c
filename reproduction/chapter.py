# SPDX-License-Identifier: Apache-2.0
"""A study of the report: its runs, and its chapter with the claims and figures that it names."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from reproduction.jobs import Job, Results, Scale
from wam_power_ros import plotting
from wam_power_ros.reporting import html_page
from wam_power_ros.reporting.html_page import TEMPLATES
from wam_power_ros.reporting.terminal import counted

RUNS_MIN = 5  # for a verdict: with fewer runs, no rank-sum test reaches p < 0.01
TEMPLATES.filters["f"] = format
TEMPLATES.globals |= {"counted": counted, "median": np.median}


@dataclass(frozen=True)
class Claim:
    """A row of the overview: a claim of the paper or of this project, and the measurement."""

    what: str  # in short, such as "Reaching, full stiffness, return after 100"
    ours: str  # measured value, such as "0.754"
    spread: str  # of the measured value, such as "sd 0.08" or "0.61 to 0.83"; may be empty
    count: str  # sample size, such as "40 seeds"
    met: bool | None = None  # whether it holds; None without a criterion: the value is reported
    runs: int | None = None  # independent ones per condition; None if the verdict depends on none
    paper: str = ""  # value in the paper, such as "0.73"; empty if it has none
    left_open: str = ""  # decision that the paper leaves open; may be empty

    @property
    def holds(self) -> bool | None:
        """Whether the claim holds; None without a criterion or with too few runs for a verdict."""
        return None if self._too_few else self.met

    @property
    def verdict(self) -> str:
        """One of "met", "not met", "reported" and "too few runs"."""
        if self._too_few:
            return "too few runs"
        return {True: "met", False: "not met", None: "reported"}[self.met]

    @property
    def _too_few(self) -> bool:
        return self.met is not None and self.runs is not None and self.runs < RUNS_MIN


class Chapter:
    """A chapter of the report.

    The template calls `claim` with the fields of a `Claim`, `table` and `figure`.

    Attributes:
        html: Content, by a template that uses the names of `values`.
        claims: Rows of the overview, in order.
        figures: Name -> content of a .png file.

    Raises:
        ValueError: Two figures have the same name, or a row and the head of its table differ.
        jinja2.UndefinedError: The template uses a name that has no value.
    """

    def __init__(self, title: str, template: Path, values: Mapping[str, object]) -> None:
        self.title = title
        self.claims: list[Claim] = []
        self.figures: dict[str, bytes] = {}
        functions = {"claim": self._claim, "table": table, "figure": self._figure}
        content = TEMPLATES.from_string(template.read_text()).render(values, **functions)
        self.html = html_page.section(title, content=Markup(content))

    def _claim(self, what: str, met: object = None, **fields: Any) -> None:  # noqa: ANN401
        self.claims.append(Claim(what, met=None if met is None else bool(met), **fields))

    def _figure(self, name: str, caption: str, drawn: Figure) -> Markup:
        if name in self.figures:
            raise ValueError(f"two figures with the same name: {name}")
        self.figures[name] = png = plotting.png(drawn)
        return html_page.figure(html_page.image(png, caption, "image/png", "drawn"), caption)


@dataclass(frozen=True)
class Study:
    """A study and its chapter of the report."""

    title: str  # heading of the chapter
    jobs: Callable[[Scale], list[Job]]  # runs at a scale
    values: Callable[[Results], Mapping[str, Any]]  # names of the template, from their results
    template: Path

    def chapter(self, results: Results) -> Chapter:
        """Chapter on results of the jobs; those of other studies are ignored."""
        return Chapter(self.title, self.template, self.values(results))


def table(
    caption: str,
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    best: Collection[tuple[int, int]] = (),
) -> Markup:
    """HTML of a table, for templates; see `html_page.table`."""
    return html_page.table(head, rows, caption, best=best)
