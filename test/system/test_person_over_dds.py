# SPDX-License-Identifier: Apache-2.0
"""A person's part in a session over DDS: its services on a running learner, killed and resumed."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from conftest import ROOT, Probe, Processes
from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import Trigger
from test_session_over_dds import (
    SEED,
    TAUGHT,
    arm_and_controller,
    fitted,
    learner,
    learnt,
    lines,
    states_of_the_learner,
    tracker,
)
from toss_task import practice_of

from hardware_sim.scenes import scene_type
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World
from wam_power_interfaces.srv import AddDemonstration, Pause
from wam_power_ros.cli.plan import DOMAIN_FILE
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.practice import session_log
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.session_log import NewDemonstration, Record
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface

LATER = sorted((ROOT / "bags").glob("demo_*"))[1]
SETTINGS = preset("flip", "hindsight", budget=3, retests=0)


@pytest.mark.long
def test_a_person_rates_and_teaches_a_running_learner_and_kill_9_changes_nothing(
    probe: Probe,
    processes: Processes,
    tmp_path: Path,
) -> None:
    folder, candidate = tmp_path / "session", fitted(TAUGHT)
    Session.begin(folder, SETTINGS, SEED, [candidate]).close()
    arm_and_controller(processes)
    tracker(processes)

    def rollouts() -> list[Record]:
        return [line for line in read(folder).log if isinstance(line, Record)]

    def say(service: str) -> str:
        response = probe.call(Trigger, service, deadline=300.0)
        assert response.success, response
        assert read(folder).log[-1].note == response.message  # on disk before it is answered
        return str(response.message)

    def pause() -> Pause.Response:
        return probe.call(Pause, interface.LEARNER_PAUSE, Pause.Request(pause=True))

    (folder / "logs").mkdir()
    (folder / "logs" / DOMAIN_FILE).write_text(processes.environment["ROS_DOMAIN_ID"])

    def tell(*words: object) -> tuple[int, str]:
        """Exit status and answer of `wam-power feedback`, which knows the session alone."""
        command = [sys.executable, "-m", "wam_power_ros.cli", "feedback", *map(str, words)]
        told = processes.start([*command, "--session", str(folder)], ROS_DOMAIN_ID="")
        probe.until(lambda: told.poll() is not None, "an answer", 300.0)
        return told.returncode, processes.output(told)

    reports = probe.listen(DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS)

    first = learner(processes, folder, record_rollouts=False)
    offered = probe.node.get_service_names_and_types
    probe.until(lambda: f"/{interface.LEARNER_REWARD}" in dict(offered()), "the learner", 300.0)
    refused = probe.call(Trigger, interface.LEARNER_REWARD, deadline=300.0)
    assert not refused.success  # nothing to rate: no rollout yet, or not even a session read
    probe.until(rollouts, "a first rollout", 300.0)
    assert say(interface.LEARNER_REWARD).startswith("trial-0001 rewarded: return ")
    probe.until(lambda: not pause().under_way, "the end of the trial under way", 300.0)
    refused = probe.call(AddDemonstration, interface.ADD_DEMONSTRATION, deadline=300.0)
    assert not refused.success  # it names no bag
    status, answer = tell("demonstration", LATER.parent)  # no bag, but a folder of them
    # the middleware may write lines, too
    assert status == 2 and f"\nrefused: {LATER.parent}" in f"\n{answer}", answer
    status, answer = tell("demonstration", LATER)
    assert status == 0 and str(LATER) in answer, answer
    notes = [line.note for line in read(folder).log if isinstance(line, NewDemonstration)]
    assert notes[-1] in answer.splitlines()  # what it waits for may stand before it
    assert processes.end(first, signal.SIGKILL) == -signal.SIGKILL
    kept = lines(folder)

    probe.spin(1.0)  # what the first has said comes in, before the second is listened to
    del reports[:]
    second = learner(processes, folder, record_rollouts=False)
    probe.until(
        lambda: states_of_the_learner(reports)[-1:] == ["paused"],
        "the pause from before the kill",
        300.0,
    )
    assert lines(folder) == kept and tell("continue")[0] == 0
    probe.until(lambda: second.poll() is not None, "the end of the session", 400.0)
    assert second.returncode == 0, processes.output(second)
    assert lines(folder)[: len(kept)] == kept
    assert "practises" in states_of_the_learner(reports)
    assert "demonstration-2" in [record.demonstration for record in rollouts()]

    # The same in one process, undisturbed: what a person did, at the places the log has it.
    bench = Environment(World(scene_type("flip"), WorldSettings(), SEED))
    practice = practice_of([candidate], SETTINGS, SEED, arm=bench)
    events = [line for line in read(folder).log if not isinstance(line, Record | session_log.Pause)]
    assert len(events) == 2  # a reward, a demonstration
    while (trial := practice.next_trial()) is not None:
        rollout, truth = bench.run(trial.policy)
        practice.learn(trial, rollout, truth=truth)
        for event in events:
            if event.after == trial.number:
                practice.apply(event)
    undisturbed = [line.to_json() for line in practice.log if isinstance(line, Record)]
    assert learnt(undisturbed) == learnt([record.to_json() for record in rollouts()])
