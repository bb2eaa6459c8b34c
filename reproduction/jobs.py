# SPDX-License-Identifier: Apache-2.0
"""Independent runs (jobs) spread over cores, with one result file each.

A study is a list of jobs. A result whose file exists is not computed again, so an interrupted study
can be resumed and ends with the same numbers: a job depends neither on the others nor on their
order nor on how many run at a time.

    pancake-hindsight/seed-301.json      {"digest": ..., "result": {...}}
    times.jsonl                        one line per computed job: wall and processor time, host

A result is used only if its digest matches. The digest covers the job's function and arguments, all
Python sources of this project that numbers can depend on (all but `NOT_HASHED`; comments,
docstrings and layout are ignored), the files under config/, urdf/ and bags/, and the versions of
the numerical libraries. Reports can be reworded without computing anything again.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.resources
import inspect
import json
import math
import os
import platform
import signal
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from joblib import Parallel, delayed, parallel_config
from rich.console import Console

from wam_power_ros import durable_files, plain_json
from wam_power_ros.params.resources import share

PACKAGES = ("wam_power_ros", "hardware_sim", "reproduction.rivals", "reproduction.studies")
NOT_HASHED = (  # sources that cannot change a result; the studies run without ROS
    "reproduction.studies/__main__.py",
    "wam_power_ros/bags/importing.py",
    "wam_power_ros/bags/series.py",
    "wam_power_ros/bags/takes.py",
    "wam_power_ros/cli",
    "wam_power_ros/conformance",
    "wam_power_ros/console",
    "wam_power_ros/in_process/render.py",
    "wam_power_ros/in_process/session_answer.py",
    "wam_power_ros/nodes",
    "wam_power_ros/reporting",
    "wam_power_ros/ros",
)
DATA = ("config", "urdf", "bags")
LIBRARIES = ("numpy", "scipy", "pin", "mujoco", "cmaes")  # other versions may change last digits
RESULT_MAX = 100_000_000  # largest result of a job, some thousand times a usual one [byte]
Scale = Literal["full", "quick"]
Results = dict[str, dict[str, dict[str, Any]]]  # study -> key -> result
# What a worker returns: job, result as JSON text, traceback, and times [s] with host.
_Computed = tuple["Job", str, str, dict[str, Any]]


@dataclass(frozen=True)
class Job:
    """One run of a study, with JSON data of finite numbers as arguments and result."""

    study: str  # folder of its result, such as "pancake-hindsight"
    key: str  # name of its file there, such as "seed-301"
    function: Callable[..., dict[str, Any]]  # of a module, deterministic in its arguments
    arguments: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Study and key."""
        return f"{self.study}/{self.key}"

    def path(self, folder: Path) -> Path:
        """File of its result in a folder of results."""
        return folder / self.study / f"{self.key}.json"


class JobError(Exception):
    """Some jobs failed; the message has the name and traceback of each."""


def run(
    jobs: Sequence[Job], folder: Path, workers: int = 1, console: Console | None = None
) -> Results:
    """Return the results of all jobs; compute and write those that the folder lacks.

    Finished results survive Ctrl-C (KeyboardInterrupt) and errors. Results are in the order of
    `jobs`, as read from JSON; `workers` is the number of processes.

    Raises:
        JobError: Some jobs failed; the others are computed and written.
        ValueError: Two jobs have the same name, or workers < 1.
    """
    duplicates = [name for name, count in Counter(job.name for job in jobs).items() if count > 1]
    if duplicates:
        raise ValueError(f"two jobs with the same name: {', '.join(duplicates)}")
    if workers < 1:
        raise ValueError(f"workers = {workers} must be at least 1")
    console = console or Console(stderr=True)
    results = found(jobs, folder)
    if stale := sum(job.path(folder).exists() for job in jobs) - len(results):
        console.print(f"{stale} results of other sources, arguments or versions are ignored.")
    if results:
        console.print(f"{len(results)} of {len(jobs)} results exist already.")
    missing = [job for job in jobs if job.name not in results]
    remaining, start = Counter(job.study for job in missing), time.monotonic()
    if missing:
        console.print(f"{len(missing)} runs to compute, with {workers} processes.", highlight=False)
    failed: list[str] = []
    with contextlib.ExitStack() as stack:
        for done, (job, text, error, times) in enumerate(_compute(missing, workers, stack), 1):
            if error:
                failed.append(f"{job.name}: {error}")
            else:
                _write(job, folder, text, times)
                results[job.name] = plain_json.parse(text, job.name, RESULT_MAX)
            remaining[job.study] -= 1
            if not remaining[job.study]:
                left, minutes = len(missing) - done, (time.monotonic() - start) / 60.0
                estimate = f", about {math.ceil(minutes / done * left)} min left" if left else ""
                console.print(
                    f"{job.study}: done; {done} of {len(missing)} runs{estimate}", highlight=False
                )
    if failed:
        raise JobError(f"{len(failed)} of {len(jobs)} jobs failed.\n" + "\n".join(failed))
    ordered: Results = {}
    for job in jobs:
        ordered.setdefault(job.study, {})[job.key] = results[job.name]
    return ordered


