# SPDX-License-Identifier: Apache-2.0
"""Sessions over DDS, every node a process: to the end, interrupted, and killed.

What they must have learnt is what the bench learns in one process.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, Probe, Process, Processes, python_path
from diagnostic_msgs.msg import DiagnosticArray

from hardware_sim.scenes import scene_type
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World
from wam_power_ros.bags import layout, reader
from wam_power_ros.control.arm import Arm
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.dmp import fit
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros.diagnostics import LEARNER_STATE
from wam_power_ros.tasks.flip.settings import FLIP_FIT

SEED = 43
TAUGHT = min((ROOT / "bags").glob("demo_*"))
JOINTS = [f"wam_j{i}" for i in range(1, 8)]
# A learner that plans would simulate its plans again at every start.
SETTINGS = preset("flip", "hindsight", budget=2, retests=1)
ROLLOUTS = ["trial-0001", "trial-0002"]  # a reproduction, an exploration; then a re-test


def wam_power(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start the command line in a folder, in a terminal of its own and without a film."""
    return subprocess.Popen(
        [sys.executable, "-m", "wam_power_ros.cli", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": python_path(), "MUJOCO_GL": "disable"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def ended(process: subprocess.Popen[str], deadline: float = 180.0) -> tuple[int, str]:
    """Exit status and output."""
    try:
        output, _ = process.communicate(timeout=deadline)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
        pytest.fail(f"not ended within {deadline} s: {process.communicate(timeout=60.0)[0]}")
    return process.returncode, output


def lines(folder: Path) -> list[bytes]:
    log = folder / "rollouts.jsonl"
    return log.read_bytes().splitlines(keepends=True) if log.exists() else []


def learnt(rows: list[bytes] | list[str]) -> list[dict[str, Any]]:
    """Records without the wall clock, and without the bag, whose name may have been taken."""
    records = [json.loads(row) for row in rows]
    return [{key: row[key] for key in row if key not in ("clock", "bag")} for row in records]


def children(process: subprocess.Popen[str]) -> list[int]:
    listed = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
    return [int(pid) for pid in listed.split()]


def fitted(bag: Path) -> Policy:
    arm = Arm((ROOT / "urdf/wam7.urdf").read_text(), JOINTS)
    stamps_ns, q = reader.read_demonstration(bag, JOINTS)
    return fit([from_joint_samples(arm, stamps_ns, q)], FLIP_FIT, "demonstration-1")


@pytest.fixture(scope="module")
def candidate() -> Policy:
    return fitted(TAUGHT)


@pytest.fixture(scope="module")
def expected(candidate: Policy) -> list[dict[str, Any]]:
    """What the same session learns in one process."""
    bench = Environment(World(scene_type("flip"), WorldSettings(), SEED))
    practice = Practice(SETTINGS, {}, [candidate], SEED, bench)
    return learnt([record.to_json() for record in bench.practise(practice)])


def begin(folder: Path, candidate: Policy) -> Path:
    Session.begin(folder, SETTINGS, SEED, [candidate]).close()
    return folder


SIM = {"use_sim_time": True}


def arm_and_controller(processes: Processes) -> Process:
    """Start the arm in lockstep and its controller; returns the latter."""
    given = {"wam_sim:pace": "lockstep", "wam_sim:seed": SEED}
    processes.node("hardware_sim.main", "wam_sim.yaml", **given)
    files = "torque_controller.yaml", "simulation.yaml"
    node = "wam_power_ros.nodes.torque_controller"
    return processes.node(node, *files, **SIM, move_speed=1.0)


def all_but_the_learner(processes: Processes, folder: Path) -> Process:
    """Start the nodes of a session; returns the controller."""
    controller = arm_and_controller(processes)
    processes.node("wam_power_ros.nodes.body_tracker", "pancake_tracker.yaml", **SIM)
    recorder = "demonstration_recorder"
    directory = {"directory": folder / "bags"}
    files = f"{recorder}.yaml", "simulation.yaml"
    processes.node(f"wam_power_ros.nodes.{recorder}", *files, **SIM, **directory)
    return controller


def learner(processes: Processes, folder: Path, **given: object) -> Process:
    node = "wam_power_ros.nodes.learner"
    return processes.node(node, "learner.yaml", "simulation.yaml", **SIM, session=folder, **given)


def states_of_the_learner(reports: list[DiagnosticArray]) -> list[str]:
    """What the learner has said of its session, in order."""
    found = [each for report in reports for each in report.status]
    values = [v for each in found if each.name == "learner: session" for v in each.values]
    return [value.value for value in values if value.key == LEARNER_STATE]


@pytest.mark.requirement("S-67")
def test_answers_that_do_not_come_cost_a_session_time_and_nothing_else(
    probe: Probe,
    processes: Processes,
    candidate: Policy,
    expected: list[dict[str, Any]],
    tmp_path: Path,
) -> None:
    folder = begin(tmp_path / "session", candidate)
    controller = all_but_the_learner(processes, folder)
    learning = learner(processes, folder)

    def begins(rollout: str) -> None:
        recording = layout.unfinished(folder / "bags" / f"rollout_{rollout}")
        end = time.monotonic() + 120.0
        while not recording.exists() and time.monotonic() < end:
            time.sleep(2e-4)  # the rollout is requested some milliseconds later
        assert recording.exists()

    begins(ROLLOUTS[0])  # and what answers for the controller forgets it
    children = Path(f"/proc/{controller.pid}/task/{controller.pid}/children").read_text()
    os.kill(int(children.split()[-1]), signal.SIGKILL)
    again = lambda: "is started again" in processes.output(learning)  # noqa: E731
    probe.until(again, "a new start", 180.0)
    begins(ROLLOUTS[1])  # and its answer comes late
    controller.send_signal(signal.SIGSTOP)
    time.sleep(5.0)
    controller.send_signal(signal.SIGCONT)
    probe.until(lambda: learning.poll() is not None, "the end of the session", 120.0)
    assert learning.returncode == 0, processes.output(learning)
    assert learnt(lines(folder)) == expected
