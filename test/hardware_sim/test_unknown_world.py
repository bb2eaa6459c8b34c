# SPDX-License-Identifier: Apache-2.0
"""Unknown worlds: drawn from the seed, effective in the physics, absent from the URDF."""

from __future__ import annotations

import pytest
from simulated import begin, holding_torque, run

from hardware_sim.hidden_arm import HiddenArm, drawn
from hardware_sim.scenes.flip import MASS, Flip
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World

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


def test_an_unknown_world_has_the_drawn_properties_but_its_urdf_has_not() -> None:
    world, known = World(Flip, UNKNOWN, 5), World(Flip, seed=5)
    hidden, arm = drawn(UNKNOWN, 5)
    pan, pancake = (world.model.body(name) for name in ("pan", "pancake"))
    assert pan.mass - known.model.body("pan").mass == pytest.approx(arm.payload)
    share = pancake.mass / known.model.body("pancake").mass
    assert share == pytest.approx(hidden.body_mass)
    sizes = world.model.geom("pancake").size / known.model.geom("pancake").size.clip(1e-9)
    assert sizes[:2] == pytest.approx([hidden.body_size, 1.0])
    assert world.model.geom("pancake").friction[0] == pytest.approx(hidden.friction)
    assert world.settings.command_delay_ticks == hidden.command_delay_ticks
    assert world.urdf == known.urdf


def test_a_payload_does_not_change_the_drag_model() -> None:
    known = World(Flip, seed=5).model
    hidden = World(Flip, seed=5, hidden=HiddenArm(payload=0.1)).model
    assert (known.geom_fluid == hidden.geom_fluid).all()
    drag = known.geom_fluid[known.geom("pancake").id]
    assert drag[:4].all() and not drag[4:].any()  # no lift, no added mass


def test_a_session_has_one_world_or_each_rollout_its_own() -> None:
    for unknown, count in (("session", 1), ("rollout", 3)):
        world = World(Flip, WorldSettings(unknown=unknown), 7)
        seen = []
        for rollout_id in ("a", "b", "c", "a"):
            world.reset(rollout_id, world.scene.home)
            settings, pancake = world.settings, world.model.body("pancake")
            assert pancake.mass[0] == pytest.approx(MASS * settings.body_mass)
            seen.append(settings)
        assert seen[0] == seen[-1]
        assert len(set(seen)) == count


def test_a_rollout_in_a_world_of_its_own_does_not_depend_on_those_before_it() -> None:
    ends = []
    for before in ((), ("a", "b")):
        world = World(Flip, WorldSettings(unknown="rollout"), 7)
        for rollout_id in before:
            begin(world, rollout_id)
            run(world, holding_torque(world), 20)
        begin(world, "c")
        run(world, holding_torque(world), 100)
        ends.append([*world.data.qpos, *world.joint_state().q])
    assert ends[0] == ends[1]
