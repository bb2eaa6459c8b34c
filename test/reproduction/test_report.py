# SPDX-License-Identifier: Apache-2.0
"""The reproduction: one command, one report, the same numbers wherever it ran."""

import dataclasses
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
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


# On a cluster


@contextmanager
def local_cluster(folder: Path, workers: int = 2) -> Iterator[str]:
    """Start a Dask scheduler and workers as processes; yield the scheduler's address."""
    environment = os.environ | {"PYTHONPATH": PYTHONPATH, "OMP_NUM_THREADS": "1"}
    output = folder / "dask.log"
    with ExitStack() as stack, output.open("wb") as log:

        def start(*words: str) -> None:
            command = [sys.executable, "-m", "dask", *words, "--no-dashboard"]
            files = {"stdout": log, "stderr": log}
            process = subprocess.Popen(command, env=environment, cwd=folder, **files)
            stack.callback(process.wait)
            stack.callback(process.kill)

        start("scheduler", "--host", "127.0.0.1", "--port", "0")
        end = time.monotonic() + 600.0
        while not (found := re.search(r"tcp://127\.0\.0\.1:\d+", output.read_text())):
            assert time.monotonic() < end, output.read_text()
            time.sleep(0.05)
        alone = ("--nthreads", "1", "--no-nanny", "--local-directory", ".")
        for _ in range(workers):
            start("worker", found.group(), *alone)
        yield found.group()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[str]:
    """Address of a Dask scheduler with two workers, each an operating system process."""
    pytest.importorskip("distributed")
    with local_cluster(tmp_path) as address:
        yield address


def test_a_cluster_of_two_worker_processes_gives_the_same_files(
    tmp_path: Path, cluster: str
) -> None:
    jobs = draws(8, 0.05)
    assert job_cache.run(jobs, tmp_path / "cluster", scheduler=cluster) == job_cache.run(
        jobs, tmp_path / "here"
    )
    assert files(tmp_path / "cluster") == files(tmp_path / "here")
    bad = job_cache.Job("bad", "apple", study_jobs.fail, {"why": "a worm"})
    with pytest.raises(job_cache.JobError, match="bad/apple"):
        job_cache.run([bad], tmp_path / "cluster", scheduler=cluster)


def test_a_cluster_of_a_single_worker_computes_on_the_cluster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)  # a run here would be refused for it
    with local_cluster(tmp_path, workers=1) as address:
        results = job_cache.run(draws(3), tmp_path / "cluster", scheduler=address)
    assert results == job_cache.run(draws(3), tmp_path / "here")


def test_a_job_that_is_lost_on_the_cluster_fails_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    execute = job_cache._execute

    def mortal(job: job_cache.Job, expected: str, parent: int | None) -> object:
        if job == lost:
            raise ModuleNotFoundError("wam_power_ros")  # as where a worker lacks the package
        return execute(job, expected, parent)

    *others, lost = jobs = draws(4)
    monkeypatch.setattr(job_cache, "_execute", mortal)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    here = {"processes": False, "dashboard_address": None, "n_workers": 1, "threads_per_worker": 1}
    monkeypatch.setattr(job_cache, "_cluster", lambda _: distributed.Client(**here))
    with pytest.raises(job_cache.JobError, match=f"{lost.name}: lost on the cluster"):
        job_cache.run(jobs, tmp_path, scheduler="tcp://here")
    assert set(files(tmp_path)) == {str(job.path(Path())) for job in others}


def test_without_dask_a_scheduler_is_refused_with_the_extra_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"wam_power_ros\[cluster\]"):
        job_cache.run(draws(1), tmp_path, scheduler="tcp://127.0.0.1:1")


def test_without_a_verdict_no_share_of_claims_is_counted(tmp_path: Path) -> None:
    (template := tmp_path / "chapter.html.j2").write_text(
        '{% do claim("ours ahead", ours="1.0", spread="", count="2 runs", met=true, runs=2) %}'
    )
    html = report.render("quick", [Chapter("chapter", template, {})], [], "", tmp_path)
    assert "No claim has the 5 runs that a verdict needs." in html
    assert "0 of 0" not in html
