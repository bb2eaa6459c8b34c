# SPDX-License-Identifier: Apache-2.0
"""Two arms in two namespaces of one graph learn side by side, each in its own simulation."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from conftest import ROOT, Probe, Process, Processes
from diagnostic_msgs.msg import DiagnosticArray

from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.cli import ros_launch
from wam_power_ros.ros import interface

BAGS = " ".join(str(bag) for bag in sorted((ROOT / "bags").glob("reach_*")))
ARGUMENTS = {name: default for name, (default, _) in ros_launch.SHARED_ARGUMENTS.items()}
ARGUMENTS |= {"config": "", "pace": "lockstep", "task": "reach", "demonstrations": BAGS}
PATIENCE = 300.0  # [s of wall time]
ARMS = {"left": 5, "right": 6}  # namespace -> seed


def start(processes: Processes, plan: ros_launch.LaunchPlan) -> Process:
    """The processes that a launch file would start; returns the learner."""
    file = ros_launch.parameter_file(plan)
    remaps = [("__ns", plan.namespace), *plan.remappings]
    for name in plan.executables:
        command = [sys.executable, "-m", "wam_power_ros.cli", "run", name, "--ros-args"]
        command += ["--params-file", str(file)]
        command += [word for old, new in remaps for word in ("-r", f"{old}:={new}")]
        process = processes.start(command)
    return process


def test_two_arms_in_two_namespaces_learn_side_by_side(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    heard = probe.listen(DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS)
    learners = {}
    for name, seed in ARMS.items():
        given = {"namespace": name, "session": str(tmp_path / name), "seed": str(seed)}
        plan = ros_launch.prepare({**ARGUMENTS, **given, "trials": "2"}, stand_ins=True)
        plan.setup["learner"]["changes"] = json.dumps({"retests": 1})
        learners[name] = start(processes, plan)
    for name, learner in learners.items():
        probe.until(lambda ended=learner: ended.poll() is not None, f"the {name} session", PATIENCE)
        assert learner.returncode == 0, processes.output(learner)
    explored = []
    for name in ARMS:
        lines = (tmp_path / name / "rollouts.jsonl").read_text().splitlines()
        explored.append([json.loads(line)["ret"] for line in lines])
        assert len(explored[-1]) == 3  # a reproduction, an exploration, a re-test
        bag = Bag(tmp_path / name / "bags/rollout_trial-0002")
        assert {topic.split("/")[1] for topic in bag.topics} == {name, "recorder"}
        (path,) = bag.messages([f"/{name}/rollout/end_effector"])
        frame = layout.TYPES.deserialize_cdr(path[2], "nav_msgs/msg/Path").header.frame_id
        assert frame == f"{name}/wam_base"
    assert not set(explored[0]) & set(explored[1])  # each seed its own
    said = {status.name for message in heard for status in message.status}
    assert {f"{name}/torque_controller: loop" for name in ARMS} <= said
