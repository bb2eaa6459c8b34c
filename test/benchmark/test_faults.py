# SPDX-License-Identifier: Apache-2.0
"""The benchmark of faults in short: what it repeats thousands of times, a few times here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark.fuzz import bombard
from benchmark.lab import new_controller
from benchmark.nodes import taught

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.requirement("S-01", "S-123")
@pytest.mark.parametrize("seed", [0, 1])
def test_fuzzed_messages_give_no_torque_over_a_limit(seed: int) -> None:
    controller = new_controller()
    found = bombard(controller, taught(), 4000, seed)
    assert found["torques"] > 3000 and found["refused"] > 50
    assert found["not finite"] == found["over"] == found["rate"] == 0
    assert controller.counters["faults"] > 1  # there was something to get wrong


@pytest.mark.requirement("S-53")
def test_a_cut_network_is_a_fault_that_stays_when_it_is_back(tmp_path: Path) -> None:
    if subprocess.run(
        ["unshare", "-n", "ip", "link", "show", "lo"], capture_output=True
    ).returncode:
        pytest.skip("no network namespace for us here")
    report = tmp_path / "row.json"
    command = [sys.executable, "-m", "benchmark.faults", "--rows", "network", "--repeats", "1"]
    done = subprocess.run(
        [*command, "--json", str(report)], cwd=ROOT, capture_output=True, text=True, timeout=180
    )
    assert done.returncode == 0, (done.stdout, done.stderr)
    assert [row["requirement"] for row in json.loads(report.read_text())] == ["S-53"]
