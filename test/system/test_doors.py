# SPDX-License-Identifier: Apache-2.0
"""The commands of the tutorial run in order, as a person types them.

A session is interrupted after a rollout, and goes on where it is named again. Commands of a lab are
in `test_hardware_guide`, those of README in `test_pip`.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, Processes
from test_hardware_guide import CLI, found, interrupted_learning

from wam_power_ros.cli import main

BESIDE = ("view", "feedback", "stop", "learn --task rated")  # second terminals; asks a person
PATIENCE = 560.0  # [s] for a command, on a busy machine


def commands(page: str) -> list[str]:
    """Lines of a page that are typed one after another, without those of a checkout's make."""
    blocks = re.findall(r"^```bash\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines()]
    return [
        line for line in lines if re.match(rf"python -c|wam-power (?!{'|'.join(BESIDE)})", line)
    ]


def test_the_commands_of_a_researcher_are_commands() -> None:
    lines = commands("docs/research.md")
    assert len(lines) == 2
    for line in lines:
        assert main._parser().parse_args(line.split()[1:]).command


@pytest.mark.long
def test_every_command_of_the_tutorial_runs(processes: Processes, tmp_path: Path) -> None:
    environment = dict(processes.environment)
    del environment["ROS_DOMAIN_ID"]  # wam-power takes a free one for a simulation
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    lines = commands("docs/tutorial.md")
    assert len(lines) == 6
    for line in lines:
        if " learn " in line:
            words = [str(path) for word in line.split() for path in found(tmp_path, word)]
            interrupted_learning([*CLI, *words[1:]], tmp_path, environment)
            continue
        ended = subprocess.run(
            ["bash", "-c", line],
            cwd=tmp_path,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        assert ended.returncode == 0, f"{line}\n{ended.stdout}{ended.stderr}"
