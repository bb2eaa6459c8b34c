# SPDX-License-Identifier: Apache-2.0
"""Scene of ball-in-a-cup: a ball on a string, a swing that is caught, and its ground truth."""

from __future__ import annotations

import numpy as np
import pytest

from hardware_sim.ground_truth import Truth
from hardware_sim.scenes.ball_in_cup import SwingScript, swing
from hardware_sim.world import World
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.policy import with_id
from wam_power_ros.params import overlay
from wam_power_ros.tasks.ball_in_cup.swing import RIM, STRING, observe_swing
from wam_power_ros.tasks.ball_in_cup.task import BallInCup

FOREARM = 0.08  # [m] of the string from the axis of the forearm: its radius and a margin
ELBOW, WRIST = "wam_link4", "wam_link6"
SETTLE = 1.0  # [s]


@pytest.fixture(scope="module")
def environment() -> Environment:
    setup = overlay.setup(task="ball_in_cup").changed({"wam_sim": {"seed": 3000}})
    return Environment.from_setup(setup)


def guided(environment: Environment, script: SwingScript) -> tuple[Truth, np.ndarray, np.ndarray]:
    """Guide the arm; ground truth, postures (M, nq), and distance of ball and cup (M,) [m]."""
    world = environment.world
    environment.demonstrate(script, "demonstration-0-quiet")
    for _ in range(world.settings.ticks(SETTLE)):  # held by the controller
        environment.tick()
    rows, truth = world.trace, world.truth()
    tool = np.array([environment.arm.tool_pose(row[:7])[0] for row in rows])
    return truth, rows, np.linalg.norm(rows[:, 7:10] - tool, axis=1)


def test_the_intended_swing_is_caught_on_a_string_that_clears_the_forearm(
    environment: Environment,
) -> None:
    truth, rows, length = guided(environment, swing(np.random.default_rng(0), spread=0.0))
    assert truth["caught"] and truth["distance"] < 0.05 and truth["apex"] > 0.1
    assert truth["saturated"] == 0.0 and truth["peak_elbow_speed"] < 1.5
    assert length.max() < STRING + 0.005
    assert length[0] == pytest.approx(STRING, abs=0.005) and length[-1] < RIM
    assert min(clearances(environment.world, rows)) > FOREARM


def clearances(world: World, rows: np.ndarray) -> list[float]:
    """Distance of the string from the axis between elbow and wrist in each posture [m]."""
    import mujoco

    data, share, found = mujoco.MjData(world.model), np.linspace(0.15, 1.0, 12)[:, None], []
    for row in rows:
        data.qpos[:] = row
        mujoco.mj_kinematics(world.model, data)
        elbow, wrist = (data.body(name).xpos for name in (ELBOW, WRIST))
        string = (1.0 - share) * data.body("cup").xpos + share * data.body("ball").xpos
        axis = wrist - elbow
        along = np.clip((string - elbow) @ axis / (axis @ axis), 0.0, 1.0)
        found.append(float(np.linalg.norm(string - elbow - along[:, None] * axis, axis=1).min()))
    return found


def test_what_the_cameras_see_of_a_swing_is_what_happened(environment: Environment) -> None:
    script = swing(np.random.default_rng([3000, 0]))
    stamps_ns, q = environment.demonstrate(script, "demonstration-0")
    demonstration: Demonstration = BallInCup.demonstration_of(environment.arm, stamps_ns, q)
    policy = BallInCup.policy_of([demonstration], "demonstration-1")
    for number in range(2):
        rollout, truth = environment.run(with_id(policy, f"trial-{number:04d}"))
        assert rollout.fault is None and rollout.body is not None
        seen = observe_swing(rollout.tool, rollout.body)
        assert seen is not None and seen.caught == truth["caught"]
        assert seen.t_c == pytest.approx(truth["t_c"], abs=0.02)
        assert seen.distance == pytest.approx(truth["distance"], abs=0.012)  # truth: upright cup
        assert seen.apex == pytest.approx(truth["apex"], abs=0.015)
