# SPDX-License-Identifier: Apache-2.0
"""What a study has to say, as data, and its HTML: claims, tables and figures under a title.

Every word that depends on a result is computed from it by the study's own `chapter`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from html import escape

from matplotlib.figure import Figure as MatplotlibFigure

from wam_power_ros.reporting import figures, html_page


@dataclass(frozen=True)
class Claim:
    """A row of the overview: something the paper or this project says, and what was measured.

    Attributes:
        what: That is claimed, in a few words: "Reaching, full stiffness, return after 100".
        paper: What the paper has, such as "0.73"; empty when it has nothing on it.
        ours: What was measured, such as "0.754".
        spread: Such as "sd 0.08" or "0.61 to 0.83"; may be empty.
        count: Over what, such as "40 seeds".
        met: Whether it holds; None where there is nothing to hold to, only to be reported.
        left_open: What the paper does not say and had to be decided; may be empty.
    """

    what: str
    paper: str
    ours: str
    spread: str
    count: str
    met: bool | None = None
    left_open: str = ""

    @property
    def verdict(self) -> str:
        """In a word."""
        return {True: "met", False: "not met", None: "reported"}[self.met]


@dataclass(frozen=True)
class Table:
    """A table of texts.

    Attributes:
        caption: What it shows, one or two sentences.
        head: Of the columns.
        rows: As many cells in each as the head has.
        best: Cells (row, column) to be set off, counted from 0.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    best: Collection[tuple[int, int]] = ()


@dataclass(frozen=True)
class Figure:
    """A picture.

    Attributes:
        name: Of its file without suffix, unique in a report, such as "fig5-learning-curve".
        caption: What it shows, one or two sentences.
        png: Its bytes; empty when it could not be drawn, and `caption` says why.
    """

    name: str
    caption: str
    png: bytes

    @classmethod
    def of(cls, name: str, caption: str, drawn: MatplotlibFigure) -> Figure:
        """From a matplotlib figure, such as those of `wam_power_ros.reporting.figures`."""
        return cls(name, caption, figures.png(drawn))


@dataclass(frozen=True)
class Chapter:
    """A chapter of the report; read in the order text, tables, figures, parts.

    Attributes:
        title: Its heading.
        text: Paragraphs.
        claims: Its rows of the overview.
        tables: See `Table`.
        figures: See `Figure`.
        parts: Sub-chapters, each with text, tables and figures of its own.
    """

    title: str
    text: Sequence[str] = ()
    claims: Sequence[Claim] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    parts: Sequence[Chapter] = ()

    def all_claims(self) -> list[Claim]:
        """Its own and those of its parts, in order."""
        return [claim for chapter in self._walk() for claim in chapter.claims]

    def all_figures(self) -> list[Figure]:
        """Its own and those of its parts, in order."""
        return [drawn for chapter in self._walk() for drawn in chapter.figures]

    def _walk(self) -> Iterator[Chapter]:
        yield self
        for part in self.parts:
            yield from part._walk()


def html(chapter: Chapter, level: int = 2) -> str:
    """A chapter with its parts; `level` is that of its heading."""
    content = "".join(
        html_page.table(t.head, t.rows, t.caption, best=t.best) for t in chapter.tables
    )
    for drawn in chapter.figures:
        picture = html_page.image(drawn.png, "image/png", drawn.caption) if drawn.png else ""
        content += html_page.figure(picture, drawn.caption)
    content += "".join(html(part, level + 1) for part in chapter.parts)
    return html_page.section(chapter.title, chapter.text, content, level)


def overview(told: Sequence[Chapter]) -> str:
    """HTML table of the claims of chapters; on a phone each becomes a card."""
    head = ("", "paper", "measured", "spread", "over", "verdict")
    rows = []
    for chapter in told:
        if claims := chapter.all_claims():
            rows.append(f'<tr><th colspan="{len(head)}">{escape(chapter.title)}</th></tr>')
            rows += [_row(claim, head) for claim in claims]
    top = "".join(f"<th>{name}</th>" for name in head)
    return f'<table class="claims"><thead><tr>{top}</tr></thead>{"".join(rows)}</table>'


def _row(claim: Claim, head: Sequence[str]) -> str:
    style = {True: "met", False: "missed", None: "told"}[claim.met]
    opened = f"<small>left open: {escape(claim.left_open)}</small>" if claim.left_open else ""
    values = (claim.paper, claim.ours, claim.spread, claim.count)
    cells = "".join(
        f'<td data-head="{name}">{escape(value)}</td>'
        for name, value in zip(head[1:-1], values, strict=True)
    )
    verdict = f'<td data-head="{head[-1]}" class="{style}">{claim.verdict}</td>'
    return f"<tr><td>{escape(claim.what)}{opened}</td>{cells}{verdict}</tr>"
