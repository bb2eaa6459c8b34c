# SPDX-License-Identifier: Apache-2.0
"""A session over DDS of a movement that a person alone judges; without any camera."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from conftest import Probe, Process, Processes, lift
from test_session_over_dds import arm_and_controller, learner, states_of_the_learner

from wam_power_interfaces.srv import Rate
from wam_power_ros.cli.plan import DOMAIN_FILE
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface

SETTINGS = preset("rated", budget=2, retests=0)


@pytest.mark.long
def test_a_session_waits_for_a_persons_rating_of_each_rollout_and_learns_from_it(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    folder = tmp_path / "session"
    Session.begin(folder, SETTINGS, 5, [lift("demonstration-1")]).close()
    (folder / "logs").mkdir()
    (folder / "logs" / DOMAIN_FILE).write_text(processes.environment["ROS_DOMAIN_ID"])
    arm_and_controller(processes)
    reports = probe.diagnostics()

    def started() -> Process:
        return learner(processes, folder, record_rollouts=False, scene_reset=False)

    def wait() -> None:
        del reports[:]
        waits = lambda: states_of_the_learner(reports)[-1:] == ["rate"]  # noqa: E731
        probe.until(waits, "a rollout to rate", 300.0)

    def rollouts() -> list[Record]:
        return [line for line in read(folder).log if isinstance(line, Record)]

    def rate(value: float) -> Rate.Response:
        return probe.call(Rate, interface.LEARNER_RATE, Rate.Request(value=value), deadline=300.0)

    first = started()
    wait()
    for wrong in (-0.1, 1.5, float("nan")):
        assert not rate(wrong).success
    assert rollouts() == []
    assert processes.end(first, signal.SIGKILL) == -signal.SIGKILL
    probe.spin(1.0)  # what the first has said comes in, before the next is listened to
    again = started()
    wait()
    assert rate(0.25).success
    probe.until(lambda: len(rollouts()) == 1, "the first on record", 300.0)
    wait()
    command = [sys.executable, "-m", "wam_power_ros.cli", "feedback", "rate", "9"]
    told = processes.start([*command, "--session", str(folder)], ROS_DOMAIN_ID="")
    probe.until(lambda: told.poll() is not None, "an answer", 300.0)
    assert told.returncode == 0, processes.output(told)
    probe.until(lambda: again.poll() is not None, "the end of the session", 300.0)
    records = rollouts()
    assert [record.ret for record in records] == [0.25, 1.0]
    assert [record.success for record in records] == [False, True]
    assert all(record.learnt for record in records)
    assert read(folder).task.outcome(records[1]) == "rated 1"
