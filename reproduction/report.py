# SPDX-License-Identifier: Apache-2.0
"""Reproduce the paper's results: run every study and write one report of their results.

<folder>/results/<study>/<key>.json      results of the runs, see `jobs`
<folder>/report.html, figures/*.png      the report; rewritten at the end of every call
"""

from __future__ import annotations

import argparse
import os
import platform
import shlex
import signal
import sys
import time
from collections.abc import Collection, Sequence
from itertools import groupby
from pathlib import Path

from markupsafe import Markup

from reproduction import jobs as job_cache
from reproduction.chapter import RUNS_MIN, TEMPLATES, Chapter, table
from reproduction.chapters import flip, reaching
from reproduction.jobs import Job, JobError, Scale
from wam_power_ros import durable_files
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.reporting import html_page

MACHINE = "Machine, versions, seeds, time"  # heading
TEMPLATE = Path(__file__).with_suffix(".html.j2")
STUDIES = {"reaching": reaching.STUDY, "pancake": flip.STUDY}  # in the order of the paper


def run(folder: Path, scale: Scale, workers: int, only: Collection[str] = tuple(STUDIES)) -> Path:
    """Compute the missing results, write the report, print the times; return its path.

    "quick" runs the same code with few seeds and small budgets, as a check.

    Raises:
        JobError: Some runs failed; the results of the others are kept.
        ValueError: The number of workers is below 1.
        KeyboardInterrupt: The user stopped it; finished results are kept.
    """
    start = time.monotonic()
    studies = [study for name, study in STUDIES.items() if name in only]
    jobs_of = [study.jobs(scale) for study in studies]
    jobs = [job for some in jobs_of for job in some]
    results_folder = folder / "results"
    cached = len(job_cache.found(jobs, results_folder))
    results = job_cache.run(jobs, results_folder, workers)
    written = [
        study.chapter({job.study: results[job.study] for job in some})
        for study, some in zip(studies, jobs_of, strict=True)
    ]
    elapsed = time.monotonic() - start
    computer = "one process" if workers == 1 else f"{workers} processes"
    wall, cpu = job_cache.spent(jobs, results_folder)
    timing = (
        f"The {len(jobs)} runs took {duration(cpu)} of processor time, {duration(wall)} one after "
        f"another. This time {cached} of them had been computed before; the rest and the report "
        f"took {duration(elapsed)} with {computer}."
    )
    sys.stdout.write(f"{timing}\n")
    return write(folder, scale, written, jobs, timing)


def write(
    folder: Path, scale: Scale, chapters: Sequence[Chapter], jobs: Sequence[Job], timing: str
) -> Path:
    """Write `report.html` and its figures into a folder with the results of all `jobs`."""
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    for chapter in chapters:
        for name, png in chapter.figures.items():
            (folder / "figures" / f"{name}.png").write_bytes(png)
    path = folder / "report.html"
    durable_files.replace(path, render(scale, chapters, jobs, timing, folder / "results"))
    return path


def render(
    scale: Scale,
    chapters: Sequence[Chapter],
    jobs: Sequence[Job],
    timing: str,
    results_folder: Path,
) -> str:
    """Report as HTML, with computing times from the folder of the results; see `write`."""
    rows = []
    for study in dict.fromkeys(job.study for job in jobs):
        own = [job for job in jobs if job.study == study]
        wall, cpu = job_cache.spent(own, results_folder)
        seeds = ranges({seed for job in own for seed in _seeds(**job.arguments)})
        rows.append([study, str(len(own)), seeds or "–", duration(cpu), duration(wall)])
    judged = [claim for chapter in chapters for claim in chapter.claims if claim.holds is not None]
    body = TEMPLATES.from_string(TEMPLATE.read_text()).render(
        scale=scale,
        chapters=chapters,
        jobs=jobs,
        judged=judged,
        missed=[claim for claim in judged if not claim.holds],
        runs_min=RUNS_MIN,
        cpu=duration(job_cache.spent(jobs, results_folder)[1]),
        machine=MACHINE,
        processor=platform.processor() or platform.machine(),
        cores=os.cpu_count(),
        system=f"{platform.system()} {platform.release()}",
        versions=", ".join(job_cache.versions((*job_cache.LIBRARIES, "joblib"))),
        timing=timing,
        rows=rows,
        table=table,
        anchor=html_page.anchor,
    )
    return html_page.page("Flipping pancakes: the paper reproduced", [Markup(body)])


def _seeds(seed: int | None = None, seeds: Sequence[int] = (), **_: object) -> list[int]:
    """Seeds in the arguments of a job."""
    return [*seeds] if seed is None else [seed, *seeds]


def ranges(numbers: set[int]) -> str:
    """Whole numbers as ranges, such as "1–3, 7"."""
    runs = groupby(enumerate(sorted(numbers)), key=lambda pair: pair[1] - pair[0])
    ends = [(some[0][1], some[-1][1]) for some in (list(run) for _, run in runs)]
    return ", ".join(str(first) if first == last else f"{first}–{last}" for first, last in ends)


def duration(seconds: float) -> str:
    """Duration with its unit, to about two digits."""
    if seconds < 99.5:
        return f"{seconds:.2g} s" if seconds < 9.95 else f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the studies of the paper in simulation and write a report; resume where it stopped."""
    arguments = sys.argv[1:] if arguments is None else [*arguments]
    parser = argparse.ArgumentParser(prog="python -m reproduction", description=main.__doc__)
    parser.add_argument(
        "--folder", type=Path, help="of results and report (default: reproduced, reproduced-quick)"
    )
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count(), help="processes (default: one per core)"
    )
    parser.add_argument("--quick", action="store_true", help="a few seeds only, as a check")
    parser.add_argument("--only", nargs="+", choices=STUDIES, metavar="STUDY", default=[*STUDIES])
    options = parser.parse_args(arguments)
    folder = options.folder or Path("reproduced-quick" if options.quick else "reproduced")
    scale: Scale = "quick" if options.quick else "full"
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        path = run(folder, scale, options.jobs, options.only)
    except KeyboardInterrupt:
        sys.stdout.write(
            f"\nStopped. Finished results are in {folder}. To resume:\n"
            f"  python -m reproduction {shlex.join(arguments)}\n"
        )
        return INTERRUPTED
    except JobError as error:
        sys.stderr.write(f"{error}Finished results are in {folder}.\n")
        return 1
    except (ValueError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(f"Report: {path}\n")
    return 0
