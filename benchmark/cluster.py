# SPDX-License-Identifier: Apache-2.0
"""The quick reproduction here and on a Dask cluster of two worker processes: the same files?

    python -m benchmark.cluster --only reaching

Scheduler and workers are processes of their own, as they would be on other machines.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DEADLINE = 600.0  # [s] for the scheduler to be there
WORKERS = 2


@contextmanager
def local_cluster(folder: Path, path: str = str(ROOT)) -> Iterator[str]:
    """Address of a Dask scheduler with `WORKERS` workers, each a process; ended on leaving.

    Args:
        folder: where they work and log.
        path: their PYTHONPATH.

    Raises:
        TimeoutError: no scheduler within `DEADLINE`; with what it said.
    """
    environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    told = folder / "dask.log"
    with ExitStack() as stack, told.open("wb") as log:

        def start(*command: str) -> None:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *command, "--no-dashboard"],
                env=environment,
                cwd=folder,
                stdout=log,
                stderr=log,
            )
            stack.callback(process.wait)
            stack.callback(process.kill)

        start("scheduler", "--host", "127.0.0.1", "--port", "0")
        end = time.monotonic() + DEADLINE
        while not (found := re.search(r"tcp://127\.0\.0\.1:\d+", told.read_text())):
            if time.monotonic() > end:
                raise TimeoutError(told.read_text())
            time.sleep(0.05)
        alone = ("--nthreads", "1", "--no-nanny", "--local-directory", ".")
        for _ in range(WORKERS):
            start("worker", found.group(), *alone)
        yield found.group()


def main() -> int:
    """Run both, compare, tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="STUDY", help="of these studies alone")
    only = parser.parse_args().only
    arguments = ["--quick", *(["--only", *only] if only else [])]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as name, local_cluster(Path(name)) as address:
        folder = Path(name)
        for place, option in (("cluster", ["--scheduler", address]), ("here", [])):
            began = time.monotonic()
            command = [sys.executable, "-m", "wam_power_ros.cli", "reproduce", *arguments, *option]
            subprocess.run(
                [*command, "--folder", str(folder / place)],
                env=environment,
                check=True,
                stdout=subprocess.DEVNULL,
            )
            sys.stdout.write(f"{place:8s} {time.monotonic() - began:.0f} s\n")
        cluster, here = (_files(folder / place / "results") for place in ("cluster", "here"))
    differing = [name for name in cluster | here if cluster.get(name) != here.get(name)]
    sys.stdout.write(f"{len(here)} results, {len(differing)} of them differ: {differing}\n")
    return int(bool(differing))


def _files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.json")}


if __name__ == "__main__":
    sys.exit(main())
