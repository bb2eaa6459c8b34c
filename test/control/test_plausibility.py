# SPDX-License-Identifier: Apache-2.0
"""False joint states that are well formed, with a driver that holds the last torque."""

import numpy as np
import pytest
from rigid_arm import (
    A_TEST,
    HOME,
    MODEL,
    PERIOD_NS,
    Plant,
    begin,
    check,
    executing,
    make,
    refusal_of,
    run,
    speed,
    start_replay,
)

from benchmark.false_states import FALSE_STATES, Falsifier, Reading
from wam_power_ros.control import safety
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import Mode, Refusal
from wam_power_ros.control.plausibility import Interval, VelocityCheck
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.faults import FaultKind

State = tuple[int, np.ndarray, np.ndarray]
PERIOD = PERIOD_NS * 1e-9
LONGEST = 15  # states until false states of a moving arm are a fault: 30 ms
FROZEN = 17  # states until an arm frozen with velocity zero is a fault: 12 of them identical
DETECTABLE = 0.5  # [rad/s] error of a velocity; a smaller error may be detected later
SAME = "the same state again and again"
START = HOME + np.array([0.3, -0.2, 0.2, -0.3, 0.2, 0.2, 0.3])


FALSIFICATIONS = [name for name in FALSE_STATES if name not in ("silence", SAME)]
SOME = ("joint 4 frozen, its velocity zero", "velocities negated", "two drivers")


def falsify(
    controller: Controller, plant: Plant, falsification: Falsifier
) -> tuple[int | None, list[float], float]:
    """Falsify the plant's states for 1 s; the controller's own clock is correct.

    Returns:
        States until the fault, tool speeds [m/s], and the initial error of the worst joint's
        velocity beyond half of its magnitude [rad/s].
    """
    faulted, speeds, tau = None, [], controller.step(*plant.state())
    plant.step(tau)
    sizes = []
    for k in range(500):
        false = falsification(Reading(*plant.state()))
        reported, true = np.abs(false[2]), np.abs(plant.qd)
        sizes.append(np.abs(false[2] - plant.qd) - 0.5 * np.minimum(reported, true))
        tau, before = controller.step(*false, PERIOD), tau
        check(tau, before)
        plant.step(tau)
        speeds.append(speed(plant))
        if faulted is None and controller.mode is Mode.FAULT:
            faulted = k
    return faulted, speeds, float(np.min(sizes[:LONGEST], axis=0).max())


@pytest.fixture(scope="module")
def nominal() -> float:
    """Peak speed of the rollout with true states [m/s]."""
    controller, plant, _ = executing(0.002, friction=1.0)
    return max(speed(plant) for _ in range(700) if run(controller, plant, 0.002))


@pytest.mark.requirement("S-91")
@pytest.mark.parametrize(
    ("name", "moment"),
    [*((name, 0.33) for name in FALSIFICATIONS), ("frozen", 0.12), ("joint 2 frozen", 0.55)],
)
def test_a_false_state_in_a_rollout_ends_in_a_stop_that_true_ones_do_not_disturb(
    name: str, moment: float, nominal: float
) -> None:
    controller, plant, _ = executing(moment, friction=1.0, delay=2, sensing=True)
    faulted, speeds, size = falsify(controller, plant, FALSE_STATES[name]())
    assert max(speeds) < nominal + 0.5
    if faulted is None:  # the arm did not move enough to make the states false
        assert size < DETECTABLE
        return
    assert faulted <= LONGEST or size < DETECTABLE, (faulted, size)
    assert not controller.latched.kind.of_policy
    assert max(speeds[faulted + 250 :], default=0.0) < safety.REST_SPEED
    if size < DETECTABLE:
        return
    speeds = []
    for _ in range(250):
        run(controller, plant, PERIOD, elapsed=PERIOD)
        speeds.append(speed(plant))
    assert max(speeds) < 0.3
    assert max(speeds[150:]) < safety.REST_SPEED
    controller.reset()


@pytest.mark.requirement("S-91")
@pytest.mark.parametrize("moment", [0.22, 0.48])
def test_an_arm_frozen_with_velocity_zero_is_detected_after_standing_still(moment: float) -> None:
    controller, plant, _ = executing(moment, friction=1.0, delay=2, sensing=True)
    faulted, _, _ = falsify(controller, plant, FALSE_STATES["frozen, velocities zero"]())
    assert faulted is not None and faulted <= FROZEN


