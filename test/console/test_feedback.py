# SPDX-License-Identifier: Apache-2.0
"""Feedback of a person on the command line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from conftest import python_path
from std_srvs.srv import Trigger
from toss_task import demonstrated_policy

from wam_power_ros.cli.plan import DOMAIN_FILE
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface

if TYPE_CHECKING:
    from conftest import Probe


def test_an_arm_is_stopped_from_the_command_line_while_no_learner_runs(
    probe: Probe, domain_id: int, tmp_path: Path
) -> None:
    stopped: list[bool] = []

    def stop(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        stopped.append(True)
        response.success = True
        return response

    probe.node.create_service(Trigger, interface.STOP, stop)
    Session.begin(tmp_path / "session", preset("flip"), 0, [demonstrated_policy()]).close()
    (tmp_path / "session/logs").mkdir()
    (tmp_path / "session/logs" / DOMAIN_FILE).write_text(str(domain_id))
    command = [sys.executable, "-m", "wam_power_ros.cli", "stop", "--session", "session"]
    path = {**os.environ, "PYTHONPATH": python_path()}
    given = subprocess.Popen(command, cwd=tmp_path, env=path)
    probe.until(lambda: given.poll() is not None, "the end of the command", 60.0)
    assert given.returncode == 0 and stopped == [True]
