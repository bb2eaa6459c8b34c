# SPDX-License-Identifier: Apache-2.0
"""The reproduction: one command, one report of chapters, the same wherever it ran."""

import dataclasses
import re
from pathlib import Path

import jinja2
import pytest
import study_jobs
from matplotlib.figure import Figure
from test_jobs import draws, files

from reproduction import jobs as job_cache
from reproduction import report
from reproduction.chapter import Chapter, Claim
from wam_power_ros.reporting import figures


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """One study, "draws", in place of those of the paper."""
    monkeypatch.setattr(report, "STUDIES", {"draws": study_jobs.STUDY})


@pytest.mark.usefixtures("made_up")
def test_a_reproduction_writes_a_page_that_needs_no_other_file_and_its_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--folder", str(tmp_path), "--quick", "--jobs", "1"]
    assert report.main(arguments) == 0
    html = (tmp_path / "report.html").read_text()
    assert not re.search(r'(src|href)="(?!data:|#)', html)
    for link in re.findall(r'href="#([^"]+)"', html):
        assert f'id="{link}"' in html
    for words in ("1 of 1", "The mean &lt;of&gt; draws is zero", "1–3"):
        assert words in html
    assert (tmp_path / "figures/draws.png").read_bytes().startswith(b"\x89PNG")
    assert len(files(tmp_path / "results")) == 3
    assert "3 of them" not in capsys.readouterr().out
    assert report.main(arguments) == 0
    assert "3 of them had been computed before" in capsys.readouterr().out


@pytest.mark.usefixtures("made_up")
def test_a_run_that_fails_is_reported_and_ends_the_reproduction_with_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = job_cache.Job("bad", "apple", study_jobs.fail, {"why": "a worm"})
    study = dataclasses.replace(study_jobs.STUDY, jobs=lambda scale: [bad, *draws(2)])
    monkeypatch.setitem(report.STUDIES, "draws", study)
    assert report.main(["--folder", str(tmp_path), "--jobs", "1"]) == 1
    assert "bad/apple" in capsys.readouterr().err
    assert len(files(tmp_path / "results")) == 2


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


def test_a_name_without_a_value_and_a_figure_twice_are_refused(template: Path) -> None:
    with pytest.raises(jinja2.UndefinedError, match="'missing' is undefined"):
        rendered(template, "{{ missing }}")
    with pytest.raises(ValueError, match="two figures with the same name: a"):
        rendered(template, '{{ figure("a", "", drawn) }}' * 2, drawn=drawing())


def test_a_few_runs_are_no_ground_for_a_verdict() -> None:
    few, enough = (Claim("a", "1", "", "", False, runs) for runs in (2, 5))
    assert (few.holds, few.verdict) == (None, "too few runs")
    assert (enough.holds, enough.verdict) == (False, "not met")
    assert Claim("a", "1", "", "", runs=1).verdict == "reported"
