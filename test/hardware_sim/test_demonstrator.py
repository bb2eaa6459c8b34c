# SPDX-License-Identifier: Apache-2.0
"""The demonstrating hand: what it wants, how hard it pulls, and that it tosses the pancake."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware_sim.demonstrator import (
    FORCE_MAX,
    MOMENT_MAX,
    PAUSE,
    REACH,
    REACH_GOAL,
    SKILLS,
    Hand,
    HandScript,
    reach,
    wrist_flick,
)
from hardware_sim.world import HOME, JOINTS, Truth, World
from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm

SEEDS = range(6)
POSITION, ROTATION = np.array([0.8, 0.0, 0.6]), rotations.exp(np.array([0.0, 0.4, 0.0]))
STILL = np.zeros(6)
ASIDE = np.array([0.01, 0.0, 0.0])  # [m]


def script(seed: int, spread: float = 1.0) -> HandScript:
    return wrist_flick(np.random.default_rng(seed), spread)


def hand(seed: int = 0) -> Hand:
    return Hand(script(seed), POSITION, ROTATION)


def reaching(seed: int = 0) -> Hand:
    return Hand(reach(np.random.default_rng(seed)), POSITION, ROTATION)


def test_no_two_demonstrations_are_alike_and_the_seed_decides() -> None:
    for one, same, other in zip(
        astuple(script(1)), astuple(script(1)), astuple(script(2)), strict=True
    ):
        np.testing.assert_array_equal(one, same)
        assert (one != other).any()
    for one, other in zip(astuple(script(1, 0.0)), astuple(script(2, 0.0)), strict=True):
        np.testing.assert_array_equal(one, other)  # without scatter, the hand's intention


@given(st.integers(0, 10_000))
def test_every_script_begins_at_rest_where_it_takes_the_pan_and_ends_at_rest(seed: int) -> None:
    drawn = script(seed)
    assert (np.diff(drawn.t) > 0.0).all()
    for values in (
        drawn.wrist[0],
        drawn.pitch[0],
        drawn.wrist_speed[[0, -1]],
        drawn.pitch_rate[-1],
    ):
        assert not np.any(values)
    position, rotation, velocity, omega = Hand(drawn, POSITION, ROTATION).target(0.0)
    np.testing.assert_allclose(position, POSITION, atol=1e-12)
    np.testing.assert_allclose(rotation, ROTATION, atol=1e-12)
    assert not velocity.any()
    assert not omega.any()


def test_the_hand_passes_through_the_keys_of_its_script() -> None:
    puller = hand()
    keys = puller.script
    start = POSITION - REACH * ROTATION[:, 0]  # the wrist
    for k, t in enumerate(keys.t):
        position, rotation, _, omega = puller.target(t)
        wrist = position - REACH * rotation[:, 0] - start
        np.testing.assert_allclose(wrist, [keys.wrist[k, 0], 0.0, keys.wrist[k, 1]], atol=1e-12)
        turned = rotations.log(rotation @ ROTATION.T)
        np.testing.assert_allclose(turned, [0.0, -keys.pitch[k], 0.0], atol=1e-9)  # front edge up
        np.testing.assert_allclose(omega, [0.0, -keys.pitch_rate[k], 0.0], atol=1e-9)


@pytest.mark.parametrize("puller", [hand(3), reaching(3)], ids=["flip", "reach"])
def test_the_wanted_velocities_are_those_of_the_wanted_poses(puller: Hand) -> None:
    small = 1e-6
    for t in np.linspace(0.01, puller.script.end - 0.01, 50):
        before, after = puller.target(t - small), puller.target(t + small)
        _, _, velocity, omega = puller.target(t)
        np.testing.assert_allclose(velocity, (after[0] - before[0]) / (2 * small), atol=1e-5)
        turned = rotations.log(after[1] @ before[1].T)
        np.testing.assert_allclose(omega, turned / (2 * small), atol=1e-5)


def test_the_hand_pulls_towards_what_it_wants_and_no_harder_than_a_person() -> None:
    puller = hand()
    assert not puller.wrench(0.0, POSITION, ROTATION, STILL).any()
    aside = puller.wrench(0.0, POSITION + ASIDE, ROTATION, STILL)
    np.testing.assert_allclose(aside, [-30.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    turned = rotations.exp(np.array([0.0, 0.1, 0.0])) @ ROTATION
    twisted = puller.wrench(0.0, POSITION, turned, STILL)
    np.testing.assert_allclose(twisted, [0.0, 0.0, 0.0, 0.0, -6.0, 0.0], atol=1e-9)
    moving = puller.wrench(0.0, POSITION, ROTATION, np.array([0.1, 0, 0, 0, 0, 1.0]))
    np.testing.assert_allclose(moving, [-12.0, 0.0, 0.0, 0.0, 0.0, -3.0], atol=1e-9)
    torn = puller.wrench(0.0, POSITION + 1.0, rotations.exp(np.ones(3)) @ ROTATION, STILL)
    assert np.linalg.norm(torn[:3]) == pytest.approx(FORCE_MAX)
    assert np.linalg.norm(torn[3:]) == pytest.approx(MOMENT_MAX)


def test_the_hand_lets_go_after_its_script_and_not_with_a_jerk() -> None:
    puller = hand()
    end = puller.script.t[-1]
    position, rotation = puller.target(end)[:2]
    forces = [
        puller.wrench(end + late, position + ASIDE, rotation, STILL)
        for late in (0.0, 0.1, 0.2, 0.299, 0.31)
    ]
    assert [None if f is None else round(-f[0], 1) for f in forces] == [30.0, 20.0, 10.0, 0.1, None]


def demonstrate(world: World, arm: Arm, seed: int) -> tuple[Truth, np.ndarray]:
    """One demonstration on an arm that carries its own weight; its joint positions with it."""
    world.reset(f"demonstration-{seed}", HOME)
    world.release()
    world.attach(Hand(script(seed), *world.pan_pose))
    joints = []
    while world.pulled:
        sample = world.joint_state()
        joints.append(sample.q)
        world.step(arm.gravity(sample.q))
    return world.truth(), np.array(joints)


@pytest.fixture(scope="module")
def demonstrations() -> list[tuple[Truth, np.ndarray]]:
    world = World(seed=1)
    arm = Arm(world.urdf, JOINTS)
    return [demonstrate(world, arm, seed) for seed in SEEDS]


def test_the_hand_tosses_the_pancake(demonstrations: list[tuple[Truth, np.ndarray]]) -> None:
    for truth, _ in demonstrations:
        assert truth.tossed
        assert 45.0 < truth.angle_deg < 270.0
        assert 0.25 < truth.apex < 1.0
    assert len({truth.angle_deg for truth, _ in demonstrations}) == len(SEEDS)


def test_what_the_hand_shows_the_motors_can_do_at_48_volts(
    demonstrations: list[tuple[Truth, np.ndarray]],
) -> None:
    no_load = World().motors.no_load_speed
    for truth, _ in demonstrations:
        assert (np.array(truth.peak_qd) < 0.95 * no_load).all()
        assert not truth.beyond_no_load
        assert truth.saturated == 0.0
        assert truth.peak_forearm_speed < 2.0


def test_a_demonstration_begins_and_ends_at_rest_within_the_joint_limits(
    demonstrations: list[tuple[Truth, np.ndarray]],
) -> None:
    arm = Arm(World().urdf, JOINTS)
    for _, q in demonstrations:
        np.testing.assert_allclose(q[0], HOME, atol=1e-3)
        assert np.abs(q[50] - q[0]).max() < 0.01
        assert np.abs(q[-1] - q[-25]).max() < 0.02
        assert ((arm.q_min < q) & (q < arm.q_max)).all()
        assert np.abs(q[:, [0, 2, 4, 6]]).max() < 0.05  # a planar toss


@given(st.integers(0, 10_000))
def test_every_reach_goes_from_rest_to_rest_in_an_arc_and_keeps_the_pan_as_it_was(
    seed: int,
) -> None:
    puller = reaching(seed)
    script = puller.script
    for t, place in ((0.0, POSITION), (PAUSE, POSITION), (script.end, script.goal)):
        position, rotation, velocity, omega = puller.target(t)
        np.testing.assert_allclose(position, place, atol=1e-12)
        np.testing.assert_array_equal(rotation, ROTATION)
        np.testing.assert_allclose(velocity, 0.0, atol=1e-12)
        assert not omega.any()
    times = np.linspace(PAUSE, script.end, 201)
    height = np.array([puller.target(t).position for t in times])[:, 2]
    assert (height - np.linspace(height[0], height[-1], 201)).max() > 0.0
    again = reach(np.random.default_rng(seed))
    assert again.duration == script.duration != reach(np.random.default_rng(seed + 1)).duration


def test_an_arm_led_by_a_reaching_hand_comes_where_the_hand_wants_within_its_limits() -> None:
    world, skill = World(seed=1), SKILLS["reach"]
    arm = Arm(world.urdf, JOINTS)
    start, _ = arm.tool_pose(skill.home)
    assert np.linalg.norm(REACH_GOAL - start) == pytest.approx(0.5, abs=0.01)
    world.reset("demonstration-0", skill.home)
    world.release()
    world.attach(Hand(reach(np.random.default_rng(0), spread=0.0), *world.pan_pose))
    joints, tilt = [], []
    while world.pulled:
        sample = world.joint_state()
        joints.append(sample.q)
        tilt.append(world.pan_pose[1][2, 2])
        world.step(arm.gravity(sample.q))
    end, truth, q = world.pan_pose[0], world.truth(), np.array(joints)
    assert np.linalg.norm(end - REACH_GOAL) < 0.03
    assert min(tilt) > np.cos(np.deg2rad(8.0))
    assert truth.caught  # the pancake has stayed in the pan
    assert not truth.flipped
    assert truth.peak_forearm_speed < 1.0  # what the safety board allows by default [m/s]
    assert ((arm.q_min + 0.3 < q) & (q < arm.q_max - 0.3)).all()
