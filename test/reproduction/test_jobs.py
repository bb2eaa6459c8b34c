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
from test_architecture import module_arrows

from reproduction import jobs as job_cache
from reproduction.jobs import Job, JobError, run

ROOT = Path(__file__).resolve().parents[2]


def draws(count: int = 6, seconds: float = 0.0) -> list[Job]:
    return [
        Job(f"study-{k % 2}", f"seed-{k}", study_jobs.draw, {"seed": k, "seconds": seconds})
        for k in range(count)
    ]


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.json")}


def in_memory() -> Console:
    return Console(file=io.StringIO(), width=200)


def test_results_are_the_same_in_any_order_by_any_workers_and_beside_a_job_that_fails(
    tmp_path: Path,
) -> None:
    one = run(draws(), tmp_path / "one")
    assert one["study-0"]["seed-2"] == study_jobs.draw(2)  # every bit
    jobs = [*draws()[::-1], Job("bad", "apple", study_jobs.fail, {"why": "a worm"})]
    with pytest.raises(JobError, match=r"(?s)1 of 7.*bad/apple: .*a worm"):
        run(jobs, tmp_path / "two", workers=2)
    assert files(tmp_path / "one") == files(tmp_path / "two")


def test_only_other_arguments_make_a_result_computed_again(tmp_path: Path) -> None:
    job = Job("study", "key", study_jobs.count, {"log": str(tmp_path / "log")})
    assert run([job], tmp_path) == run([job], tmp_path) == {"study": {"key": {"done": True}}}
    assert (tmp_path / "log").read_text() == "x"
    again = run([Job("study", "key", study_jobs.draw, {"seed": 2})], tmp_path)
    assert again["study"]["key"] == study_jobs.draw(2)


@pytest.mark.parametrize("spoilt", ["", '{"result": {}}', '{"digest": "0", "result": {}}'])
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


@pytest.mark.parametrize("what", ["nan", "array"])
def test_a_result_that_is_not_json_is_refused(tmp_path: Path, what: str) -> None:
    with pytest.raises(JobError, match="study/key"):
        run([Job("study", "key", study_jobs.give, {"what": what})], tmp_path)
    assert files(tmp_path) == {}


def test_two_jobs_of_one_name_are_refused() -> None:
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
    arrows, imported = module_arrows(), set()
    waiting = [name for name in arrows if name.startswith("reproduction.studies.")]
    while waiting:
        if (name := waiting.pop()) not in imported:
            imported.add(name)
            waiting += arrows.get(name, ())
    assert {"wam_power_ros.learning.power", "hardware_sim.motors"} <= imported
    assert "reproduction.rivals.learners" in imported
    paths = {path.relative_to(ROOT).with_suffix("") for _, path in job_cache.hashed_sources()}
    hashed = {".".join(path.parts).removesuffix(".__init__") for path in paths}
    own = {"reproduction", "reproduction.jobs", "reproduction.studies.__main__"}
    assert imported - hashed <= own


@pytest.mark.long
def test_interrupted_and_begun_again_it_ends_with_the_same_files(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from test_jobs import draws; "
        "from reproduction.jobs import run; "
        "run(draws(10, 0.1), Path(sys.argv[1]), 2)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "stopped")]
    places = [ROOT, ROOT / "test", ROOT / "test/reproduction", os.environ.get("PYTHONPATH", "")]
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
