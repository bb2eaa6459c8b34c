# SPDX-License-Identifier: Apache-2.0
"""Many independent runs spread over cores or machines, each kept in a file as soon as it is done.

A study is a list of jobs. What is in its folder already is not computed again, so one that was
interrupted goes on, and ends with the numbers it would have had: a job knows nothing of the
others, of their order, or of how many run at a time.

    pancake-default/seed-301.json      {"digest": ..., "result": {...}}
    times.jsonl                        a line a computed job: wall and processor time, where

A result is used only if its digest fits: of the job's function and arguments, the Python sources
that function depends on (found by their imports, without comments and docstrings), the files under
config/, urdf/ and bags/ if these sources can read them, and the versions of the numerical
libraries. Modules that only tell (`TELLING`, and every `*_chapter.py`) do not count: words and
figures can be changed without computing anything again.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import re
import signal
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed, parallel_config
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from wam_power_ros.params.resources import share

TELLING = {
    "chapters",
    "cli",
    "figures",
    "film",
    "page",
    "report",
    "reproduce",
    "studies",
    "study_figures",
}
OURS = ("wam_power_ros", "hardware_sim")
NUMERICAL = ("numpy", "scipy", "pin", "mujoco", "cmaes")  # their versions move last digits
DATA = ("config", "urdf", "bags")
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
CLUSTER_TIMEOUT = 120.0  # [s]
Results = dict[str, dict[str, dict[str, Any]]]  # study -> key -> result


@dataclass(frozen=True)
class Job:
    """One run of a study.

    Attributes:
        study: Folder it is kept in, such as "pancake-default".
        key: Its name there, such as "seed-301".
        function: Of a module that can be imported; the same arguments give the same result, in
            plain JSON data of finite numbers.
        arguments: By name, plain JSON data.

    Raises:
        ValueError: A name that is no file name, or arguments that are not plain finite JSON data.
    """

    study: str
    key: str
    function: Callable[..., dict[str, Any]]
    arguments: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in (self.study, self.key):
            if not NAME.fullmatch(name):
                raise ValueError(f"{name!r} is no name of a file: letters, digits, '.', '_', '-'")
        try:
            _json(self.arguments)
        except (TypeError, ValueError) as error:
            raise ValueError(f"arguments of {self.name}: {error}") from None

    @property
    def name(self) -> str:
        """Study and key."""
        return f"{self.study}/{self.key}"


class JobError(Exception):
    """Some jobs could not be done; the message names each of them and says why."""


@dataclass(frozen=True)
class _Done:
    """What a worker hands back: a result as JSON, or what went wrong."""

    place: int  # of the job
    digest: str
    text: str
    error: str
    wall: float  # [s]
    cpu: float  # [s]
    host: str


def run(
    jobs: Sequence[Job],
    folder: Path,
    workers: int = 1,
    scheduler: str | None = None,
    console: Console | None = None,
) -> Results:
    """Results of all jobs; those that are not in the folder yet are computed and put there.

    Ctrl-C (KeyboardInterrupt) and errors lose nothing that was finished.

    Args:
        jobs: No two of one study and key.
        folder: Of the results; made if it is not there.
        workers: Processes of this machine.
        scheduler: Address of a Dask scheduler; its workers compute then, not this machine. They
            need the same sources and libraries, and OMP_NUM_THREADS=1 as Dask's nannies set it.
        console: For progress, standard error if omitted.

    Returns:
        Study -> key -> result, in the order of `jobs`, each as it was read from JSON.

    Raises:
        JobError: Some jobs failed; the others were done and kept.
        ValueError: Two jobs of one name, workers < 1, or `scheduler` without Dask.
    """
    twice = [name for name, count in Counter(job.name for job in jobs).items() if count > 1]
    if twice:
        raise ValueError(f"two jobs of one name: {', '.join(twice)}")
    if workers < 1:
        raise ValueError(f"workers = {workers} must be at least 1")
    console = console or Console(stderr=True)
    results = found(jobs, folder)
    stale = sum(_path(folder, job).exists() for job in jobs) - len(results)
    if stale:
        console.print(f"{stale} results of other sources, arguments or versions are not used.")
    if results:
        console.print(f"{len(results)} of {len(jobs)} results are there already.")
    failed: list[str] = []
    with _progress(jobs, results, console) as advance, contextlib.ExitStack() as stack:
        left = [job for job in jobs if job.name not in results]
        for done in _computed(left, workers, scheduler, stack):
            job = left[done.place]
            if done.error:
                failed.append(f"{job.name}: {done.error}")
            else:
                _write(_path(folder, job), done.digest, done.text)
                _note(folder, job, done)
                results[job.name] = json.loads(done.text)
            advance(job)
    if failed:
        raise JobError(f"{len(failed)} of {len(jobs)} jobs failed.\n" + "\n".join(failed))
    ordered: Results = {}
    for job in jobs:
        ordered.setdefault(job.study, {})[job.key] = results[job.name]
    return ordered


def found(jobs: Sequence[Job], folder: Path) -> dict[str, dict[str, Any]]:
    """Results that are in the folder and may be used, by the names of their jobs."""
    read = {job.name: _read(_path(folder, job), job) for job in jobs}
    return {name: result for name, result in read.items() if result is not None}


def spent(jobs: Sequence[Job], folder: Path) -> tuple[float, float]:
    """Sums of wall and processor time [s] it took to compute these jobs, whenever that was."""
    times = {}
    with contextlib.suppress(FileNotFoundError):
        for line in (folder / "times.jsonl").read_text().splitlines():
            with contextlib.suppress(ValueError, KeyError):  # a line cut off by a power failure
                note = json.loads(line)
                times[note["job"]] = (note["wall"], note["cpu"])
    known = [times[job.name] for job in jobs if job.name in times]
    return sum(wall for wall, _ in known), sum(cpu for _, cpu in known)


def digest(job: Job) -> str:
    """Of all that a result depends on, see the module."""
    function = job.function
    parts = [function.__module__, function.__qualname__, _json(job.arguments)]
    return _hash([*parts, sources(function.__module__)])


@functools.cache
def sources(module: str) -> str:
    """Digest of a module, of ours it imports, and of the data and libraries these may use.

    Raises:
        ValueError: There is no such module to import.
    """
    files: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in files or (path := _file(name)) is None:
            continue
        files[name] = path
        waiting += [other for other in _imports(path) if _counts(other)]
    if module not in files:
        raise ValueError(f"a job's function is in {module!r}, which cannot be imported")
    parts = [platform.python_version()]
    parts += [f"{name} {_version(name)}" for name in NUMERICAL]
    parts += [f"{name}: {_code(path)}" for name, path in sorted(files.items())]
    if "wam_power_ros.params.resources" in files:
        for top in DATA:
            parts += [
                f"{path.relative_to(share(top))}: {hashlib.sha256(path.read_bytes()).hexdigest()}"
                for path in sorted(share(top).rglob("*"))
                if path.is_file()
            ]
    return _hash(parts)


def _counts(name: str) -> bool:
    """Whether a name may be a module of ours that results depend on."""
    root, _, _ = name.partition(".")
    last = name.rpartition(".")[2]
    return root in OURS and last not in TELLING and not last.endswith("_chapter")


def _file(name: str) -> Path | None:
    """Source of a module, which is not imported for it; None when the name is something else."""
    root, *rest = name.split(".")
    if root == "__main__" or (spec := importlib.util.find_spec(root)) is None:
        return None
    if spec.origin is None or not spec.origin.endswith(".py"):
        return None
    if not rest:
        return Path(spec.origin)
    within = Path(spec.origin).parent.joinpath(*rest)
    places = (within.with_name(f"{within.name}.py"), within / "__init__.py")
    return next((path for path in places if path.is_file()), None)


def _imports(path: Path) -> Iterator[str]:
    """Names a module imports, anywhere in it, and the packages they are in."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            parts = name.split(".")
            yield from (".".join(parts[: k + 1]) for k in range(len(parts)))


