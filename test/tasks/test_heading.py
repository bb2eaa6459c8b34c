# SPDX-License-Identifier: Apache-2.0
"""Movements in any direction about the vertical are learnt as those in the x-z plane."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware_sim.scenes import scene_type
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World
from wam_power_ros import rotations
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import Demonstration, from_joint_samples, from_positions
from wam_power_ros.learning.parametrization import Parametrization, seen_from
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.ball_in_cup.task import BallInCup
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.heading import STEP, forward_of_stroke, forward_of_turn, heading, turned
from wam_power_ros.tasks.task import Task

STEPS = st.integers(-35, 36)  # whole turns have one heading only
KINDS = {Flip: forward_of_turn, BallInCup: forward_of_stroke}


@functools.cache
def demonstrated(kind: type[Task], seed: int = 1) -> Demonstration:
    """A movement of the simulated demonstrator, in the x-z plane."""
    environment = Environment(World(scene_type(kind.name), WorldSettings(), seed))
    script = environment.world.scene.script(np.random.default_rng(seed))
    return from_joint_samples(environment.arm, *environment.demonstrate(script, "taught"))


def about(shown: Demonstration, vector: tuple[float, float, float]) -> Demonstration:
    """A demonstration whose tool moves turned by a rotation vector [rad]."""
    turn, quat = rotations.exp(np.array(vector)), rotations.quat_of_vector(np.array(vector))
    each = {k: getattr(shown, k) @ turn.T for k in ("position", "velocity", "acceleration")}
    quats = rotations.multiply(np.tile(quat, (len(shown.t), 1)), shown.quat_xyzw)
    return replace(shown, **each, quat_xyzw=quats)


def task(kind: type[Task], context: dict[str, float]) -> Task:
    return kind(preset(kind.name).task_settings, context)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=8)
@given(steps=STEPS, aside=st.floats(-0.4, 0.4))
def test_the_heading_is_that_of_the_demonstration_rounded_to_a_step(
    kind: type[Task], steps: int, aside: float
) -> None:
    shown = about(demonstrated(kind), (0.0, 0.0, (steps + aside) * STEP))
    found = kind.context_of([shown], None)["heading"]
    assert math.cos(found - steps * STEP) == pytest.approx(1.0)


def assert_same(found: Policy, expected: Policy) -> None:
    for name in ("stiffness", "attractors", "rotation_attractors"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=5)
@given(steps=STEPS, seed=st.integers(0, 1000))
def test_exploration_of_a_turned_movement_is_the_turned_exploration(
    kind: type[Task], steps: int, seed: int
) -> None:
    angle, policy = steps * STEP, kind.policy_of([demonstrated(kind)], "shown")
    plain = task(kind, {}).parametrization(policy)
    other: Parametrization = task(kind, {"heading": angle}).parametrization(
        seen_from(policy, -angle)
    )
    np.testing.assert_allclose(other.theta0, plain.theta0, atol=1e-9)
    np.testing.assert_allclose(other.scale, plain.scale, atol=1e-9)
    z = 3.0 * np.random.default_rng(seed).standard_normal(plain.size)
    drawn, clipped = other.policy(z, "a")
    np.testing.assert_allclose(clipped, plain.clip(z), atol=1e-6)
    assert_same(seen_from(drawn, angle), plain.policy(z, "a")[0])
    many = other.arrays(z[np.newaxis])
    np.testing.assert_allclose(many.attractors[0], drawn.attractors, atol=1e-9)


def test_a_rollout_in_any_direction_has_the_same_return_and_errors() -> None:
    environment = Environment(World(scene_type("flip"), WorldSettings(), 3))
    policy = Flip.policy_of([demonstrated(Flip)], "shown")
    rollout, truth = environment.run(policy)
    assert truth["tossed"]
    expected = task(Flip, {}).assess(policy, rollout)
    for angle in (-2.0, math.pi):
        other = task(Flip, {"heading": angle})
        found = other.assess(policy, turned(rollout, -angle))
        assert found.ret == pytest.approx(expected.ret, abs=1e-6)
        error = other.error(found.observation)
        np.testing.assert_allclose(error, task(Flip, {}).error(expected.observation), atol=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_demonstrations_in_different_directions_are_refused(kind: type[Task]) -> None:
    shown, aside = demonstrated(kind), about(demonstrated(kind), (0.0, 0.0, math.radians(70.0)))
    with pytest.raises(ValueError, match="directions of 0, 70 degrees"):
        kind.context_of([shown, aside], None)
    opposite = about(shown, (0.0, 0.0, math.pi))
    with pytest.raises(ValueError, match="more than 30 apart"):
        kind.context_of([shown, shown, opposite], None)


def test_a_tool_that_turns_about_an_axis_far_from_level_is_refused() -> None:
    with pytest.raises(ValueError, match="40 degrees from the horizontal"):
        heading([about(demonstrated(Flip), (math.radians(40.0), 0.0, 0.0))], forward_of_turn)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_swing_is_towards_where_its_last_stroke_comes_from_however_far_it_drew_back(
    sign: float,
) -> None:
    t = np.linspace(0.0, 1.0, 251)[:, np.newaxis]
    drawn, stroke = 0.5 - 0.5 * np.cos(np.pi * np.minimum(t / 0.6, 1.0)), np.maximum(t - 0.6, 0.0)
    x = drawn - 0.6 * (0.5 - 0.5 * np.cos(np.pi * stroke / 0.4))  # 1 m one way, 0.6 m the other
    shown = from_positions(sign * x * [1.0, 0.0, 0.0], 0.004)
    np.testing.assert_allclose(forward_of_stroke(shown), [sign, 0.0, 0.0], atol=1e-9)


def test_a_swing_in_no_plane_is_refused() -> None:
    shown = demonstrated(BallInCup)
    round_about = shown.velocity + np.roll(shown.velocity[:, [1, 0, 2]], 200, axis=0)
    with pytest.raises(ValueError, match="across its plane"):
        heading([replace(shown, velocity=round_about)], forward_of_stroke)
