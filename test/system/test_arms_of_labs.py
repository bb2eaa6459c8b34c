# SPDX-License-Identifier: Apache-2.0
"""Set-ups of the arms that labs own: complete, and rehearsed over DDS with a driver's shape."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import ROOT, Processes
from test_session_over_dds import ended, wam_power

from hardware_sim.scenes.reach import reach
from hardware_sim.settings import ArmSimParams
from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning import policy as policies
from wam_power_ros.params import overlay
from wam_power_ros.params.torque_controller_params import TorqueControllerParams

ARMS = {"ur": 6, "franka": 7, "openarm": 7, "gen3": 7, "xarm7": 7}
WAMS = ("geodude", "libbarrett")


@pytest.mark.parametrize("arm", [*ARMS, *WAMS])
def test_a_set_up_of_an_arm_is_complete_and_its_reach_lies_within_its_limits(arm: str) -> None:
    setup = overlay.setup([arm], simulated=True, task="reach")
    params, driver = TorqueControllerParams.from_setup(setup), ArmSimParams.from_setup(setup)
    text = (ROOT / f"config/{arm}.yaml").read_text()
    own = yaml.safe_load(text)["/**/torque_controller"]["ros__parameters"]
    assert {"joint_names", "driver_compensates_gravity", "torque_share"} <= own.keys()
    assert driver.driver_compensates_gravity == params.driver_compensates_gravity
    if arm in ARMS:
        assert {"urdf", "guarded_links", "plane", "workspace_max", "base_frame"} <= own.keys()
        assert (driver.watchdog, driver.deactivates, driver.drives) == (False, True, "direct")
        assert f"docs/arms/{arm}.md" in text
    assert "JointGroupEffortController" not in text
    model = setup.arm()
    assert model is not None and model.n == ARMS.get(arm, 7)
    assert 0.3 < params.torque_share * model.tau_max.min()
    if driver.drives == "wam":  # its scene knows where it begins
        return
    q = np.array(driver.home)
    position, rotation = model.tool_pose(q)
    assert rotation[2, 2] > 0.999  # a level pan
    region = params.region
    assert region is not None
    script = reach(np.random.default_rng(0), driver.goal, spread=0.0)
    path = np.array([script.target(t, position, rotation).position for t in np.arange(0, 3, 0.02)])
    assert np.linalg.norm(path - region.centre, axis=1).min() < 0.3 * region.radius  # in the way
    # A larger one is rarely passed by chance: exploration displaces a path by a share of its way.
    assert 0.15 < region.radius / np.linalg.norm(path[-1] - path[0]) < 0.19
    for end in path[[0, -1]]:
        assert np.linalg.norm(end - region.centre) > 1.5 * region.radius
    assert np.all((params.workspace_min < path) & (path < params.workspace_max))
    for point in path:  # inverse kinematics with a constant orientation
        for _ in range(5):
            found = model.tool_pose(q)
            turn = [0.5 * np.cross(found[1][:, i], rotation[:, i]) for i in range(3)]
            error = np.concatenate([point - found[0], np.sum(turn, axis=0)])
            q = q + np.linalg.pinv(model.jacobian(q), rcond=1e-3) @ error
        assert np.linalg.norm(point - model.tool_pose(q)[0]) < 0.002
        assert np.all((model.q_min + 0.05 < q) & (q < model.q_max - 0.05))
        assert np.all(np.abs(model.gravity(q)) < 0.8 * params.torque_share * model.tau_max)


@pytest.mark.long
def test_a_ur_is_taught_and_learns_to_reach_over_dds(tmp_path: Path) -> None:
    lockstep = tmp_path / "lockstep.yaml"
    fewer = "learner: {ros__parameters: {changes: '{\"retests\": 1}'}}"
    lockstep.write_text(f"wam_sim: {{ros__parameters: {{pace: lockstep}}}}\n{fewer}\n")
    words = ("learn", "--task", "reach", "--demonstrations", "1", "--trials", "2", "--session", "s")
    simulated = ("--config", "ur", "--config", str(lockstep), "--simulate")
    status, output = ended(wam_power(tmp_path, *words, *simulated))
    assert status == 0, output
    rows = [json.loads(line) for line in (tmp_path / "s/rollouts.jsonl").read_text().splitlines()]
    assert [row["kind"] for row in rows[:2]] == ["reproduction", "explore"]
    assert all(len(row["truth"]["peak_qd"]) == 6 and row["ret"] > 0.0 for row in rows)
    (_, _, cdr), *_ = Bag(tmp_path / "s/bags" / rows[0]["bag"]).messages([layout.STATES])
    state = layout.decoded(cdr, layout.JOINT_STATE)
    assert list(state.name) == sorted(state.name)
    assert np.abs(state.effort).max() < 4.0  # [A]; g(q) is up to 27 N m here
    best = policies.from_json((tmp_path / "s/policy.json").read_text())
    (row,) = [row for row in rows if row["id"] == best.id]
    rollout, truth = Environment.from_setup(overlay.read(tmp_path / "s/logs/parameters.yaml")).run(
        best
    )
    assert rollout.fault is None and truth == row["truth"]  # as in one process


def test_check_driver_of_a_ur_by_positions_asks_for_no_torque_and_for_a_reach_for_no_camera(
    processes: Processes, tmp_path: Path
) -> None:
    (external := tmp_path / "external.yaml").write_text(
        "torque_controller: {ros__parameters: {effort: external}}"
    )
    names, file = ["ur", "position", str(external)], tmp_path / "setup.yaml"
    file.write_text(overlay.text(overlay.setup(names, simulated=True, task="reach")))
    command = [sys.executable, "-m", "wam_power_ros.cli", "run"]
    sim = processes.start([*command, "wam_sim", "--ros-args", "--params-file", str(file)])
    end = time.monotonic() + 60.0
    while "the arm, held by its driver" not in processes.output(sim) and time.monotonic() < end:
        time.sleep(0.1)
    given = [word for name in names for word in ("--config", name)]
    answers = ("--task", "reach", "--seconds", "2", "--active", "--json")
    rows_file = tmp_path / "rows.json"
    check = processes.start([*command, "check_driver", *given, *answers, str(rows_file)])
    assert check.wait(120) == 0, processes.output(check)
    rows = {row["name"]: row for row in json.loads(rows_file.read_text())["rows"]}
    assert rows["torque order"]["verdict"] == "ok"
    assert rows["torque order"]["found"].endswith("as position")
    assert "positions are sent" in rows["watchdog"]["found"]
    assert "without gravity" in rows["gravity"]["found"]
    assert rows["gravity"]["verdict"] == "not checked"
    assert not [name for name in rows if "mocap" in name]
