# SPDX-License-Identifier: Apache-2.0
"""Pancake in the pan and in the air, ground truth of a toss, and demonstrated toss."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated import CALM, begin, holding_torque, run

from hardware_sim.demonstrator import Demonstrator
from hardware_sim.ground_truth import Truth
from hardware_sim.scenes.flip import HOME, Flip, TossScript, wrist_flick
from hardware_sim.wam import JOINTS, PERIOD
from hardware_sim.world import World
from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm

POSITION, ROTATION = np.array([0.8, 0.0, 0.6]), rotations.exp(np.array([0.0, 0.4, 0.0]))


@pytest.fixture(scope="module")
def calm() -> World:
    return World(Flip, CALM, seed=3)


def test_a_pancake_rests_in_a_level_pan(calm: World) -> None:
    gravity = begin(calm)
    start = calm.data.qpos[7:10] - calm.tool_pose[0]
    run(calm, gravity, 500)
    truth = calm.truth()
    drift = calm.data.qpos[7:10] - calm.tool_pose[0] - start
    assert np.abs(drift).max() < 1e-3
    assert truth["caught"] and not truth["flipped"] and not truth["tossed"]
    assert truth["t_f"] is None
    assert abs(truth["apex"]) < 0.01


def throw(world: World, spin: float, up: float, outward: float = 0.0) -> float:
    """Release the pancake 15 cm above a still pan, with a spin [rad/s] and speeds [m/s].

    Returns:
        Integral of its spin until the landing [rad].
    """
    gravity = begin(world)
    data = world.data
    data.qpos[9] += 0.15
    data.qvel[7:13] = [outward, 0.0, up, 0.0, spin, 0.0]
    angles = [0.0]
    for _ in range(300):
        before = data.qvel[11]
        world.step(gravity)
        angles.append(angles[-1] + 0.5 * PERIOD * (before + data.qvel[11]))
    truth = world.truth()
    return angles[round(truth["t_f"] / PERIOD)] if truth["t_f"] else math.nan


@pytest.mark.parametrize("spin", [-25.0, 18.0])
def test_the_true_angle_is_unwrapped_beyond_half_a_turn(calm: World, spin: float) -> None:
    turned = throw(calm, spin, up=1.5)
    truth = calm.truth()
    assert truth["tossed"]
    assert truth["angle_deg"] == pytest.approx(math.degrees(abs(turned)), abs=1.0)
    assert truth["apex"] == pytest.approx(0.15 + 1.5**2 / 19.62, abs=0.02)


def test_a_pancake_thrown_over_is_caught_on_its_other_side(calm: World) -> None:
    throw(calm, 15.0, up=1.7)
    run(calm, holding_torque(calm), 300)
    truth = calm.truth()
    assert (truth["caught"], truth["flipped"], truth["true_flip"]) == (True, True, True)
    # and from there, without a reset, back again
    calm.release("trial-0002")
    calm.data.qpos[9] += 0.15
    calm.data.qvel[7:13] = [0.0, 0.0, 1.7, 0.0, 15.0, 0.0]
    run(calm, holding_torque(calm), 300)
    assert calm.truth()["true_flip"] and calm.truth()["id"] == "trial-0002"


@pytest.mark.parametrize(
    ("moved", "tilt", "caught"),
    [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((0.04, 0.02, 0.0), math.pi, True),
        ((0.0, 0.0, 0.015), 0.0, False),  # still in the air
        ((0.15, 0.0, 0.0), 0.0, False),  # beside the pan
        ((0.0, 0.0, 0.0), 0.25, False),  # leaning on the rim
    ],
)
def test_caught_is_flat_in_the_pan(
    calm: World, moved: tuple[float, ...], tilt: float, caught: bool
) -> None:
    begin(calm)
    calm.data.qpos[7:10] += moved
    calm.data.qpos[10:14] = [math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0]
    truth = calm.truth()
    assert truth["caught"] == caught
    assert truth["flipped"] == (tilt > 1.0)


# The script


def script(seed: int, spread: float = 1.0, level: bool = False) -> TossScript:
    return wrist_flick(np.random.default_rng(seed), spread, level=level)


def demonstrate(world: World, arm: Arm, seed: int) -> tuple[Truth, np.ndarray]:
    """Ground truth and joint positions of a demonstration under gravity compensation."""
    world.reset(f"demonstration-{seed}", HOME)
    world.release()
    world.attach(Demonstrator(script(seed), *world.tool_pose))
    joints = []
    while world.pulled:
        sample = world.joint_state()
        joints.append(sample.q)
        world.step(arm.gravity(sample.q))
    return world.truth(), np.array(joints)


def test_the_demonstrator_tosses_the_pancake_from_rest_to_rest_within_the_joint_limits() -> None:
    world, angles = World(Flip, seed=1), set()
    arm = Arm(world.urdf, JOINTS)
    for seed in range(3):
        truth, q = demonstrate(world, arm, seed)
        assert truth["tossed"]
        assert 45.0 < truth["angle_deg"] < 270.0
        assert 0.25 < truth["apex"] < 1.0
        angles.add(truth["angle_deg"])
        np.testing.assert_allclose(q[0], HOME, atol=1e-3)
        assert np.abs(q[50] - q[0]).max() < 0.01
        assert np.abs(q[-1] - q[-25]).max() < 0.02
        assert ((arm.q_min < q) & (q < arm.q_max)).all()
        assert np.abs(q[:, [0, 2, 4, 6]]).max() < 0.05  # a planar toss
    assert len(angles) == 3
