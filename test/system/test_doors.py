# SPDX-License-Identifier: Apache-2.0
"""The commands of the doors of a student and a researcher run in order, as a person types them.

Those of a lab are in `test_hardware_guide`, those of README in `test_pip`.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, Processes

BESIDE = ("view", "feedback", "stop", "learn --task rated")  # second terminals; asks a person
PATIENCE = 560.0  # [s] for a command, on a busy machine


def commands(page: str) -> list[str]:
    """Lines of a page that are typed one after another, without those of a checkout's make."""
    blocks = re.findall(r"^```bash\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines()]
    return [
        line for line in lines if re.match(rf"python -c|wam-power (?!{'|'.join(BESIDE)})", line)
    ]


def test_there_are_commands_to_run() -> None:
    assert len(commands("docs/tutorial.md")) == 6 and len(commands("docs/research.md")) == 2


@pytest.mark.long
@pytest.mark.parametrize("page", ["docs/tutorial.md", "docs/research.md"])
def test_every_command_of_the_door_runs(page: str, processes: Processes, tmp_path: Path) -> None:
    environment = dict(processes.environment)
    del environment["ROS_DOMAIN_ID"]  # wam-power takes a free one for a simulation
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    for line in commands(page):
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
