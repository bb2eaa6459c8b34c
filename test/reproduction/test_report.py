# SPDX-License-Identifier: Apache-2.0
"""The reproduction: one command, one report, the same numbers wherever it ran."""

import dataclasses
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import study_jobs
from test_jobs import draws, files

from reproduction import jobs as job_cache
from reproduction import report
from reproduction.chapter import Chapter

ROOT = Path(__file__).resolve().parents[2]
PYTHONPATH = os.pathsep.join(
    [str(ROOT), str(ROOT / "test/reproduction"), os.environ.get("PYTHONPATH", "")]
)
SLOW = """
import study_jobs
from reproduction import report

report.STUDIES = {"draws": study_jobs.STUDY}
study_jobs.SECONDS = 0.2
raise SystemExit(report.main())
"""  # `python -m reproduction` with a study that takes a while


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
    for words in ("1 of 1", "The mean &lt;of&gt; draws is zero", "1–3", "There is no OpenGL"):
        assert words in html
    assert (tmp_path / "figures/draws.png").read_bytes().startswith(b"\x89PNG")
    assert len(files(tmp_path / "results")) == 3
    out = capsys.readouterr().out
    assert "The mean <of> draws is zero" in out and "met" in out
    assert "3 of them" not in out
    assert report.main(arguments) == 0
    told = " ".join(capsys.readouterr().out.split())  # the lines are wrapped
    assert "3 of them had been computed before" in told


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


def test_an_unknown_study_is_refused_with_the_known_ones(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        report.main(["--only", "cooking"])
    assert "invalid choice: 'cooking' (choose from" in capsys.readouterr().err


def test_two_figures_with_the_same_name_are_refused(tmp_path: Path) -> None:
    chapter = study_jobs.STUDY.chapter(job_cache.run(study_jobs.jobs("quick"), tmp_path))
    with pytest.raises(ValueError, match="two figures with the same name: draws"):
        report.write(tmp_path, "quick", [chapter, chapter], [], "")


def test_seeds_and_times_are_written_in_short() -> None:
    assert report.ranges({301, 302, 303, 7}) == "7, 301–303"
    times = [0.123, 9.7, 45.2, 99.6, 3600.0, 7500.0]
    written = ["0.12 s", "9.7 s", "45 s", "2 min", "60 min", "2 h 5 min"]
    assert [report.duration(seconds) for seconds in times] == written


@pytest.mark.long
def test_stopped_by_ctrl_c_and_begun_again_a_reproduction_ends_with_the_same_numbers(
    tmp_path: Path,
) -> None:
    def begin(folder: Path, workers: int) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", SLOW, "--quick"]
        command += ["--folder", str(folder), "--jobs", str(workers)]
        environment = os.environ | {"PYTHONPATH": PYTHONPATH}
        return subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    stopped, whole = tmp_path / "stopped", tmp_path / "whole"
    with begin(stopped, 1) as process:
        while not files(stopped):
            assert process.poll() is None, process.communicate()
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    assert process.returncode == 130, err
    assert f"Finished results are in {stopped}" in out and "python -m reproduction --quick" in out
    assert not (stopped / "report.html").exists()
    for folder, workers in ((stopped, 2), (whole, 1)):
        with begin(folder, workers) as process:
            _, err = process.communicate()
        assert process.returncode == 0, err
    assert files(stopped) == files(whole) != {}
    assert (stopped / "report.html").exists()
    shown = {path.name: path.read_bytes() for path in (stopped / "figures").iterdir()}
    assert shown == {path.name: path.read_bytes() for path in (whole / "figures").iterdir()} != {}


def test_without_a_verdict_no_share_of_claims_is_counted(tmp_path: Path) -> None:
    (template := tmp_path / "chapter.html.j2").write_text(
        '{% do claim("ours ahead", ours="1.0", spread="", count="2 runs", met=true, runs=2) %}'
    )
    html = report.render("quick", [Chapter("chapter", template, {})], [], "", tmp_path)
    assert "No claim has the 5 runs that a verdict needs." in html
    assert "0 of 0" not in html
