# SPDX-License-Identifier: Apache-2.0
"""A person's part in a session over DDS: its services on a running learner, killed and resumed."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, Probe, Processes
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import Path as PathMessage
from std_srvs.srv import SetBool, Trigger
from test_session_over_dds import (
    SEED,
    TAUGHT,
    all_but_the_learner,
    fitted,
    learner,
    learnt,
    lines,
    states_of_the_learner,
)
from toss_task import practice_of

from hardware_sim.scenes import scene_type
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World
from wam_power_interfaces.msg import GroundTruth
from wam_power_interfaces.srv import AddDemonstration, Pause
from wam_power_ros.bags import layout
from wam_power_ros.cli.plan import DOMAIN_FILE
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.practice import session_log
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.session_log import NewDemonstration, Record
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface, pose_messages

LATER = sorted((ROOT / "bags").glob("demo_*"))[1]
SETTINGS = preset("flip", "hindsight", budget=3, retests=0)


def leave_behind(probe: Probe) -> None:
    """What a killed learner may leave: a path and a truth of the trial under way, a recording."""
    left_path = probe.publisher(PathMessage, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
    topic = interface.body_topic("pancake", "truth")
    left_truth = probe.node.create_publisher(GroundTruth, topic, interface.LATCHED)
    level = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    path = EndEffectorPath("trial-0001", np.array([0.0, 0.01]), np.zeros((2, 3)), level)
    left_path.publish(pose_messages.path_message(path, 2_000_000, "wam_base"))
    long_ago = pose_messages.TruthReading("trial-0001", 8_000_000, {"caught": "long ago"})
    left_truth.publish(pose_messages.ground_truth_message(long_ago))
    assert probe.call(SetBool, interface.RECORD, SetBool.Request(data=True)).success


def decoded(bag: Path, topic: str) -> list[Any]:
    with next(bag.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [message for *_, message in reader.iter_decoded_messages(topics=[f"/{topic}"])]


@pytest.mark.long
def test_a_person_rates_and_teaches_a_running_learner_and_kill_9_in_a_rollout_changes_nothing(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    folder, candidate = tmp_path / "session", fitted(TAUGHT)
    Session.begin(folder, SETTINGS, SEED, [candidate]).close()
    all_but_the_learner(processes, folder)
    leave_behind(probe)

    def rollouts() -> list[Record]:
        return [line for line in read(folder).log if isinstance(line, Record)]

    def say(service: str) -> str:
        response = probe.call(Trigger, service, deadline=300.0)
        assert response.success, response
        assert read(folder).log[-1].note == response.message  # on disk before it is answered
        return str(response.message)

    def pause() -> Pause.Response:
        return probe.call(Pause, interface.LEARNER_PAUSE, Pause.Request(pause=True))

    (folder / "logs").mkdir(exist_ok=True)
    (folder / "logs" / DOMAIN_FILE).write_text(processes.environment["ROS_DOMAIN_ID"])

    def tell(*words: object) -> tuple[int, str]:
        """Exit status and answer of `wam-power feedback`, which knows the session alone."""
        command = [sys.executable, "-m", "wam_power_ros.cli", "feedback", *map(str, words)]
        told = processes.start([*command, "--session", str(folder)], ROS_DOMAIN_ID="")
        probe.until(lambda: told.poll() is not None, "an answer", 300.0)
        return told.returncode, processes.output(told)

    reports = probe.diagnostics()

    killed = learner(processes, folder)
    recording = layout.unfinished(folder / "bags" / "rollout_trial-0001")
    probe.until(recording.exists, "a recording", 120.0)
    probe.spin(float(np.random.default_rng(SEED).uniform(0.1, 0.6)))
    assert processes.end(killed, signal.SIGKILL) == -signal.SIGKILL
    first = learner(processes, folder)
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
    second = learner(processes, folder)
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
    bags = [record.bag for record in rollouts()]
    assert bags == ["rollout_trial-0001_2", "rollout_trial-0002", "rollout_trial-0003"]
    for bag in bags:
        commands = decoded(folder / "bags" / bag, interface.EFFORT_COMMANDS)
        labels = {message.layout.dim[0].label.partition(" ")[2] for message in commands}
        assert f"rollout {bag[8:18]}" in labels
        assert not labels - {"hold", "fault", f"rollout {bag[8:18]}"}  # and no other

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
