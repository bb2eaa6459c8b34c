# SPDX-License-Identifier: Apache-2.0
"""The controller holds, moves and answers requests, on the arm of `rigid_arm`."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rigid_arm import (
    A_TEST,
    HOME,
    MODEL,
    NAMES,
    PERIOD_NS,
    POLICY,
    URDF,
    begin,
    check,
    make,
    make_policy,
    refusal_of,
    run,
    start_replay,
)

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import (
    MOVING_MODES,
    PASSIVE_MODES,
    TRANSITIONS,
    ControllerError,
    Mode,
    Refusal,
)
from wam_power_ros.control.safety import limits_of
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.policy import with_id
from wam_power_ros.ros.outcomes import Code


def test_hold_brakes_a_moving_arm_without_a_jerk() -> None:
    controller, plant = begin(controller=make(limits=limits_of(MODEL, teaching_tool_speed=4.0)))
    controller.set_gravity_compensation(True)
    change = np.array([0.5, -0.5, 0.5, 1.0, -1.0, 2.0, 1.0]) / 0.1
    plant.push = lambda t, q, qd: MODEL.mass_matrix(q).dot(change)
    run(controller, plant, 0.1)
    plant.push = None
    q, qd = plant.q.copy(), plant.qd.copy()
    controller.hold()
    run(controller, plant, 1.0)
    assert np.abs(plant.qd).max() < 1e-3
    assert np.allclose(plant.q, q + 0.5 * 0.15 * qd, atol=0.02)


@pytest.mark.requirement("S-29")
def test_a_move_to_start_arrives_at_limited_speed_and_is_ready() -> None:
    away = HOME + np.array([0.4, -0.3, 0.2, 0.5, -0.6, 0.4, 0.8])
    controller, plant = begin(away, friction=1.0, sensing=True, delay=2)
    assert not controller.ready
    controller.move_to_start()
    peaks = [0.0]

    def arrived() -> bool:
        peaks.append(np.abs(plant.qd).max())
        return controller.mode is Mode.HOLD

    run(controller, plant, 10.0, until=arrived)
    run(controller, plant, 0.5)
    assert max(peaks) < 1.3 * 0.3
    assert np.abs(plant.q - HOME).max() < 0.03
    assert controller.ready
    assert controller.label == "hold"


@pytest.mark.requirement("S-25")
def test_a_held_arm_that_was_moved_away_does_not_spring_back() -> None:
    def idle(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        cut = np.zeros(7) if t < 0.3 else -np.array(sent[-1])  # no torque reaches the motors
        return cut - 3.0 * qd * (t >= 0.3)

    sent = [np.zeros(7)]
    controller, plant = begin(controller=make(contact_share=100.0), push=idle)
    for _ in range(3000):
        sent.append(controller.step(*plant.state()))
        plant.step(sent[-1])
        if controller.mode is Mode.FAULT:
            break
    assert "rad from its reference" in controller.latched.text
    q, plant.push = plant.q.copy(), None  # the board lets torques through again
    run(controller, plant, 1.0)
    # It was falling, under torques that had no effect: the model confirms none of its speed.
    assert np.abs(plant.q - q).max() < 0.5
    assert controller.mode is Mode.FAULT


def test_a_replay_follows_the_recording_and_reports_its_error() -> None:
    t = np.linspace(0.0, 1.5, 300)
    wave = 0.5 * (1.0 - np.cos(2.0 * np.pi * t / 1.5))[:, None]
    controller, plant = begin(HOME + 0.05, sensing=True, delay=2, friction=1.0)
    start_replay(controller, t, HOME + wave * [0.1, 0.2, 0.1, 0.5, 0.2, -0.4, 0.3], speed=1.5)
    run(controller, plant, 6.0, until=lambda: controller.mode is not Mode.REPLAY)
    assert controller.mode is Mode.HOLD, controller.latched
    error = controller.replay_error
    assert np.all(error.rms < 0.03)
    assert np.all(error.largest >= error.rms)
    assert 0.0 < error.tool()[0] < error.tool()[1] < 0.03
    run(controller, plant, 0.5)
    assert np.abs(plant.q - HOME).max() < 0.03


def in_mode(mode: Mode) -> Controller:
    controller, plant = begin(HOME + (0.2 if mode is Mode.MOVE_TO_START else 0.0))
    enter = {
        Mode.INACTIVE: controller.deactivate,
        Mode.GRAVITY_COMPENSATION: lambda: controller.set_gravity_compensation(True),
        Mode.HOLD: lambda: None,
        Mode.MOVE_TO_START: controller.move_to_start,
        Mode.ROLLOUT: controller.execute,
        Mode.REPLAY: lambda: start_replay(
            controller, np.arange(9.0), HOME + 0.01 * np.arange(9.0)[:, None]
        ),
        Mode.FAULT: lambda: controller.fault(A_TEST),
    }
    enter[mode]()
    run(controller, plant, 0.02)
    assert controller.mode is mode
    return controller


REQUESTS = {
    Mode.GRAVITY_COMPENSATION: lambda c: c.set_gravity_compensation(True),
    Mode.HOLD: Controller.hold,
    Mode.MOVE_TO_START: Controller.move_to_start,
    Mode.ROLLOUT: Controller.execute,
    Mode.INACTIVE: Controller.deactivate,
}


@pytest.mark.requirement("S-27")
@pytest.mark.parametrize("mode", list(Mode))
def test_a_request_changes_the_mode_as_the_table_says_or_is_refused_with_a_reason(
    mode: Mode,
) -> None:
    controller = in_mode(mode)
    for target, request in REQUESTS.items():
        if mode is target or (mode, target) == (Mode.FAULT, Mode.INACTIVE):
            continue
        if target in TRANSITIONS[mode] and (mode, target) != (Mode.FAULT, Mode.HOLD):
            request(controller)
            assert controller.mode is target
            controller = in_mode(mode)
        else:
            with pytest.raises(ControllerError, match=r"refused|not possible"):
                request(controller)
            assert controller.mode is mode


@pytest.mark.requirement("S-27")
def test_nothing_begins_before_the_first_state_or_without_a_policy() -> None:
    controller = make(None)
    for request in (controller.hold, controller.move_to_start, controller.execute):
        with pytest.raises(ControllerError):
            request()
    controller, _ = begin(controller=make(None))
    for request in (controller.execute, controller.move_to_start):
        assert refusal_of(request) is Refusal.NOTHING


@pytest.mark.requirement("S-28")
def test_a_rollout_starts_only_at_rest_at_its_start() -> None:
    controller, plant = begin(HOME + np.array([0, 0, 0, 0.06, 0, 0, 0]))
    assert refusal_of(controller.execute) is Refusal.NOT_AT_START
    controller, plant = begin()
    stamp, q, _ = plant.state()
    controller.step(stamp, q, np.array([0.2, 0, 0, 0, 0, 0, 0]))
    assert not controller.at_rest
    assert refusal_of(controller.execute) is Refusal.BUSY


@pytest.mark.requirement("S-15")
def test_a_policy_that_does_not_fit_is_refused_and_the_old_one_kept() -> None:
    controller, _ = begin()
    with pytest.raises(ControllerError, match="6 joints"):
        controller.load(replace(POLICY, q_start=HOME[:6]))
    controller.execute()
    with pytest.raises(ControllerError, match="rollout"):
        controller.load(make_policy("long"))
    controller.stop()
    assert controller.policy_id == "trial-0001"
    controller.load(with_id(POLICY, "trial-0002"))
    assert controller.policy_id == "trial-0002"


def test_limits_of_another_number_of_joints_are_refused() -> None:
    with pytest.raises(ValueError, match="limits are for 4 joints"):
        make(limits=safety.limits_of(Arm(URDF, NAMES[:4])))


number = st.one_of(
    st.floats(-3.0, 3.0), st.floats(), st.sampled_from([math.nan, math.inf, 1e308, -1e308])
)
plain = st.lists(st.floats(-4.0, 4.0), min_size=7, max_size=7)
state = st.tuples(
    st.sampled_from([PERIOD_NS] * 6 + [0, -PERIOD_NS, 4 * PERIOD_NS, 10**12, 3]),
    st.one_of(st.none(), plain, st.lists(number, min_size=6, max_size=8)),  # none: near home
    st.one_of(st.none(), st.just([0.0] * 7), st.lists(number, min_size=7, max_size=7)),
)
call = st.sampled_from(
    [
        *REQUESTS.values(),
        *(Controller.stop, Controller.reset, Controller.stale_torque),
        lambda c: c.fault(A_TEST),
    ]
)


@pytest.mark.requirement("S-01")
@settings(max_examples=60)
@given(st.lists(st.one_of(state, state, state, call), max_size=60), st.booleans(), st.booleans())
def test_no_sequence_of_states_and_calls_gives_a_torque_beyond_the_limits(
    events: list, driver: bool, law: bool
) -> None:
    kind = "virtual_mass" if law else "operational_space"
    controller, plant = begin(controller=make(driver_compensates_gravity=driver, law=kind))
    previous, stamp = controller.step(*plant.state()), plant.stamp
    for event in events:
        if callable(event):
            before = controller.mode
            try:
                tau = event(controller)
            except ControllerError:
                assert controller.mode is before
                continue
        else:
            step, q, qd = event
            stamp += step
            tau = controller.step(stamp, HOME if q is None else q, qd)
        if tau is not None:
            inactive = controller.mode is Mode.INACTIVE  # nothing is sent
            check(tau, previous, math.inf if inactive else 0.004)
            previous = tau


FAULT = Fault(FaultKind.PLANE, "wrist is 0.012 m behind the plane")


def test_every_refusal_is_a_code_of_an_answer() -> None:
    assert {refusal.value for refusal in Refusal} <= {code.value for code in Code}


def test_every_moving_mode_can_end_in_hold_and_in_a_fault() -> None:
    assert set(TRANSITIONS) == set(Mode)
    for mode in set(Mode) - set(PASSIVE_MODES):
        assert {Mode.FAULT, Mode.INACTIVE} <= TRANSITIONS[mode]
    for mode in MOVING_MODES:
        assert TRANSITIONS[mode] == {Mode.INACTIVE, Mode.HOLD, Mode.FAULT}
