# SPDX-License-Identifier: Apache-2.0
"""Two arms in two namespaces of one graph learn side by side, each in its own simulation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import ROOT, Probe, Processes

from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.cli.launcher import Devices
from wam_power_ros.cli.plan import LEARNER, Plan
from wam_power_ros.cli.session_options import SessionOptions, learner_parameters
from wam_power_ros.params import overlay

BAGS = sorted((ROOT / "bags").glob("reach_*"))
PATIENCE = 300.0  # [s of wall time]
ARMS = {"left": 5, "right": 6}  # namespace -> seed


@pytest.mark.long
def test_two_arms_in_two_namespaces_learn_side_by_side(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    heard = probe.diagnostics()
    learners = {}
    for name, seed in ARMS.items():
        folder, asked = tmp_path / name, SessionOptions("reach", trials=2, bags=BAGS)
        setup = Devices().parameters("reach", seed, folder)
        given = learner_parameters(folder, asked, seed, "reach")
        setup = setup.changed({LEARNER: given | {"changes": json.dumps({"retests": 0})}})
        plan = Plan(folder, setup, stand_ins=True, also=(LEARNER,))
        plan.file.parent.mkdir(parents=True)
        plan.file.write_text(overlay.text(setup))
        inside = ["-r", f"__ns:=/{name}", "-r", f"/clock:=/{name}/clock"]
        for node in plan.nodes:
            learners[name] = processes.start([*plan.command(node, False), *inside])  # the last one
    for name, learner in learners.items():
        probe.until(lambda ended=learner: ended.poll() is not None, f"the {name} session", PATIENCE)
        assert learner.returncode == 0, processes.output(learner)
    explored = []
    for name in ARMS:
        lines = (tmp_path / name / "rollouts.jsonl").read_text().splitlines()
        explored.append([json.loads(line)["ret"] for line in lines])
        assert len(explored[-1]) == 2  # a reproduction, an exploration
        bag = Bag(tmp_path / name / "bags/rollout_trial-0002")
        assert {topic.split("/")[1] for topic in bag.topics} == {name, "recorder"}
        (path,) = bag.messages([f"/{name}/rollout/end_effector"])
        frame = layout.TYPES.deserialize_cdr(path[2], "nav_msgs/msg/Path").header.frame_id
        assert frame == f"{name}/wam_base"
    assert not set(explored[0]) & set(explored[1])  # each seed its own
    said = {status.name for message in heard for status in message.status}
    assert {f"{name}/torque_controller: loop" for name in ARMS} <= said
