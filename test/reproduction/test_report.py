# SPDX-License-Identifier: Apache-2.0
"""The reproduction: one command, one report, the same numbers wherever it ran."""

import dataclasses
import re
from pathlib import Path

import pytest
import study_jobs
from test_jobs import draws, files

from reproduction import jobs as job_cache
from reproduction import report
from reproduction.chapter import Chapter


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


def test_without_a_verdict_no_share_of_claims_is_counted(tmp_path: Path) -> None:
    (template := tmp_path / "chapter.html.j2").write_text(
        '{% do claim("ours ahead", ours="1.0", spread="", count="2 runs", met=true, runs=2) %}'
    )
    html = report.render("quick", [Chapter("chapter", template, {})], [], "", tmp_path)
    assert "No claim has the 5 runs that a verdict needs." in html
    assert "0 of 0" not in html