@pytest.mark.requirement("S-91")
def test_a_burst_of_states_in_a_fault_does_not_look_fast() -> None:
    controller, plant, tau = executing(0.4, friction=1.0, delay=2, sensing=True)
    controller.fault(A_TEST)
    speeds = []
    for pause in [8, *[1] * 30, 8, *[1] * 300]:  # periods: the process is held up twice
        late = []
        for _ in range(pause):
            plant.step(tau)
            speeds.append(speed(plant))
            late.append(plant.state())
        elapsed = pause * PERIOD
        for state in late:
            tau, elapsed = controller.step(*state, elapsed), 5e-5
    assert max(speeds) < speeds[0] + 0.3
    assert max(speeds[160:]) < 0.02


@pytest.mark.requirement("S-91")
@pytest.mark.parametrize("name", SOME)
def test_a_false_state_in_a_move_ends_in_a_stop(name: str) -> None:
    controller, plant = begin(START, controller=make(move_speed=1.0), friction=1.0, delay=2)
    controller.move_to_start()
    run(controller, plant, 0.3)
    faulted, speeds, size = falsify(controller, plant, FALSE_STATES[name]())
    assert faulted is not None
    assert faulted <= LONGEST or size < DETECTABLE, (faulted, size)
    assert max(speeds) < speeds[0] + 0.3
    assert max(speeds[faulted + 250 :]) < safety.REST_SPEED


@pytest.mark.requirement("S-91")
@pytest.mark.parametrize("teaching", [False, True])
@pytest.mark.parametrize("name", SOME)
def test_a_false_state_of_an_arm_at_rest_moves_nothing(name: str, teaching: bool) -> None:
    controller, plant = begin(friction=1.0, delay=2)
    controller.set_gravity_compensation(teaching)
    _, speeds, _ = falsify(controller, plant, FALSE_STATES[name]())
    assert max(speeds) < safety.REST_SPEED