def found(jobs: Sequence[Job], folder: Path) -> dict[str, dict[str, Any]]:
    """Results in the folder whose digest matches, by the names of their jobs."""
    results = {}
    for job in jobs:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # missing or damaged
            kept = plain_json.read(job.path(folder), RESULT_MAX)
            if kept["digest"] == digest(job):
                results[job.name] = kept["result"]
    return results


def spent(jobs: Sequence[Job], folder: Path) -> tuple[float, float]:
    """Total wall and processor time [s] of these jobs, whenever they were computed."""
    times = {}
    with contextlib.suppress(FileNotFoundError):
        for line in (folder / "times.jsonl").read_text().splitlines():
            with contextlib.suppress(ValueError, KeyError):  # a line cut by a power failure
                note = plain_json.parse(line, "times.jsonl")
                times[note["job"]] = (note["wall"], note["cpu"])
    known = [times[job.name] for job in jobs if job.name in times]
    return sum(wall for wall, _ in known), sum(cpu for _, cpu in known)


# Digest


def digest(job: Job) -> str:
    """Digest of all that a job's result depends on; see the module."""
    function = job.function
    module = _code(Path(inspect.getfile(function)))
    names = (function.__module__, function.__qualname__)
    return _hash([*names, _json(job.arguments), module, sources()])


def versions(libraries: Sequence[str] = LIBRARIES) -> list[str]:
    """Versions of Python and of the given libraries that are installed."""
    found = [f"Python {platform.python_version()}"]
    for library in libraries:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):  # ROS renames some
            found.append(f"{library} {importlib.metadata.version(library)}")
    return found


@functools.cache
def sources() -> str:
    """Digest of the sources, data files and library versions that numbers can depend on."""
    parts = [*versions(), *(f"{name}: {_code(path)}" for name, path in hashed_sources())]
    for top in DATA:
        for path in sorted(path for path in share(top).rglob("*") if path.is_file()):
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            parts.append(f"{path.relative_to(share(top))}: {content}")
    return _hash(parts)


def hashed_sources() -> Iterator[tuple[str, Path]]:
    """Python files that numbers can depend on, each with its path from the package on."""
    for package in PACKAGES:
        root = Path(str(importlib.resources.files(package)))
        for path in sorted(root.rglob("*.py")):
            name = f"{package}/{path.relative_to(root).as_posix()}"
            if not any(name == other or name.startswith(f"{other}/") for other in NOT_HASHED):
                yield name, path


@functools.cache
def _code(path: Path) -> str:
    """Code of a module without comments, docstrings and layout."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        documented = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if documented and ast.get_docstring(node, clean=False):
            node.body = node.body[1:]
    return ast.dump(tree)


def _hash(parts: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def _json(data: object) -> str:
    """JSON text that restores floats bit for bit; raises ValueError for NaN and infinity."""
    return json.dumps(data, allow_nan=False, sort_keys=True)


# Computing


def _compute(jobs: Sequence[Job], workers: int, stack: contextlib.ExitStack) -> Iterator[_Computed]:
    """Compute jobs; yield each as soon as it is finished."""
    if not jobs:
        return
    calls = (delayed(_execute)(job, digest(job), os.getpid()) for job in jobs)
    with parallel_config("loky", inner_max_num_threads=1):
        done = Parallel(n_jobs=workers, batch_size=1, return_as="generator_unordered")(calls)
    stack.callback(done.close)
    try:
        with warnings.catch_warnings():  # loky may replace a worker at any time
            warnings.filterwarnings("ignore", message="A worker stopped", category=UserWarning)
            yield from done
    except BrokenExecutor as error:
        raise JobError(f"a worker process died, perhaps out of memory: {error}") from None


def _execute(job: Job, expected: str, parent: int) -> _Computed:
    """Run a job in a worker, or in the process `parent`; return an error as a traceback."""
    if parent != os.getpid():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent
    wall, cpu = time.perf_counter(), time.thread_time()
    text = error = ""
    try:
        if digest(job) != expected:
            raise RuntimeError("the sources have changed since the run began")
        text = _json(job.function(**job.arguments))
    except Exception:
        error = traceback.format_exc()
    wall, cpu = time.perf_counter() - wall, time.thread_time() - cpu
    return job, text, error, {"wall": wall, "cpu": cpu, "host": platform.node()}


def _write(job: Job, folder: Path, text: str, times: dict[str, Any]) -> None:
    """Write a result atomically, and log its time."""
    path = job.path(folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    durable_files.replace(path, f'{{"digest": "{digest(job)}", "result": {text}}}\n')
    with (folder / "times.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps({"job": job.name, **times}) + "\n")
