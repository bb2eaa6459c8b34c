# SPDX-License-Identifier: Apache-2.0
"""Torque beyond the model that holds the arm at rest."""

import numpy as np
import pytest
from rigid_arm import HOME, MODEL, begin, make, refusal_of, run

from wam_power_ros.control.modes import ControllerError, Mode, Refusal
from wam_power_ros.control.unexplained_torque import UnexplainedTorque

DT = 0.01  # [s] between two observations
JOINT_2 = np.eye(7)[1]


def test_the_torque_is_known_once_the_arm_has_rested_for_a_tenth_of_a_second() -> None:
    unexplained = UnexplainedTorque(MODEL)
    for rests in ([True] * 9, [False], [True] * 9):
        for at_rest in rests:
            unexplained.observe(at_rest, HOME, 0.0, JOINT_2, DT)
        assert not unexplained.known
    for _ in range(2):
        unexplained.observe(True, HOME, 0.0, JOINT_2, DT)
    assert unexplained.known
    unexplained.begin()
    assert not unexplained.known
    assert not unexplained.torque.any()


def held(*torques: np.ndarray, speed: float = 0.0) -> UnexplainedTorque:
    """An arm at rest at home that is held by torques beyond its model, for 10 ms each."""
    unexplained = UnexplainedTorque(MODEL)
    for torque in torques:
        unexplained.observe(True, HOME, speed * JOINT_2, torque, DT)
    return unexplained


def test_what_friction_may_explain_is_not_compensated_elsewhere() -> None:
    for share, certain in ((0.99, False), (-1.01, True)):
        model_error = share * MODEL.friction
        compensation = held(*[model_error] * 200).compensation
        np.testing.assert_allclose(compensation, model_error * certain, rtol=1e-6)
    for share in (0.009, 0.011):  # rounding errors of the model
        model_error = share * MODEL.friction
        assert held(*[model_error] * 200).teaching_offset(HOME, 0.0).all() == (share > 0.01)


def test_a_guided_arm_starts_with_the_torque_that_held_it_which_fades_with_the_way() -> None:
    unexplained = held(*[JOINT_2] * 200)
    ways = ((0.0, 1.0), (0.025, 0.5), (-0.04, 0.2), (0.051, 0.0), (0.0, 0.0))  # at last forgotten
    for way, share in ways:
        given = unexplained.teaching_offset(HOME + way * np.eye(7)[3], 0.0)
        np.testing.assert_allclose(given, share * JOINT_2, atol=1e-6)


@pytest.mark.parametrize(("step", "share"), [(0.0014, 1.0), (0.0016, 0.0)])
def test_an_arm_that_was_put_elsewhere_is_not_carried_by_what_held_it_before(
    step: float, share: float
) -> None:
    unexplained = held(*[JOINT_2] * 200)
    unexplained.teaching_offset(HOME, step)
    np.testing.assert_allclose(unexplained.teaching_offset(HOME, 0.0), share * JOINT_2, atol=1e-6)


@pytest.mark.parametrize(("joint", "sign"), [(1, 1.0), (5, -1.0)])
def test_only_what_friction_cannot_explain_is_in_excess(joint: int, sign: float) -> None:
    explained = 1.5 * MODEL.friction[joint] + 0.005 * MODEL.tau_max[joint]
    for share, excess in ((0.99, False), (1.01, True)):
        found = held(*[sign * share * explained * np.eye(7)[joint]] * 200).excess()
        assert (f"wam_j{joint + 1}: " in found) is excess


@pytest.mark.requirement("S-125")
@pytest.mark.parametrize("adds_gravity", [False, True])
def test_gravity_compensation_is_refused_where_model_and_friction_do_not_carry_the_arm(
    adds_gravity: bool,
) -> None:
    for torque in (3.0, 6.0):
        controller, plant = begin(
            controller=make(driver_compensates_gravity=adds_gravity),
            push=lambda *_, torque=torque: torque * JOINT_2,
            adds_gravity=adds_gravity,
        )
        run(controller, plant, 1.0)
        assert controller.mode is Mode.HOLD, controller.latched
        if torque < 4.0:
            controller.set_gravity_compensation(True)
            continue
        with pytest.raises(ControllerError, match=r"wam_j2: -6\.0 N m unexplained"):
            controller.set_gravity_compensation(True)


@pytest.mark.requirement("S-126")
def test_gravity_compensation_waits_until_the_arm_has_been_held() -> None:
    controller, plant = begin()
    controller.deactivate()
    controller.hold()
    assert refusal_of(lambda: controller.set_gravity_compensation(True)) is Refusal.BUSY
    run(controller, plant, 0.2)
    controller.set_gravity_compensation(True)


@pytest.mark.requirement("S-126")
@pytest.mark.parametrize("torque", [-4.0, 3.5])
def test_an_arm_that_nobody_touches_stays_under_the_torque_that_held_it(torque: float) -> None:
    controller, plant = begin(push=lambda *_: torque * JOINT_2, friction=1.0)
    run(controller, plant, 1.0)
    held = plant.q.copy()
    controller.set_gravity_compensation(True)
    run(controller, plant, 3.0, elapsed=0.002)
    assert controller.mode is Mode.GRAVITY_COMPENSATION
    assert np.abs(plant.q - held).max() < 0.02


@pytest.mark.parametrize(("elapsed", "depends"), [(None, False), (0.002, True)])
def test_in_lockstep_a_guided_arm_does_not_depend_on_the_hold_before_it(
    elapsed: float | None, depends: bool
) -> None:
    controller, plant = begin(push=lambda *_: 2.0 * JOINT_2, friction=1.0)
    run(controller, plant, 1.0)
    controller.set_gravity_compensation(True)
    tau = run(controller, plant, 0.01, elapsed=elapsed)[-1]
    model_error = tau - MODEL.gravity(plant.q)
    assert (abs(model_error[1]) > 0.5) == depends


@pytest.mark.requirement("S-132")
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_torque_that_changes_while_no_joint_reports_a_motion_is_a_drift(sign: float) -> None:
    bound = 0.75 * MODEL.friction[1] + 0.01 * MODEL.tau_max[1]
    for size, drifts in ((0.99, False), (1.01, True)):
        slow = np.concatenate([np.zeros(100), np.linspace(0.0, size * bound, 200)])
        torques = np.outer(sign * slow, JOINT_2)
        assert bool(held(*torques).crept) == drifts
        assert not held(*torques, speed=0.03).crept  # a hand moves it


@pytest.mark.requirement("S-132")
def test_an_arm_that_follows_a_drift_is_carried_without_the_friction_of_its_motion() -> None:
    """The torque steps by the friction as the motion begins, then follows gravity."""
    friction, unexplained = MODEL.friction[1], UnexplainedTorque(MODEL)
    for k in range(400):
        moves = k >= 100
        speed = 0.1 if 100 <= k < 105 else 0.0  # until the feedback has caught up
        torque = moves * (-friction + 0.02 * (k - 100))
        unexplained.observe(True, HOME, speed * JOINT_2, torque * JOINT_2, DT)
        if unexplained.crept:
            break
    assert unexplained.compensation[1] == pytest.approx(torque + friction)


def test_what_held_the_arm_when_a_fault_was_reset_is_what_held_it_before_the_next() -> None:
    unexplained = held(*[JOINT_2] * 200)
    elsewhere = HOME + 0.8 * JOINT_2
    unexplained.assume(elsewhere, 9.0 * JOINT_2)
    unexplained.observe(True, elsewhere, 0.0, 9.0 * JOINT_2, DT)
    np.testing.assert_allclose(unexplained.before(elsewhere), 9.0 * JOINT_2)
