# SPDX-License-Identifier: Apache-2.0
"""Chapters show their contents, escaped; the rows of a table match its head."""

import numpy as np
import pytest

from wam_power_ros import plotting
from wam_power_ros.reporting import chapter, figures
from wam_power_ros.reporting.chapter import Chapter, Claim, Figure, Table

CLAIM = Claim("return <after> 100", "0.73", "0.754", "sd 0.08", "40 seeds", True, "the obstacle")


def test_a_chapter_shows_text_tables_figures_and_parts_in_this_order() -> None:
    drawn = Figure.of("a", "A figure.", figures.learning_curve([0.5, 0.7]))
    missing = Figure("b", "No picture: there is no OpenGL.", b"")
    part = Chapter("A part", ["Words & more."], [CLAIM], figures=[missing])
    table = Table("A table.", ["who", "return"], [["PoWER", "0.7"], ["none", "0.5"]], {(0, 1)})
    html = chapter.html(Chapter("Reaching", ["Begun."], [CLAIM], [table], [drawn], [part]))
    order = ["<h2>Reaching", "Begun.", "A table.", "A figure.", "<h3>A part", "Words &amp; more."]
    assert [html.index(words) for words in order] == sorted(html.index(words) for words in order)
    assert html.count("<img") == 1 and "there is no OpenGL" in html
    assert '<td class="best">0.7</td>' in html


def test_claims_and_figures_of_the_parts_are_found_in_order() -> None:
    part = Chapter("part", claims=[CLAIM], figures=[Figure("second", "", b"x")])
    whole = Chapter("whole", figures=[Figure("first", "", b"x")], parts=[part])
    assert whole.all_claims() == [CLAIM]
    assert [drawn.name for drawn in whole.all_figures()] == ["first", "second"]


def test_the_overview_has_a_verdict_on_every_claim() -> None:
    claims = [CLAIM, Claim("b", "", "1", "", "", False), Claim("c", "", "2", "", "", None)]
    html = chapter.overview([Chapter("Reaching", claims=claims), Chapter("Nothing claimed")])
    assert html.count("<td>") == len(claims) and "Nothing claimed" not in html
    for words in (
        ">Reaching<",
        "return &lt;after&gt; 100",
        "left open: the obstacle",
        ">not met<",
        ">reported<",
    ):
        assert words in html


@pytest.mark.parametrize("met", [True, False])
def test_a_few_runs_are_no_ground_for_a_verdict(met: bool) -> None:
    few, enough = (Claim("a", "", "1", "", "", met, runs=runs) for runs in (2, 5))
    assert (few.holds, few.verdict) == (None, "too few runs")
    assert enough.holds is met
    html = chapter.overview([Chapter("Reaching", claims=[few])])
    assert 'class="reported">too few runs<' in html
    only_reported = Claim("a", "", "1", "", "", None, runs=1)
    assert only_reported.verdict == "reported"


def test_colours_of_drawings_are_inverted_in_the_dark_and_those_of_photographs_not() -> None:
    drawn = Figure.of("a", "", figures.learning_curve([0.5, 0.7]))
    photographs = Figure.of("b", "", figures.filmstrip([np.zeros((6, 8, 3), np.uint8)]))
    html = chapter.html(Chapter("t", figures=[drawn, photographs]))
    assert html.count('class="drawn"') == 1


def test_a_row_of_another_width_than_the_head_is_refused() -> None:
    with pytest.raises(ValueError, match="row of 1 cells in a table of 2 columns"):
        chapter.html(Chapter("t", tables=[Table("", ["a", "b"], [["1"]])]))


def test_the_same_figure_gives_the_same_bytes() -> None:
    one, two = (plotting.png(figures.learning_curve([0.5, 0.7])) for _ in range(2))
    assert one == two
