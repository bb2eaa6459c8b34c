# SPDX-License-Identifier: Apache-2.0
"""Hold of an arm that a fault has stopped."""

import numpy as np
import pytest
from rigid_arm import A_TEST, HOME, MODEL, begin, run, tool

from wam_power_ros.control.fault_hold import FaultHold
from wam_power_ros.control.modes import Mode

BOUND = 2.0 * MODEL.friction + 0.05 * MODEL.tau_max


def test_the_feedback_is_zero_where_the_hold_began_and_never_beyond_its_bound() -> None:
    hold, rng = FaultHold(MODEL), np.random.default_rng(0)
    np.testing.assert_array_equal(hold.torque(HOME), np.zeros(7))
    for _ in range(200):
        away = rng.uniform(-1.0, 1.0, 7)
        torque = hold.torque(HOME + away)
        assert np.all(np.abs(torque) <= BOUND)
    assert np.any(np.abs(hold.torque(HOME - 0.5)) == BOUND)


def test_small_displacements_are_pushed_back() -> None:
    for joint in range(7):
        hold, away = FaultHold(MODEL), 1e-4 * np.eye(7)[joint]
        hold.torque(HOME)
        stiffness = -hold.torque(HOME + away)[joint] / 1e-4
        assert stiffness == pytest.approx(400.0 * MODEL.mass_matrix(HOME)[joint, joint], rel=1e-2)


def test_a_released_hold_begins_where_the_arm_is() -> None:
    hold = FaultHold(MODEL)
    hold.torque(HOME)
    hold.release()
    np.testing.assert_array_equal(hold.torque(HOME + 0.3), np.zeros(7))


@pytest.mark.requirement("S-122")
@pytest.mark.parametrize("torque", [-8.0, 8.0])
@pytest.mark.parametrize("delay", [0, 4])
def test_a_fault_holds_an_arm_whose_model_is_wrong_and_can_be_reset(
    torque: float, delay: int
) -> None:
    """8 N m at joint 2: 0.9 kg at the tool, or a motor that gives 70 %."""
    controller, plant = begin(friction=1.0, delay=delay, sensing=True)
    controller.execute()
    run(controller, plant, 0.3)
    controller.fault(A_TEST)
    plant.push = lambda *_: torque * np.eye(7)[1]
    run(controller, plant, 0.5)
    at = tool(plant)
    run(controller, plant, 5.0)
    assert np.linalg.norm(tool(plant) - at) < 0.05
    controller.reset()
    assert controller.mode is Mode.HOLD


@pytest.mark.requirement("S-122")
def test_the_hold_of_a_fault_waits_until_the_arm_has_been_braked() -> None:
    controller, plant = begin(friction=1.0)
    controller.execute()
    run(controller, plant, 0.33)
    controller.fault(A_TEST)
    at = plant.q.copy()
    run(controller, plant, 1.0)
    assert np.abs(plant.q - at).max() > 0.03  # it does not spring back to where the fault began
    held = plant.q.copy()
    run(controller, plant, 0.5)
    assert np.abs(plant.q - held).max() < 1e-3
