# SPDX-License-Identifier: Apache-2.0
"""The soak in short: real time, every node, the recorder on."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmark.soak import Samples, missing

ROOT = Path(__file__).resolve().parents[2]
GROWTH = 0.05  # of the memory of a process; 1 % is for the long soak, when all has been done often


def test_twenty_seconds_in_real_time_lose_no_state_and_let_nothing_grow(tmp_path: Path) -> None:
    report = tmp_path / "soak.json"
    command = [sys.executable, "-m", "benchmark.soak", "--seconds", "12", "--every", "0.5"]
    done = subprocess.run(
        [*command, "--json", str(report)], cwd=ROOT, capture_output=True, text=True, timeout=900
    )
    assert report.exists(), done.stdout + done.stderr  # its status is that of a long soak's bounds
    figures = json.loads(report.read_text())
    assert figures["states"] > 1000, done.stdout
    assert figures["lost"] == 0, done.stdout
    assert figures["done"]["rollouts"] >= 2 and figures["done"]["demonstrations"] >= 1
    for name, row in figures["processes"].items():
        assert row["growth"] < GROWTH, (name, done.stdout)
        assert row["descriptors change"] == 0, (name, done.stdout)


def test_every_state_that_is_not_in_the_bag_is_counted() -> None:
    stamps_ns = np.arange(0, 1000)
    published = [(100, 99), (400, 399), (700, 699), (1000, 999)]  # said by the stand-in
    assert missing(stamps_ns, published) == (0, 900)
    assert missing(np.delete(stamps_ns, [200, 201, 650]), published) == (3, 900)


def test_a_descriptor_that_stays_open_is_a_leak_and_one_of_a_moment_is_none() -> None:
    def change(*files: int) -> float:
        samples = Samples(list(np.linspace(0.0, 1.0, len(files))), [1] * len(files), list(files))
        return samples.figures()["descriptors change"]

    assert change(*[20] * 10, *[20, 21, 20, 22], *[20] * 6) == 0
    assert change(*[20] * 14, *[21] * 6) == 0  # that may still be closed
    assert change(*[20] * 8, *[21] * 12) == 1
    assert change(*range(20, 40)) > 5
