# SPDX-License-Identifier: Apache-2.0
"""The controller under false states and motion beyond limits, on the arm of `rigid_arm`."""

import math

import numpy as np
import pytest
from open_loop import reproduced
from rigid_arm import (
    A_TEST,
    HOME,
    LIMITS,
    MODEL,
    PERIOD_NS,
    POLICY,
    begin,
    check,
    executing,
    make,
    make_policy,
    refusal_of,
    run,
    speed,
    start_replay,
    tool,
)

from wam_power_ros.control import safety, torque_law
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import ControllerError, Mode, Refusal
from wam_power_ros.faults import FaultKind
from wam_power_ros.learning.policy import with_id


@pytest.mark.requirement("S-13")
def test_an_older_state_is_counted_and_changes_nothing() -> None:
    controller, plant = begin()
    stamp, q, qd = plant.state()
    answer = controller.step(stamp, q, qd)
    assert controller.step(stamp - PERIOD_NS, q + 0.05, qd) is answer
    assert controller.counters["older"] == 1
    assert controller.mode is Mode.HOLD


@pytest.mark.requirement("S-11")
@pytest.mark.parametrize(
    ("q", "qd"), [(HOME * math.nan, np.zeros(7)), (HOME, np.full(7, math.inf)), (None, None)]
)
def test_a_state_that_is_not_valid_is_ignored_and_five_are_a_fault(q: object, qd: object) -> None:
    controller, plant = begin()
    stamp, good, _ = plant.state()
    answer = controller.step(stamp, good, np.zeros(7))
    for k in range(1, 6):
        assert controller.mode is Mode.HOLD and controller.counters["rejected"] == k - 1
        tau = controller.step(stamp + k * PERIOD_NS, q, qd)
        check(tau, answer)
        answer = tau
    assert controller.mode is Mode.FAULT
    with pytest.raises(ControllerError, match="not valid"):
        controller.reset()
    for k in range(6, 6 + 1 + 100):
        with pytest.raises(ControllerError, match=r"not valid|at rest for 0\.2 s"):
            controller.reset()
        controller.step(stamp + k * PERIOD_NS, good, np.zeros(7))
    controller.reset()
    assert controller.mode is Mode.HOLD


@pytest.mark.requirement("S-11")
def test_a_state_that_could_not_be_read_counts_as_one_that_is_not_valid() -> None:
    controller, plant = begin()
    stamp, good, _ = plant.state()
    for k in range(1, 5):
        controller.refuse_state()
        controller.step(stamp + k * PERIOD_NS, good, np.zeros(7))
        assert controller.mode is Mode.HOLD
    controller.step(stamp + 5 * PERIOD_NS, np.full(7, math.nan), np.zeros(7))
    assert controller.latched.kind is FaultKind.STATES_REFUSED


@pytest.mark.requirement("S-44")
@pytest.mark.parametrize("teaching", [False, True])
def test_a_joint_that_jumps_is_a_fault_in_every_mode(teaching: bool) -> None:
    bound = 2.0 * LIMITS.qd_max[1] * 0.002 + 0.01  # twice the way at the joint's limit
    for size, mode in ((0.99 * bound, None), (1.01 * bound, Mode.FAULT)):
        controller, plant = begin()
        controller.set_gravity_compensation(teaching)
        before = controller.mode
        run(controller, plant, 0.002)
        plant.q = plant.q + size * np.eye(7)[1]
        controller.step(*plant.state())
        assert controller.mode is (mode or before), size
        assert controller.counters["jumps"] == (mode is Mode.FAULT)


@pytest.mark.requirement("S-131")
@pytest.mark.parametrize("teaching", [False, True])
@pytest.mark.parametrize("joint", [0, 3, 6])
def test_a_speed_that_no_motor_gives_within_one_state_is_a_fault_and_moves_nothing(
    joint: int, teaching: bool
) -> None:
    controller, plant = begin(friction=1.0)
    controller.set_gravity_compensation(teaching)
    carrying = run(controller, plant, 0.1)[-1]
    stamp, q, qd = plant.state()
    step = 2.1 * MODEL.tau_max[joint] * 0.002 / MODEL.mass_matrix(q)[joint, joint]
    tau = controller.step(stamp, q, qd + step * np.eye(7)[joint])
    assert controller.latched.kind is FaultKind.VELOCITY
    assert controller.label == "fault"  # this torque is already the reaction's
    assert np.abs(tau - carrying).max() < 0.5 * MODEL.friction.min()


@pytest.mark.requirement("S-23")
def test_a_rollout_that_leaves_the_workspace_is_a_fault() -> None:
    top = MODEL.tool_pose(HOME)[0][2] + 0.02
    limits = safety.limits_of(MODEL, workspace_max=(2.0, 2.0, top))
    controller, *_ = executing(2.0, make(limits=limits))
    assert controller.latched.kind is FaultKind.WORKSPACE


