# SPDX-License-Identifier: Apache-2.0
"""Arms and bodies that differ from their models, for a laboratory, a session or a rollout."""

from __future__ import annotations

import numpy as np
import pytest

from hardware_sim.hidden_arm import drawn
from hardware_sim.scenes import scene_type
from hardware_sim.scenes.markers import MOUNTED, Markers
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World

LAB = WorldSettings(unknown="lab")


def world(seed: int = 0, scene: str = "reach", **settings: object) -> World:
    return World(scene_type(scene), WorldSettings(unknown="lab", **settings), seed)


def test_the_encoders_report_angles_with_zeros() -> None:
    lab = world()
    posture = lab.home
    lab.reset("zeros", posture)
    assert np.allclose(lab.joint_state().q, posture, atol=1e-3)
    assert np.allclose(lab.joint_state().q - lab._q, lab.hidden.zeros, atol=1e-3)


def test_the_same_seed_draws_the_same_arm_and_another_seed_another_one() -> None:
    arms = [drawn(LAB, seed)[1] for seed in (3, 3, 4)]
    for name in ("payload", "links", "friction", "motors", "zeros", "geometry"):
        same, again, _ = (np.asarray(getattr(arm, name)) for arm in arms)
        assert same.tobytes() == again.tobytes(), name
    assert arms[0].payload != arms[2].payload


def test_masses_friction_and_gravity_of_the_physics_are_those_of_the_arm() -> None:
    lab, nominal = world(), World(scene_type("reach"), WorldSettings(), 0)
    hidden = lab.hidden
    for number in range(1, 7):
        link = nominal.model.body(f"wam_link{number}").id
        share = lab.model.body_mass[link] / nominal.model.body_mass[link]
        assert share == pytest.approx(hidden.links[number - 1])
    pan = nominal.model.body("pan").id
    assert lab.model.body_mass[pan] - nominal.model.body_mass[pan] == pytest.approx(hidden.payload)
    ratio = lab.model.dof_frictionloss[:7] / nominal.model.dof_frictionloss[:7]
    assert np.all(np.abs(ratio / hidden.friction - 1.0) < 0.5)  # a rollout varies it, too
    assert np.linalg.norm(lab.model.opt.gravity) == pytest.approx(9.81)
    tilt = np.arccos(-lab.model.opt.gravity[2] / 9.81)
    assert tilt == pytest.approx(np.deg2rad(1.0), rel=0.01)


def test_markers_on_the_tool_are_seen_where_the_tool_is() -> None:
    lab = World(Markers, WorldSettings(), 0)
    for _ in range(60):
        lab.step(lab.arm.gravity(lab.joint_state().q))
    frames = lab.mocap_frames()
    position, rotation = lab.tool_pose
    expected = position + rotation @ MOUNTED[0]
    assert frames
    assert np.linalg.norm(frames[-1].position - expected) < 0.005


# Of a session or of a rollout

SEEDS = range(100)
UNKNOWN = WorldSettings(unknown="session")


def test_unknown_settings_fill_their_ranges_and_the_others_stay() -> None:
    plain = WorldSettings(unknown="session", wind_sd=0.2, body_offset_sd=0.001)
    worlds, arms = zip(*(drawn(plain, seed) for seed in SEEDS), strict=True)
    for values, low, high in (
        ([w.body_mass for w in worlds], 0.7, 1.3),
        ([w.body_size for w in worlds], 0.8, 1.2),
        ([w.friction for w in worlds], 0.1, 0.5),
        ([c for a in arms for c in a.motors], 0.95, 1.05),
        ([a.payload for a in arms], 0.0, 0.12),
    ):
        assert low <= min(values) < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < max(values) <= high
    assert {w.command_delay_ticks for w in worlds} == {1, 2, 3, 4}  # 2 to 8 ms
    assert {(w.wind_sd, w.body_offset_sd) for w in worlds} == {(0.2, 0.001)}