def _code(path: Path) -> str:
    """A module's code, whatever its comments, docstrings and layout."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(
            node, clean=False
        ):
            node.body = node.body[1:]
    return ast.dump(tree)


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:  # ROS brings some under other names
        return "?"


def _hash(parts: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def _json(data: object) -> str:
    """Floats come back bit for bit; NaN and infinity are no JSON."""
    return json.dumps(data, allow_nan=False, sort_keys=True)


# Computing


def _computed(
    jobs: Sequence[Job], workers: int, scheduler: str | None, stack: contextlib.ExitStack
) -> Iterator[_Done]:
    """Compute jobs, each handed out as soon as it is finished."""
    if not jobs:
        return
    here = None
    if scheduler is None:
        config = parallel_config("loky", inner_max_num_threads=1)
        here = os.getpid()
    else:
        config = parallel_config("dask", client=stack.enter_context(_cluster(scheduler)))
        workers = -1  # all that the cluster has
    calls = (delayed(_execute)(place, job, digest(job), here) for place, job in enumerate(jobs))
    with config:
        done = Parallel(n_jobs=workers, batch_size=1, return_as="generator_unordered")(calls)
    stack.callback(done.close)
    try:
        with warnings.catch_warnings():  # of a worker that loky replaces, as it may at any time
            warnings.filterwarnings("ignore", message="A worker stopped", category=UserWarning)
            yield from done
    except BrokenExecutor as error:
        raise JobError(f"a process that computed is gone, out of memory perhaps: {error}") from None


def _cluster(address: str) -> Any:  # noqa: ANN401 (a distributed.Client, if that is installed)
    try:
        from distributed import Client
    except ImportError:
        raise ValueError(
            "a Dask scheduler needs the extra 'cluster': pip install 'wam_power_ros[cluster]'"
        ) from None
    try:
        client = Client(address, timeout=CLUSTER_TIMEOUT)
        client.wait_for_workers(1, timeout=CLUSTER_TIMEOUT)
    except OSError as error:  # TimeoutError is one
        raise ValueError(f"no Dask scheduler with workers at {address!r}: {error}") from None
    return client


def _execute(place: int, job: Job, expected: str, here: int | None) -> _Done:
    """Do a job wherever this is; what goes wrong is handed back, not raised."""
    if here not in (None, os.getpid()):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asked
    began, cpu = time.perf_counter(), time.thread_time()
    text = error = ""
    try:
        if digest(job) != expected:
            raise RuntimeError("the worker has other sources or libraries than this machine")
        if here is None and os.environ.get("OMP_NUM_THREADS") != "1":
            raise RuntimeError("start Dask's workers with OMP_NUM_THREADS=1: last digits need it")
        text = _json(job.function(**job.arguments))
    except Exception:
        error = traceback.format_exc()
    return _Done(
        place,
        expected,
        text,
        error,
        time.perf_counter() - began,
        time.thread_time() - cpu,
        platform.node(),
    )


# Files


def _path(folder: Path, job: Job) -> Path:
    return folder / job.study / f"{job.key}.json"


def _read(path: Path, job: Job) -> dict[str, Any] | None:
    """A result, None when there is none or one of another digest."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        return kept["result"] if kept["digest"] == digest(job) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write(path: Path, digest: str, text: str) -> None:
    """Whole or not at all, whenever this is interrupted."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with part.open("w", encoding="utf-8") as file:
        file.write(f'{{"digest": "{digest}", "result": {text}}}\n')
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def _note(folder: Path, job: Job, done: _Done) -> None:
    note = {"job": job.name, "wall": done.wall, "cpu": done.cpu, "host": done.host}
    with (folder / "times.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(note) + "\n")


@contextlib.contextmanager
def _progress(
    jobs: Sequence[Job], results: dict[str, Any], console: Console
) -> Iterator[Callable[[Job], None]]:
    """Bars of all jobs and of each study under way, on a terminal; a line as a study is done."""
    total = Counter(job.study for job in jobs)
    done = Counter(job.study for job in jobs if job.name in results)
    bars: dict[str, TaskID] = {}
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
        speed_estimate_period=600.0,
    )

    def advance(job: Job) -> None:
        study = job.study
        done[study] += 1
        progress.advance(everything)
        progress.update(bars[study], advance=1, visible=done[study] < total[study])
        if done[study] == total[study]:
            console.print(f"{study}: {total[study]} done", highlight=False)

    with progress:
        everything = progress.add_task("all", total=len(jobs), completed=len(results))
        for study, count in total.items():  # shown from its first result to its last
            bars[study] = progress.add_task(
                f"  {study}", total=count, completed=done[study], visible=False
            )
        yield advance
