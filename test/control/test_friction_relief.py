# SPDX-License-Identifier: Apache-2.0
"""Friction that is taken off while a person guides the arm."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware_sim.scenes import scene_type
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.safety import RELIEF_SPEED, friction_relief
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.params import overlay

speeds = st.lists(st.floats(-5.0, 5.0), min_size=7, max_size=7).map(np.array)
FRICTION = np.array([2.7, 2.5, 1.5, 1.1, 0.4, 0.4, 0.1])
DAMPING = 0.5 * FRICTION


@pytest.mark.requirement("S-127")
@given(speeds, st.floats(-0.5, 0.5))
def test_friction_is_taken_off_moving_joints_alone_and_never_all_of_it(
    qd: np.ndarray, asymmetry: float
) -> None:
    uneven = np.full(7, asymmetry)
    relief = friction_relief(FRICTION, uneven, DAMPING, qd)
    still = np.abs(qd) <= RELIEF_SPEED
    assert not relief[still].any()
    assert np.all(relief * qd >= 0.0)  # along the motion
    smaller = (1.0 - abs(asymmetry)) * FRICTION  # of both directions
    assert np.all(np.abs(relief) <= smaller + DAMPING * np.abs(qd))
    faster = friction_relief(FRICTION, uneven, DAMPING, 2.0 * qd)
    assert np.all(np.abs(faster) >= np.abs(relief))


@pytest.mark.requirement("S-127")
def test_more_than_80_percent_of_the_friction_is_refused() -> None:
    assert ControllerSettings(teaching_friction=0.8).teaching_friction == 0.8
    with pytest.raises(ValueError, match="teaching_friction"):
        ControllerSettings(teaching_friction=0.81)


def guided(share: float, force: float) -> tuple[float, float]:
    """Way of the tool [m] while the elbow is pushed [N] aside for 0.3 s, and in 2 s after that."""
    setup = overlay.setup().changed(
        {"torque_controller": {"teaching_friction": share, "coulomb_friction": FRICTION.tolist()}}
    )
    world = World(scene_type("reach"), WorldSettings(), 0)
    arm = Environment(world, setup=setup)
    arm.place("relief-quiet", world.home)
    for _ in range(100):
        arm.tick()
    arm.controller.set_gravity_compensation(True)
    world.release()
    places = [world.tool_pose[0]]
    for push, ticks in ((force, 150), (0.0, 1000)):
        world.data.xfrc_applied[world.model.body("wam_link4").id, 1] = push
        for _ in range(ticks):
            arm.tick()
        places.append(world.tool_pose[0])
    assert arm.controller.latched is None
    begun, pushed, ended = places
    return float(np.linalg.norm(pushed - begun)), float(np.linalg.norm(ended - pushed))


@pytest.mark.requirement("S-127")
def test_an_arm_whose_friction_is_taken_off_stays_where_it_is_left() -> None:
    assert max(guided(0.8, 0.0)) < 1e-3
    (pushed, ran_on), (without, _) = guided(0.6, 10.0), guided(0.0, 10.0)
    assert pushed > 1.5 * without > 0.0  # with the same force
    assert ran_on < 0.1