@pytest.mark.requirement("S-23")
@pytest.mark.parametrize("guarded", ["elbow", "tool"])
def test_neither_tool_nor_guarded_point_comes_behind_the_plane(guarded: str) -> None:
    elbow, _ = MODEL.motion(HOME, np.zeros(7)).guarded_positions
    tool, _ = MODEL.tool_pose(HOME)
    plane = {"elbow": (-1.0, 0.0, 0.0, 0.01 - elbow[0]), "tool": (-1.0, 0.0, 0.0, -0.01 - tool[0])}
    controller, plant = begin(controller=make(limits=safety.limits_of(MODEL, plane=plane[guarded])))
    run(controller, plant, 0.1)
    assert controller.mode is Mode.HOLD  # the plane applies while the arm moves by itself
    controller.execute()
    run(controller, plant, 1.0)
    assert controller.latched.text.startswith(f"{guarded} is 0.0")


@pytest.mark.requirement("S-30")
def test_hold_to_run_is_required_and_its_release_is_a_fault_in_the_same_state() -> None:
    def teach(controller: Controller) -> None:
        controller.set_gravity_compensation(True)

    def replay(controller: Controller) -> None:
        start_replay(controller, np.linspace(0.0, 1.0, 11), np.tile(HOME, (11, 1)))

    for request in (teach, replay, Controller.execute):
        controller, plant = begin(controller=make(hold_to_run=True))
        assert refusal_of(lambda: request(controller)) is Refusal.SWITCH  # noqa: B023
        assert controller.mode is Mode.HOLD
        controller.enabled = True
        request(controller)
        run(controller, plant, 0.1)
        assert controller.mode not in (Mode.HOLD, Mode.FAULT)
        controller.enabled = False
        controller.step(*plant.state())
        assert controller.mode is Mode.FAULT
        assert "released" in controller.latched.text


@pytest.mark.requirement("S-30")
def test_a_policy_that_has_run_once_under_the_switch_runs_without_it_under_any_name() -> None:
    controller, plant = begin(controller=make(hold_to_run=True))
    controller.enabled = True
    controller.execute()
    run(controller, plant, 2.0)
    controller.enabled = False
    controller.load(with_id(POLICY, "again"))
    controller.move_to_start()
    run(controller, plant, 10.0, until=lambda: controller.ready)
    controller.execute()
    run(controller, plant, 2.0)
    assert controller.mode is Mode.HOLD
    controller.load(make_policy(size=0.9))
    controller.move_to_start()
    run(controller, plant, 10.0, until=lambda: controller.ready)
    assert refusal_of(controller.execute) is Refusal.SWITCH


@pytest.mark.requirement("S-24")
def test_soft_springs_push_a_taught_arm_off_its_limits() -> None:
    q = HOME.copy()
    q[5] = LIMITS.q_max[5] - 0.01
    controller, plant = begin(q)
    run(controller, plant, 0.2)
    controller.set_gravity_compensation(True)
    run(controller, plant, 0.3)
    assert LIMITS.q_max[5] - plant.q[5] > 0.05


@pytest.mark.requirement("S-26")
def test_a_fault_brings_the_arm_to_rest_carries_it_and_stays_until_reset() -> None:
    controller, plant, _ = executing(0.45, sensing=True, delay=2)  # in the middle of the throw
    start = tool(plant)
    assert np.abs(plant.qd).max() > 0.5
    controller.fault(A_TEST)
    assert refusal_of(controller.reset) is Refusal.BUSY
    run(controller, plant, 1.0)
    assert speed(plant) < 0.01
    assert np.linalg.norm(tool(plant) - start) < 0.15
    controller.stop()
    controller.deactivate()
    assert controller.mode is Mode.FAULT
    assert controller.latched == A_TEST
    controller.reset()
    run(controller, plant, 0.2)
    assert controller.mode is Mode.HOLD


@pytest.mark.requirement("S-44")
def test_a_driver_that_starts_again_from_zero_faults_and_can_be_reset() -> None:
    controller, _ = begin()
    for k in range(110):
        controller.step(k * PERIOD_NS, HOME, np.zeros(7))
    assert controller.mode is Mode.FAULT
    controller.reset()
    controller.step(110 * PERIOD_NS, HOME, np.zeros(7))
    assert controller.mode is Mode.HOLD


@pytest.mark.requirement("S-41")
@pytest.mark.parametrize("friction", [0.5, 2.0])
def test_without_states_the_arm_is_braked_by_its_model_alone(friction: float) -> None:
    assert np.array_equal(make().stale_torque(), np.zeros(7))
    controller, plant, tau = executing(0.4, friction=friction)
    speeds = []
    for _ in range(500):
        before, tau = tau, controller.stale_torque()
        check(tau, before)
        plant.step(tau)
        speeds.append(speed(plant))
    assert max(speeds) < speeds[0] + 0.05
    assert max(speeds[250:]) < safety.REST_SPEED
    assert np.abs(tau - MODEL.gravity(plant.q)).max() < MODEL.friction.max()


