# SPDX-License-Identifier: Apache-2.0
"""The movement of the commissioning on the stand-in, stopped by Ctrl-C."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.long
def test_ctrl_c_stops_the_arm_and_the_movement_can_begin_anew(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "wam_power_ros.cli", "commission", "--folder", str(tmp_path)]
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    lines = []
    for line in process.stdout:
        lines.append(line)
        if "the end of" in line:
            process.send_signal(signal.SIGINT)
    said = "".join(lines)
    assert process.wait(120.0) == 130, said
    assert "Replaying the commissioning" in said
    assert "Stopped: the arm holds." in said
    assert not (tmp_path / "movement.npz").exists()
    assert not (tmp_path / "arm.yaml").exists()
