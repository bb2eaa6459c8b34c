# SPDX-License-Identifier: Apache-2.0
"""An arm of six joints, by URDF and YAML alone: taught, replayed and learnt with in simulation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_session_over_dds import ended, wam_power

from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning import policy as policies
from wam_power_ros.params import overlay

SIX = Path(__file__).parent / "six_joints/six.yaml"
SIMULATED = ("--config", str(SIX), "--simulate")


def done(folder: Path, *arguments: str) -> str:
    status, output = ended(wam_power(folder, *arguments))
    assert status == 0, output
    return output


@pytest.mark.long
def test_an_arm_of_six_joints_teaches_and_replays(tmp_path: Path) -> None:
    done(
        tmp_path,
        *("teach", "--demonstrations", "1", "--folder", "taught", "--task", "reach"),
        *SIMULATED,
    )
    (bag,) = (tmp_path / "taught/bags").iterdir()
    (_, _, cdr), *_ = Bag(bag).messages([layout.STATES])
    assert len(layout.decoded(cdr, layout.JOINT_STATE).name) == 6
    assert "tool: rms" in done(tmp_path, "replay", str(bag), "--folder", "r", *SIMULATED)


@pytest.mark.long
def test_an_arm_of_six_joints_learns_reach_and_its_rollouts_are_those_of_one_process(
    tmp_path: Path,
) -> None:
    done(
        tmp_path,
        *("learn", "--task", "reach", "--seed", "3", "--demonstrations", "1"),
        *("--trials", "2", "--session", "s"),
        *SIMULATED,
    )
    session = tmp_path / "s"
    rows = [json.loads(line) for line in (session / "rollouts.jsonl").read_text().splitlines()]
    assert [row["kind"] for row in rows[:2]] == ["reproduction", "explore"]
    assert all(len(row["truth"]["peak_qd"]) == 6 and row["ret"] > 0.0 for row in rows)
    best = policies.from_json((session / "policy.json").read_text())
    (row,) = [row for row in rows if row["id"] == best.id]
    setup = overlay.read(session / "logs/parameters.yaml").changed({"wam_sim": {"seed": 3}})
    rollout, truth = Environment.of(setup).run(best)
    assert rollout.fault is None
    assert truth == row["truth"]
    assert np.linalg.norm(rollout.tool.position[-1] - [0.676, 0.25, 0.216]) < 0.3
    assert "Ground truth" in (session / "report.html").read_text()