@pytest.mark.requirement("S-41")
@pytest.mark.parametrize("moment", [0.22, 0.4])
def test_a_loss_of_states_detected_late_is_braked_from_the_predicted_state(moment: float) -> None:
    controller, plant, tau = executing(moment, friction=1.0, delay=2, sensing=True)
    for _ in range(8):
        plant.step(tau)
    speeds, elapsed = [], 9 * 0.002
    for _ in range(500):
        tau = controller.stale_torque(elapsed)
        plant.step(tau)
        speeds.append(speed(plant))
        elapsed = 0.002
    assert max(speeds) > 0.5
    assert max(speeds[60:]) < 0.02
    assert np.abs(tau - MODEL.gravity(plant.q)).max() < 0.15  # friction covers it


@pytest.mark.requirement("S-14")
def test_without_a_velocity_from_the_driver_positions_are_differentiated() -> None:
    controller, plant = begin(sensing=True, delay=1)
    controller.execute()
    positions = []
    while controller.mode is Mode.ROLLOUT:
        stamp, q, _ = plant.state()
        positions.append(tool(plant))
        plant.step(controller.step(stamp, q, None))
    assert controller.mode is Mode.HOLD, controller.latched
    x, _ = reproduced(POLICY, positions[0])
    assert np.linalg.norm(np.array(positions)[: len(x)] - x, axis=1).max() < 0.02


@pytest.mark.requirement("S-02")
def test_a_law_without_a_torque_is_a_fault_and_not_an_exception(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def singular(*_: object) -> np.ndarray:
        return np.linalg.solve(np.zeros((7, 7)), np.ones(7))

    def infinite(*_: object) -> np.ndarray:
        return np.full(7, np.inf)

    def wrong(*_: object) -> np.ndarray:
        raise KeyError("a mistake in the code")

    for law, reason in ((singular, "Singular"), (infinite, "not finite"), (wrong, "a mistake")):
        monkeypatch.setattr(torque_law, "operational_space", law)
        controller, *_ = executing(0.1)
        assert reason in controller.latched.text


@pytest.mark.requirement("S-01", "S-41")
def test_however_long_states_were_missing_20_ms_are_predicted_and_two_periods_of_torque_sent() -> (
    None
):
    answers = []
    for silence in (0.02, 0.5, 1e4):
        controller, _, before = executing(0.3, friction=1.0, delay=2, sensing=True)
        controller.stop()
        answers.append(controller.stale_torque(silence))
        change = np.abs(answers[-1] - before)
        assert np.all(change <= 2.0 * 0.002 * LIMITS.torque_rate + 1e-9)
        assert np.any(change >= 2.0 * 0.002 * LIMITS.torque_rate - 1e-9)  # it wants to be more
    assert np.array_equal(answers[0], answers[1]) and np.array_equal(answers[0], answers[2])


@pytest.mark.requirement("S-104")
@pytest.mark.parametrize("on", [True, False])
def test_gravity_compensation_is_neither_begun_nor_ended_in_a_fault(on: bool) -> None:
    controller, plant = begin()
    controller.set_gravity_compensation(True)
    run(controller, plant, 0.1)
    controller.fault(A_TEST)
    assert refusal_of(lambda: controller.set_gravity_compensation(on)) is Refusal.FAULT
    run(controller, plant, 0.5)
    controller.reset()
    controller.set_gravity_compensation(False)  # it holds already


@pytest.mark.requirement("S-104")
def test_gravity_compensation_is_not_ended_while_the_arm_moves_by_itself() -> None:
    controller, *_ = executing(0.1)
    assert refusal_of(lambda: controller.set_gravity_compensation(False)) is Refusal.BUSY
    assert controller.mode is Mode.ROLLOUT


@pytest.mark.requirement("S-123")
def test_the_time_of_torques_without_a_state_is_not_used_again_by_the_next_state() -> None:
    controller, plant, _ = executing(0.3, friction=1.0, delay=2, sensing=True)
    controller.stale_torque(0.002)
    before = controller.stale_torque(0.0015)
    plant.stamp += PERIOD_NS
    plant.q = plant.q + 0.05  # it wants another torque
    tau = controller.step(*plant.state(), elapsed=0.0036)
    change = np.abs(tau - before)
    assert np.all(change <= 1e-4 * LIMITS.torque_rate * (1.0 + 1e-9))
    assert np.any(change > 0.99e-4 * LIMITS.torque_rate)


def test_an_activation_trusts_the_states_again() -> None:
    controller, _ = begin()
    controller._supervision.doubt(FaultKind.JUMP)
    controller.deactivate()
    assert not controller._supervision.believed
    controller.hold()
    assert controller._supervision.believed


@pytest.mark.requirement("S-134")
@pytest.mark.parametrize(
    ("adds", "meant", "settings"),
    [(1.0, "true", {}), (0.0, "false", {"driver_compensates_gravity": True})],
)
def test_gravity_that_is_carried_twice_or_by_nobody_is_refused_by_name_and_then_carried_once(
    adds: float, meant: str, settings: dict[str, bool]
) -> None:
    def driver(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return adds * MODEL.gravity(q)

    controller, plant = begin(controller=make(**settings), push=driver, friction=1.0)
    assert f"driver_compensates_gravity: {meant}" in controller.latched.text
    run(controller, plant, 0.3)
    at = plant.q
    run(controller, plant, 1.0)
    assert np.abs(plant.q - at).max() < 0.05
    assert np.abs(plant.q - HOME).max() < 0.1
