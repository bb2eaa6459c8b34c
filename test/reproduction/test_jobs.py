# SPDX-License-Identifier: Apache-2.0
"""Jobs lose nothing, repeat nothing, and give the same numbers however they were computed."""

import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import study_jobs
from rich.console import Console

from reproduction import jobs as job_cache
from reproduction.jobs import Job, JobError, run

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "wam_power_ros"


def draws(count: int = 6, seconds: float = 0.0) -> list[Job]:
    return [
        Job(f"study-{k % 2}", f"seed-{k}", study_jobs.draw, {"seed": k, "seconds": seconds})
        for k in range(count)
    ]


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.json")}


def in_memory() -> Console:
    return Console(file=io.StringIO(), width=200)


def test_results_are_the_same_whatever_the_order_and_the_number_of_workers(tmp_path: Path) -> None:
    one = run(draws(), tmp_path / "one")
    assert run(draws()[::-1], tmp_path / "two", workers=2) == one
    assert files(tmp_path / "one") == files(tmp_path / "two")
    assert one["study-0"]["seed-2"] == study_jobs.draw(2)  # every bit


def test_an_existing_result_is_not_computed_again(tmp_path: Path) -> None:
    job = Job("study", "key", study_jobs.count, {"log": str(tmp_path / "log")})
    assert run([job], tmp_path) == run([job], tmp_path) == {"study": {"key": {"done": True}}}
    assert (tmp_path / "log").read_text() == "x"


@pytest.mark.parametrize("spoilt", ["", "[]", '{"result": {}}', '{"digest": "0", "result": {}}'])
def test_a_result_of_other_sources_or_a_broken_one_is_computed_again_with_a_message(
    tmp_path: Path, spoilt: str
) -> None:
    job = Job("study", "key", study_jobs.count, {"log": str(tmp_path / "log")})
    run([job], tmp_path)
    (tmp_path / "study/key.json").write_text(spoilt)
    console = in_memory()
    assert run([job], tmp_path, console=console) == {"study": {"key": {"done": True}}}
    assert "1 results of other sources" in console.file.getvalue()
    assert (tmp_path / "log").read_text() == "xx"


def test_other_arguments_make_a_result_stale(tmp_path: Path) -> None:
    run([Job("study", "key", study_jobs.draw, {"seed": 1})], tmp_path)
    again = run([Job("study", "key", study_jobs.draw, {"seed": 2})], tmp_path)
    assert again["study"]["key"] == study_jobs.draw(2)


def test_a_job_that_fails_is_named_and_takes_no_other_with_it(tmp_path: Path) -> None:
    jobs = [Job("bad", "apple", study_jobs.fail, {"why": "a worm"}), *draws()]
    for workers in (1, 2):
        with pytest.raises(JobError, match=r"(?s)1 of 7.*bad/apple: .*a worm"):
            run(jobs, tmp_path / str(workers), workers)
        assert len(files(tmp_path / str(workers))) == 6


@pytest.mark.parametrize("what", ["nan", "array"])
def test_a_result_that_is_not_json_is_refused(tmp_path: Path, what: str) -> None:
    with pytest.raises(JobError, match="study/key"):
        run([Job("study", "key", study_jobs.give, {"what": what})], tmp_path)
    assert files(tmp_path) == {}


def test_invalid_names_and_arguments_are_refused() -> None:
    for name in ("", "../up", "a/b", ".hidden"):
        with pytest.raises(ValueError, match="must be a file name"):
            Job("study", name, study_jobs.draw)
    with pytest.raises(ValueError, match="arguments of study/key"):
        Job("study", "key", study_jobs.draw, {"seed": float("inf")})
    with pytest.raises(ValueError, match="two jobs with the same name: study-0/seed-0"):
        run([draws()[0], draws()[0]], Path("nowhere"))


def digest_of(job: Job) -> str:
    """Digest as a new process would compute it."""
    for cached in (job_cache.sources, job_cache._code):
        cached.cache_clear()
    return job_cache.digest(job)


def test_a_digest_changes_with_code_that_numbers_depend_on_and_not_with_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = Job("study", "key", study_jobs.draw, {"seed": 1})
    package = tmp_path / "made_up"
    (package / "reporting").mkdir(parents=True)
    (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(job_cache, "PACKAGES", ("made_up",))
    monkeypatch.setattr(job_cache, "NOT_HASHED", (*job_cache.NOT_HASHED, "made_up/reporting"))
    model, report = package / "model.py", package / "reporting/report.py"
    seen = []
    for text in ("def f():\n    'Words.'\n    return 1\n", "# why\ndef f(): return  1\n", "A = 2"):
        model.write_text(text)
        seen.append(digest_of(job))
    assert seen[0] == seen[1] != seen[2]  # comments, docstrings and layout are no change
    report.write_text("B = 1\n")
    assert digest_of(job) == seen[2]


def test_whatever_the_studies_import_is_hashed() -> None:
    names = [module.stem for module in (ROOT / "reproduction/studies").glob("[a-z]*.py")]
    code = (
        f"import importlib, sys\nfor name in {names}:\n"
        "    importlib.import_module(f'reproduction.studies.{name}')\n"
        "print(*[m.__file__ for n, m in sys.modules.items() if n.startswith(('wam_power_ros', "
        "'hardware_sim', 'reproduction')) and getattr(m, '__file__', None)], sep='\\n')"
    )
    asked = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    # The compiled loops change no number.
    imported = {Path(line) for line in asked.stdout.splitlines() if line.endswith(".py")}
    hashed = {path for _, path in job_cache.hashed_sources()}
    assert {PACKAGE / "learning/power.py", ROOT / "hardware_sim/motors.py"} <= imported
    assert {ROOT / "reproduction/rivals/learners.py"} <= imported
    assert imported - hashed <= {ROOT / f"reproduction/{name}.py" for name in ("__init__", "jobs")}


@pytest.mark.long
def test_interrupted_and_begun_again_it_ends_with_the_same_files(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from test_jobs import draws; "
        "from reproduction.jobs import run; "
        "run(draws(10, 0.1), Path(sys.argv[1]), 2)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "stopped")]
    places = [ROOT, ROOT / "test/reproduction", os.environ.get("PYTHONPATH", "")]
    path = os.pathsep.join(map(str, places))
    environment = os.environ | {"PYTHONPATH": path}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE) as process:
        end = time.monotonic() + 600.0
        while len(files(tmp_path / "stopped")) < 2 and time.monotonic() < end:
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
    assert 2 <= len(files(tmp_path / "stopped")) < 10
    run(draws(10, 0.1), tmp_path / "stopped")
    run(draws(10, 0.1), tmp_path / "whole")
    assert files(tmp_path / "stopped") == files(tmp_path / "whole")
