# SPDX-License-Identifier: Apache-2.0
"""Chapter of a report as data, and its HTML: claims, tables and figures under a title."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from html import escape

from matplotlib.figure import Figure as MatplotlibFigure

from wam_power_ros import plotting
from wam_power_ros.reporting import html_page

RUNS_MIN = 5  # for a verdict: with fewer runs, no rank-sum test reaches p < 0.01


@dataclass(frozen=True)
class Claim:
    """A row of the overview: a claim of the paper or of this project, and the measurement.

    Attributes:
        what: Claim in short, such as "Reaching, full stiffness, return after 100".
        paper: Value in the paper, such as "0.73"; empty if it has none.
        ours: Measured value, such as "0.754".
        spread: Spread of the measured value, such as "sd 0.08" or "0.61 to 0.83"; may be empty.
        count: Sample size, such as "40 seeds".
        met: Whether the claim holds; None if there is no criterion and the value is only reported.
        left_open: Decision that the paper leaves open; may be empty.
        runs: Number of independent runs per condition; None if the verdict does not depend on it.
    """

    what: str
    paper: str
    ours: str
    spread: str
    count: str
    met: bool | None = None
    left_open: str = ""
    runs: int | None = None

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


@dataclass(frozen=True)
class Table:
    """A table of texts.

    Attributes:
        caption: Description, one or two sentences.
        head: Names of the columns.
        rows: Cells; each row as long as the head.
        best: Highlighted cells (row, column), counted from 0.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    best: Collection[tuple[int, int]] = ()


@dataclass(frozen=True)
class Figure:
    """A picture.

    Attributes:
        name: File name without suffix, unique in a report, such as "fig5-learning-curve".
        caption: Description, one or two sentences.
        png: Content of the file; empty if it could not be drawn, then `caption` gives the reason.
        drawn: True for a line drawing, whose colours may be inverted in dark mode.
    """

    name: str
    caption: str
    png: bytes
    drawn: bool = False

    @classmethod
    def of(cls, name: str, caption: str, drawn: MatplotlibFigure) -> Figure:
        """Create a figure from one drawn by matplotlib, such as those of `reporting.figures`."""
        has_photographs = any(axes.images for axes in drawn.axes)
        return cls(name, caption, plotting.png(drawn), not has_photographs)


@dataclass(frozen=True)
class Chapter:
    """A chapter of the report, shown in the order text, tables, figures, parts.

    Attributes:
        title: Heading.
        text: Paragraphs.
        claims: Rows of the overview.
        tables: Tables.
        figures: Figures.
        parts: Sub-chapters.
    """

    title: str
    text: Sequence[str] = ()
    claims: Sequence[Claim] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    parts: Sequence[Chapter] = ()

    def all_claims(self) -> list[Claim]:
        """Claims of the chapter and its parts, in order."""
        return [claim for chapter in self._walk() for claim in chapter.claims]

    def all_figures(self) -> list[Figure]:
        """Figures of the chapter and its parts, in order."""
        return [drawn for chapter in self._walk() for drawn in chapter.figures]

    def _walk(self) -> Iterator[Chapter]:
        yield self
        for part in self.parts:
            yield from part._walk()


def html(chapter: Chapter, level: int = 2) -> str:
    """HTML of a chapter with its parts; `level` is the level of its heading."""
    content = "".join(
        html_page.table(t.head, t.rows, t.caption, best=t.best) for t in chapter.tables
    )
    for drawn in chapter.figures:
        style = "drawn" if drawn.drawn else ""
        picture = html_page.image(drawn.png, "image/png", drawn.caption, style) if drawn.png else ""
        content += html_page.figure(picture, drawn.caption)
    content += "".join(html(part, level + 1) for part in chapter.parts)
    return html_page.section(chapter.title, chapter.text, content, level)


def overview(chapters: Sequence[Chapter]) -> str:
    """HTML table of the claims of chapters; on a phone each becomes a card."""
    head = ("", "paper", "measured", "spread", "over", "verdict")
    rows = []
    for chapter in chapters:
        if claims := chapter.all_claims():
            rows.append(f'<tr><th colspan="{len(head)}">{escape(chapter.title)}</th></tr>')
            rows += [_row(claim, head) for claim in claims]
    top = "".join(f"<th>{name}</th>" for name in head)
    return f'<table class="claims"><thead><tr>{top}</tr></thead>{"".join(rows)}</table>'


def _row(claim: Claim, head: Sequence[str]) -> str:
    style = {True: "met", False: "missed", None: "reported"}[claim.holds]
    opened = f"<small>left open: {escape(claim.left_open)}</small>" if claim.left_open else ""
    values = (claim.paper, claim.ours, claim.spread, claim.count)
    cells = "".join(
        f'<td data-head="{name}">{escape(value)}</td>'
        for name, value in zip(head[1:-1], values, strict=True)
    )
    verdict = f'<td data-head="{head[-1]}" class="{style}">{claim.verdict}</td>'
    return f"<tr><td>{escape(claim.what)}{opened}</td>{cells}{verdict}</tr>"
