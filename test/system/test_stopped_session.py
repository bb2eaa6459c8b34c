# SPDX-License-Identifier: Apache-2.0
"""A person stops a session over DDS: nothing moves until Continue, whatever is killed."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from conftest import ACTIONS, Probe, Processes
from std_srvs.srv import SetBool, Trigger
from test_session_over_dds import (
    SEED,
    TAUGHT,
    all_but_the_learner,
    fitted,
    learner,
    learnt,
    states_of_the_learner,
)
from toss_task import practice_of

from hardware_sim.scenes import scene_type
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World
from wam_power_interfaces.srv import Pause
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface

# A learner that plans would simulate its plans again at every start.
SETTINGS = preset("flip", "hindsight", budget=3, retests=0)
FREE = SetBool.Request(data=True)
STOP = Trigger, interface.STOP, None
TAKE = SetBool, interface.GRAVITY_COMPENSATION, FREE
ENDS = (("move_to_start", TAKE), ("execute", STOP))
QUIET = 0.5  # [s of wall time]


@pytest.mark.requirement("S-128")
def test_nothing_moves_after_a_stop_until_a_person_continues_and_kill_9_changes_nothing(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    folder, candidate = tmp_path / "session", fitted(TAUGHT)
    Session.begin(folder, SETTINGS, SEED, [candidate]).close()
    all_but_the_learner(processes, folder)
    begun: list[str] = []  # what the controller has begun
    for do, (kind, name) in ACTIONS.items():
        probe.node.create_subscription(
            kind.Impl.FeedbackMessage,
            f"{name}/_action/feedback",
            lambda _, do=do: begun.append(do),
            10,
        )
    reports = probe.diagnostics()

    def paused() -> bool:
        return states_of_the_learner(reports)[-1:] == ["paused"]

    def lets_go_on() -> bool:
        """Continue; the request may go to the killed learner, or the session not be there."""
        request = Pause.Request(pause=False)
        try:
            return probe.call(Pause, interface.LEARNER_PAUSE, request, deadline=10.0).success
        except pytest.fail.Exception:
            return False

    running = learner(processes, folder)
    probe.until(lambda: read(folder).records, "a first rollout", 300.0)

    def stays(before: int) -> None:
        """A learner that is started anew is paused, and lets nothing move until Continue."""
        nonlocal running
        del reports[:]
        running = learner(processes, folder)
        probe.until(paused, "the pause of the resumed session", 120.0)
        probe.spin(QUIET)
        assert begun[before:] == []
        probe.until(lets_go_on, "the session to go on", 120.0)

    for do, (kind, service, given) in ENDS:
        before = len(begun)
        probe.until(lambda: do in begun[before:], do, 300.0)  # noqa: B023
        probe.call(kind, service, given)
        before = len(begun)
        probe.until(paused, "the pause", 60.0)
        probe.spin(QUIET)
        assert begun[before:] == []
        if do == "move_to_start":
            del reports[:]
            probe.until(lets_go_on, "the session to go on", 120.0)
    assert processes.end(running, signal.SIGKILL) == -signal.SIGKILL
    stays(before)

    # A stop while no learner runs is one of the session that is resumed.
    before = len(begun)
    probe.until(lambda: begun[before:], "a movement", 300.0)
    assert processes.end(running, signal.SIGKILL) == -signal.SIGKILL
    assert probe.call(*STOP).success
    stays(len(begun))
    probe.until(lambda: running.poll() is not None, "the end of the session", 300.0)
    assert running.returncode == 0, processes.output(running)

    # The same in one process, without pauses: the policies that were stopped have run there once.
    records = read(folder).records
    assert sum(record.refused for record in records) == 1
    ran = [tuple(record.z) for record in records]
    assert len(set(ran)) == len(ran)
    bench = Environment(World(scene_type("flip"), WorldSettings(), SEED))
    practice = practice_of([candidate], SETTINGS, SEED, arm=bench)
    while (trial := practice.next_trial()) is not None:
        if (record := records[trial.number - 1]).refused:
            practice.refuse(trial, record.fault)
        else:
            rollout, truth = bench.run(trial.policy)
            practice.learn(trial, rollout, truth=truth)
    undisturbed = [record.to_json() for record in practice.records]
    assert learnt(undisturbed) == learnt([record.to_json() for record in records])
