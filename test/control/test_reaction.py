# SPDX-License-Identifier: Apache-2.0
"""Reaction to a fault: what two witnesses confirm, and what the states alone may ask for."""

import numpy as np
import pytest
from rigid_arm import A_TEST, HOME, MODEL, begin, executing, make, run, tool

from wam_power_ros.control.modes import Mode
from wam_power_ros.control.payload import GRAVITY, PayloadCheck
from wam_power_ros.control.reaction import (
    ANSWER_TIME,
    REACTION_SPEED,
    ModelState,
    Reaction,
    confirmed,
)
from wam_power_ros.control.state_checks import JointState, PastState

STILL = np.zeros(7)


def state(k: int, q: np.ndarray, qd: np.ndarray = STILL) -> JointState:
    return JointState(10**12 + 2_000_000 * k, q, qd, 0.002, 0.002)


def test_two_witnesses_confirm_the_slower_speed_and_none_where_they_contradict() -> None:
    first = np.array([1.0, -2.0, 0.5, -0.1, 0.0])
    second = np.array([0.4, -3.0, -0.5, 0.2, 1.0])
    np.testing.assert_array_equal(confirmed(first, second), [0.4, -2.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(confirmed(second, first), confirmed(first, second))


@pytest.mark.requirement("S-131")
def test_what_the_states_alone_ask_for_gives_a_resting_arm_no_speed_beyond_the_bound() -> None:
    rng = np.random.default_rng(0)
    reaction = Reaction(MODEL, lambda q: MODEL.gravity(q))
    for _ in range(50):
        q = HOME + rng.uniform(-0.5, 0.5, 7)
        mass = MODEL.mass_matrix(q)
        wanted = mass.dot(rng.normal(size=7) * 10.0 ** rng.uniform(-1.0, 4.0))
        given = reaction._bounded(wanted, mass, q)
        driving = given - np.clip(given, -MODEL.friction, MODEL.friction)
        motion = MODEL.motion(q, np.linalg.solve(mass, driving) * ANSWER_TIME)
        assert motion.tool_speed < REACTION_SPEED * (1.0 + 1e-9)
        assert np.all(given * wanted >= 0.0)
        if np.all(np.abs(wanted) < MODEL.friction):
            np.testing.assert_array_equal(given, wanted)


@pytest.mark.requirement("S-131")
def test_the_brake_takes_energy_from_the_motion_that_either_witness_sees() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        seen, simulated = rng.normal(size=7), rng.normal(size=7)
        reaction = Reaction(MODEL, lambda q: MODEL.gravity(q))
        for k in range(120):
            q = HOME + 0.002 * (k - 119) * simulated
            reaction.record(state(k, q), MODEL.gravity(q), [0.0] * 7)
        reaction.begin(0.05, alone=True)
        for k in range(120, 125):
            last = state(k, HOME + 0.002 * (k - 119) * seen)
            reaction.record(last, MODEL.gravity(HOME), [0.0] * 7)
        tau = reaction.torque(last, True, True, None)
        braking = tau - MODEL.gravity(reaction.posture)
        bounded = np.linalg.norm(MODEL.friction) + 15.0  # what the states alone may ask for
        assert braking.dot(seen) < bounded * np.linalg.norm(seen)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_model_rests_under_friction_and_its_speed_stays_below_the_limits(sign: float) -> None:
    model = ModelState(MODEL, HOME, STILL, STILL, [], 0.002)
    for _ in range(50):
        model.predict(MODEL.gravity(HOME) + 0.9 * sign * MODEL.friction, 0.002)
    assert np.abs(model.qd).max() < 0.02
    for _ in range(500):
        model.predict(sign * MODEL.tau_max, 0.002)
        assert np.all(np.abs(model.qd) <= MODEL.qd_max)


def test_a_torque_acts_on_the_model_with_the_delay_of_the_arm() -> None:
    carried = MODEL.gravity(HOME)
    model = ModelState(MODEL, HOME, STILL, STILL, [carried, carried], 0.002)
    for moves in (False, False, True):
        model.advance(carried + 10.0 * MODEL.friction, 0.002)
        assert (model.qd[1] > 0.01) == moves


def fall(mass: float, steps: int = 40) -> list[PastState]:
    """States of an arm that a mass has been put on, carried as if it were not there."""
    tool = MODEL.jacobian(HOME)[:3]
    inertia = MODEL.mass_matrix(HOME) + mass * tool.T.dot(tool)
    qdd = np.linalg.solve(inertia, -mass * GRAVITY * tool[2])
    external = -mass * tool.T.dot([0.0, 0.0, GRAVITY]) - mass * tool.T.dot(tool.dot(qdd))
    return [
        PastState(HOME + 0.5 * qdd * (0.002 * k) ** 2, STILL, external.tolist(), 0.002)
        for k in range(steps)
    ]


@pytest.mark.requirement("S-133")
@pytest.mark.parametrize("mass", [-0.3, 3.0])
def test_a_mass_on_the_tool_is_recognized_by_the_fall_of_the_arm(mass: float) -> None:
    torque = PayloadCheck(MODEL).torque(fall(mass))
    expected = -mass * GRAVITY * MODEL.jacobian(HOME)[2]
    np.testing.assert_allclose(torque, expected, atol=0.3 * np.abs(expected).max())


@pytest.mark.requirement("S-133")
@pytest.mark.parametrize("mass", [-4.5, -0.15, 0.5, 5.0])
def test_a_mass_too_heavy_for_a_tool_or_too_light_to_tell_is_not_recognized(mass: float) -> None:
    assert PayloadCheck(MODEL).torque(fall(mass)) is None


@pytest.mark.requirement("S-133")
@pytest.mark.parametrize("joint", [1, 3])
def test_a_joint_that_runs_away_is_no_mass(joint: int) -> None:
    t = 0.002 * np.arange(60)
    speed = 4.0 * np.sin(np.pi * t / 0.4) ** 2
    change = np.gradient(speed, t)
    way, inertia = np.cumsum(speed) * 0.002, MODEL.mass_matrix(HOME)[joint]
    check = PayloadCheck(MODEL)
    past = [
        PastState(HOME + x * np.eye(7)[joint], STILL, list(inertia * a), 0.002)
        for x, a in zip(way, change, strict=True)
    ]
    for k in range(30, 60):
        assert check.torque(past[:k]) is None


@pytest.mark.requirement("S-133")
def test_a_mass_that_does_not_answer_to_being_carried_is_none() -> None:
    check, past = PayloadCheck(MODEL), fall(2.0)
    assert check.torque(past) is not None
    other = [each._replace(external=[-x for x in each.external]) for each in past]
    given = [check.torque(past + other[: k + 1]) for k in range(15)]
    assert given[0] is not None
    assert given[-1] is None
    assert check.refuted


@pytest.mark.requirement("S-122")
@pytest.mark.parametrize(("torque", "delay"), [(-8.0, 0), (8.0, 4)])
def test_a_fault_holds_an_arm_whose_model_is_wrong_and_can_be_reset(
    torque: float, delay: int
) -> None:
    """8 N m at joint 2: 0.9 kg at the tool, or a motor that gives 70 %."""
    controller, plant, _ = executing(0.3, friction=1.0, delay=delay, sensing=True)
    controller.fault(A_TEST)
    plant.push = lambda *_: torque * np.eye(7)[1]
    run(controller, plant, 0.5)
    at = tool(plant)
    run(controller, plant, 3.0)
    assert np.linalg.norm(tool(plant) - at) < 0.05
    controller.reset()
    assert controller.mode is Mode.HOLD


@pytest.mark.requirement("S-122")
def test_a_brake_that_is_too_weak_never_pulls_the_arm_back() -> None:
    """The arm falls while its motors are cut; then they act again."""
    controller, plant = begin(controller=make(contact_share=100.0), friction=1.0)
    controller.fault(A_TEST)
    plant.push = lambda t, q, qd: -25.0 * np.eye(7)[1]
    run(controller, plant, 0.1)
    plant.push = None
    speeds = [plant.qd[1] for _ in range(500) if run(controller, plant, 0.002)]
    assert min(speeds) < -0.5
    assert max(speeds) < 0.1
    assert abs(speeds[-1]) < 0.01


@pytest.mark.requirement("S-131")
@pytest.mark.parametrize("push", [1.5, 2.0])
def test_a_driver_that_stamps_old_states_as_new_after_a_pause_does_not_drive_the_arm(
    push: float,
) -> None:
    """It pauses for 12 ms, then stamps the state that waited and the newest 0.3 ms apart."""
    controller, plant = begin(friction=1.0)
    controller.fault(A_TEST)
    plant.push = lambda t, q, qd: -push * np.eye(7)[3] * (t < 0.5)
    speeds, waiting = [], plant.state()
    for k in range(400):
        stamp, q, qd = plant.state()
        if (phase := k % 30) < 6:
            tau = controller.stale_torque(0.002)
        else:
            if phase == 6:
                controller.step(stamp - 300_000, *waiting[1:], 0.012, 0.002)
            elapsed = 0.0005 if phase == 6 else 0.002
            tau = controller.step(stamp, q, qd, elapsed, elapsed)
            waiting = stamp, q, qd
        plant.step(tau)
        speeds.append(np.abs(plant.qd).max())
    assert max(speeds) < 0.2  # 0.29 by the speed between the two states
    assert max(speeds[-100:]) < 0.05


@pytest.mark.requirement("S-122")
def test_a_model_that_has_braked_rests_although_a_torque_would_let_it_creep() -> None:
    moving = 2.0 * MODEL.friction[3] * np.eye(7)[3]
    reaction = Reaction(MODEL, lambda q: MODEL.gravity(q) + moving)
    for k in range(120):
        reaction.record(state(k, HOME), MODEL.gravity(HOME), [0.0] * 7)
    reaction.begin(0.2, alone=True)
    postures = []
    for k in range(400):
        reaction.torque(state(120 + k, HOME), False, False, None)
        postures.append(reaction.posture)
    assert np.abs(postures[100] - HOME).max() > 1e-3
    np.testing.assert_array_equal(postures[-1], postures[-50])


@pytest.mark.requirement("S-122")
@pytest.mark.parametrize(("size", "rests"), [(0.01, False), (0.0005, True)])
def test_an_arm_that_swings_through_where_it_was_does_not_rest(size: float, rests: bool) -> None:
    """The torque of that moment would be kept, which drives it."""
    reaction = Reaction(MODEL, MODEL.gravity)
    reaction.begin(0.2)
    for k in range(400):
        q = HOME + size * np.sin(2.0 * np.pi * k * 0.002 / 0.15) * np.eye(MODEL.n)[1]
        reaction.record(state(k, q), MODEL.gravity(q), [0.0] * 7)
        reaction.torque(state(k, q), True, True, None)
    assert reaction.rested is rests


@pytest.mark.requirement("S-133")
def test_an_arm_that_was_followed_in_its_fall_counts_as_having_rested() -> None:
    reaction = Reaction(MODEL, MODEL.gravity)
    reaction.begin(0.2)
    assert not reaction.rested
    reaction.follow(HOME, np.zeros(MODEL.n))
    assert reaction.rested


def held(course: np.ndarray, torque: np.ndarray) -> Reaction:
    """Reaction after states that report rest, under torques (k, n) [N m] beyond g(course)."""
    reaction = Reaction(MODEL, MODEL.gravity)
    for k, (q, beyond) in enumerate(zip(course, torque, strict=True)):
        reaction.record(state(k, HOME), MODEL.gravity(q) + beyond, [0.0] * 7)
    return reaction


@pytest.mark.requirement("S-132")
@pytest.mark.parametrize(("joint", "speed"), [(1, 0.2), (3, -0.3)])
def test_a_torque_that_changes_as_gravity_shows_which_joint_follows_a_drift(
    joint: int, speed: float
) -> None:
    t = 0.002 * np.arange(150)
    at = np.eye(7)[joint]
    course = HOME + np.outer(speed * t, at)
    drag = MODEL.friction[joint] * np.sign(speed) * at
    found, torque = held(course, np.tile(drag, (150, 1))).followed()
    assert found == joint
    due = MODEL.gravity(course[-1])[joint]
    assert abs(torque - due) < 0.4 * MODEL.friction[joint]


@pytest.mark.requirement("S-132")
def test_a_torque_that_settles_steps_or_presses_shows_no_drift() -> None:
    t = 0.002 * np.arange(150)
    rest, push = np.tile(HOME, (150, 1)), MODEL.jacobian(HOME)[2]
    for course in (np.exp(-t / 0.05), t > 0.28, 0.0 * t):
        assert held(rest, np.outer(5.0 * course, np.eye(7)[1])).followed() is None
    assert held(rest, np.outer(60.0 * t, push)).followed() is None
    assert held(rest[:50], np.zeros((50, 7))).followed() is None