@pytest.mark.requirement("S-91")
def test_torques_of_another_commander_are_detected() -> None:
    def foreign(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return 20.0 * np.eye(7)[1] * (t > 0.3)

    controller = make(driver_compensates_gravity=True)
    controller, plant = begin(controller=controller, friction=1.0, push=foreign, adds_gravity=True)
    run(controller, plant, 0.5)
    assert controller.latched.kind is FaultKind.EXTERNAL_TORQUE
    assert "joint 2" in controller.latched.text


@pytest.mark.requirement("S-92")
@pytest.mark.parametrize("axis", range(3), ids="xyz")
def test_a_contact_of_30_newtons_stops_a_replay_within_60_milliseconds(axis: int) -> None:
    t = np.linspace(0.0, 3.0, 300)
    wave = 0.5 * (1.0 - np.cos(2.0 * np.pi * t / 3.0))[:, None]

    def contact(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return -30.0 * MODEL.jacobian(q)[axis] * (t >= 0.9)

    controller, plant = begin(friction=1.0, delay=2, sensing=True, push=contact)
    start_replay(controller, t, HOME + 0.4 * wave, speed=0.5)
    run(controller, plant, 0.9 - (plant.stamp - 10**12) * 1e-9)
    assert controller.mode is Mode.REPLAY
    run(controller, plant, 0.06)
    assert controller.latched.kind is FaultKind.EXTERNAL_TORQUE


def assert_executes(controller: Controller, plant: Plant) -> None:
    """Move to the start and execute the policy without a fault."""
    controller.move_to_start()
    run(controller, plant, 6.0, lambda: controller.ready)
    controller.execute()
    run(controller, plant, 2.0)
    assert controller.mode is Mode.HOLD, controller.latched


@pytest.mark.requirement("S-93")
@pytest.mark.parametrize(("friction", "delay"), [(0.5, 4), (2.0, 0)])
def test_model_errors_are_no_fault(friction: float, delay: int) -> None:
    controller, plant = begin(START, friction=friction, delay=delay, sensing=True)
    obey = plant.step
    plant.step = lambda tau: obey((1.05, 0.95, 1.05, 0.95, 1.05, 0.95, 1.05) * tau)
    assert_executes(controller, plant)


@pytest.mark.requirement("S-93")
def test_a_fast_replay_with_sensor_and_motor_lag_is_no_contact() -> None:
    t = np.linspace(0.0, 1.0, 101)
    x = np.clip((t - 0.3) / 0.25, 0.0, 1.0)
    flick = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)  # from rest to rest
    controller, plant = begin(friction=1.0, delay=4, sensing=True)
    start_replay(controller, t, HOME + flick[:, None] * [0.0, 0.0, 0.0, 0.25, 0.0, 0.3, 0.0])
    run(controller, plant, 2.0)
    assert controller.mode is Mode.HOLD, controller.latched


@pytest.mark.requirement("S-93")
def test_a_velocity_delayed_by_a_filter_is_plausible_and_one_too_small_is_not() -> None:
    def first_fault(lag: float, scale: float) -> int | None:
        exact = Interval(0.002, 0.002, 0.002)
        check, dt, filtered, last = VelocityCheck(7), 0.002, 0.0, None
        for k in range(40):  # 200 rad/s^2 from rest for 40 ms, then at that speed
            time = k * dt
            speed = 200.0 * min(time, 0.04)
            q = 100.0 * min(time, 0.04) ** 2 + 8.0 * max(time - 0.04, 0.0)
            filtered += (1.0 - np.exp(-dt / lag)) * (speed - filtered)
            qd = scale * filtered
            state = JointState(k * PERIOD_NS, np.full(7, q), np.full(7, qd), dt, dt)
            if last is not None and check.fault(last, state, [0] * 7, exact) is not None:
                return k
            last = state
        return None

    assert first_fault(1.0 / 180.0, 1.0) is None
    assert first_fault(1.0 / 180.0, 0.5) is not None


@pytest.mark.requirement("S-26")
def test_a_reset_needs_rest_for_a_time_and_not_a_turning_point() -> None:
    controller, plant = begin(friction=1.0)
    controller.fault(A_TEST)
    plant.push = lambda t, q, qd: 30.0 * np.sin(4.0 * np.pi * t) * np.eye(7)[0]
    for _ in range(500):
        run(controller, plant, 0.002)
        assert refusal_of(controller.reset) is Refusal.BUSY
    plant.push = None
    run(controller, plant, 2.0)
    controller.reset()
    assert controller.mode is Mode.HOLD


HONEST: dict[str, dict[str, float]] = {
    "stamps that jitter by 0.6 ms": {"jitter": 6e-4},
    "velocities behind a filter of 10 ms": {"lag": 0.01},
    "each measurement published twice": {"repeats": 2},
}


class HonestDriver:
    """States of a driver that measures well and reports as drivers do.

    Args:
        jitter: Standard deviation of the stamps [s].
        lag: Time constant of a filter of the velocities, after the encoders' own [s].
        repeats: Number of states with the same measurement.
    """

    def __init__(self, jitter: float = 0.0, lag: float = 0.0, repeats: int = 1) -> None:
        self._rng, self._jitter, self._repeats = np.random.default_rng(0), jitter, repeats
        self._share = 1.0 - np.exp(-PERIOD / lag) if lag else 1.0
        self._qd, self._count, self._last_ns = np.zeros(7), 0, 0

    def __call__(self, state: State) -> State:
        """State that is reported for the one that was measured."""
        stamp, q, qd = state
        self._qd = self._qd + self._share * (qd - self._qd)
        if self._count % self._repeats == 0:
            self._measured = q, self._qd
        self._count += 1
        stamp += round(1e9 * self._jitter * self._rng.standard_normal())
        self._last_ns = max(stamp, self._last_ns + 1000)  # its clock never runs back
        return self._last_ns, *self._measured


@pytest.mark.requirement("S-124")
@pytest.mark.parametrize("name", HONEST)
def test_an_honest_driver_is_never_called_false(name: str) -> None:
    controller, plant = begin(START, friction=1.0, delay=4, sensing=True)
    driver, tell = HonestDriver(**HONEST[name]), plant.state
    plant.state = lambda: driver(tell())
    assert_executes(controller, plant)
