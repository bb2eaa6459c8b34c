# SPDX-License-Identifier: Apache-2.0
"""Compare the quick reproduction on this machine with one on a Dask cluster, file by file.

    python -m benchmark.cluster --only reaching

Scheduler and workers are separate processes, as they would be on other machines.
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

from benchmark.nodes import ROOT

START_TIMEOUT = 600.0  # [s]
WORKERS = 2
PATH = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))


@contextmanager
def local_cluster(folder: Path, path: str = PATH) -> Iterator[str]:
    """Start a Dask scheduler and `WORKERS` workers as processes; yield the scheduler's address.

    Args:
        folder: Working directory, also of the log.
        path: PYTHONPATH of the processes.

    Raises:
        TimeoutError: If no scheduler starts within `START_TIMEOUT`; contains its output.
    """
    environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    output = folder / "dask.log"
    with ExitStack() as stack, output.open("wb") as log:

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
        end = time.monotonic() + START_TIMEOUT
        while not (found := re.search(r"tcp://127\.0\.0\.1:\d+", output.read_text())):
            if time.monotonic() > end:
                raise TimeoutError(output.read_text())
            time.sleep(0.05)
        alone = ("--nthreads", "1", "--no-nanny", "--local-directory", ".")
        for _ in range(WORKERS):
            start("worker", found.group(), *alone)
        yield found.group()


def main() -> int:
    """Run both, compare them and print the result; return 1 if they differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="STUDY", help="only these studies")
    only = parser.parse_args().only
    arguments = ["--quick", *(["--only", *only] if only else [])]
    environment = os.environ | {"PYTHONPATH": PATH, "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as name, local_cluster(Path(name)) as address:
        folder = Path(name)
        for place, option in (("cluster", ["--scheduler", address]), ("here", [])):
            began = time.monotonic()
            command = [sys.executable, "-m", "reproduction", *arguments, *option]
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
