# SPDX-License-Identifier: Apache-2.0
"""A chapter shows what its template names, escaped; its claims are judged by enough runs."""

from pathlib import Path

import jinja2
import pytest
from matplotlib.figure import Figure

from reproduction.chapter import Chapter, Claim
from wam_power_ros.reporting import figures

CLAIM = """{% do claim("return <after> 100", ours="0.754", spread="", count="40 seeds") %}"""


@pytest.fixture
def template(tmp_path: Path) -> Path:
    """File of a template."""
    return tmp_path / "chapter.html.j2"


def rendered(template: Path, text: str, **values: object) -> Chapter:
    template.write_text(text)
    return Chapter("Reaching", template, values)


def drawing() -> Figure:
    return figures.learning_curve([0.5, 0.7])


def test_a_chapter_shows_what_its_template_names_in_this_order_and_escaped(template: Path) -> None:
    chapter = rendered(
        template,
        CLAIM + '<p>{{ words }}</p>{{ table("A <table>.", ["who"], [["PoWER"]], [(0, 0)]) }}'
        '{{ figure("a", "A figure.", drawn) }}',
        words="Words & more.",
        drawn=drawing(),
    )
    order = ["<h2>Reaching", "Words &amp; more.", "A &lt;table&gt;.", "A figure."]
    assert [chapter.html.index(words) for words in order] == sorted(map(chapter.html.index, order))
    assert chapter.html.count("<img") == 1
    assert '<td class="text best">PoWER</td>' in chapter.html
    assert [claim.what for claim in chapter.claims] == ["return <after> 100"]
    assert [name for name, png in chapter.figures.items() if png.startswith(b"\x89PNG")] == ["a"]


def test_a_name_without_a_value_a_figure_twice_and_a_row_of_another_width_are_refused(
    template: Path,
) -> None:
    with pytest.raises(jinja2.UndefinedError, match="'missing' is undefined"):
        rendered(template, "{{ missing }}")
    with pytest.raises(ValueError, match="two figures with the same name: a"):
        rendered(template, '{{ figure("a", "", drawn) }}' * 2, drawn=drawing())
    with pytest.raises(ValueError, match="row of 1 cells in a table of 2 columns"):
        rendered(template, '{{ table("", ["a", "b"], [["1"]]) }}')


def test_a_few_runs_are_no_ground_for_a_verdict() -> None:
    few, enough = (Claim("a", "1", "", "", False, runs) for runs in (2, 5))
    assert (few.holds, few.verdict) == (None, "too few runs")
    assert (enough.holds, enough.verdict) == (False, "not met")
    assert Claim("a", "1", "", "", runs=1).verdict == "reported"
