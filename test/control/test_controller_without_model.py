# SPDX-License-Identifier: Apache-2.0
"""A controller whose model raises brakes the arm, holds it, and goes on."""

import math

import numpy as np
import pytest
from rigid_arm import A_TEST, HOME, MODEL, NAMES, POLICY, URDF, Plant, check, speed, tool

from wam_power_ros.control import safety
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.corrections import Corrections
from wam_power_ros.control.fault_hold import BrakeWithoutModel
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.faults import FaultKind

DYNAMICS = ("gravity", "mass_matrix", "bias", "dynamics", "inverse_dynamics")
ALL = (*DYNAMICS, "motion", "speeds", "tool_pose", "jacobian")


class BreakingArm(Arm):
    """An arm whose methods named in `broken` raise."""

    broken: tuple[str, ...] = ()

    def __getattribute__(self, name: str) -> object:
        if name in object.__getattribute__(self, "broken"):
            raise np.linalg.LinAlgError("Singular matrix")
        return object.__getattribute__(self, name)


class Bench:
    """A controller and a plant with delay, encoders and friction."""

    def __init__(self, q: np.ndarray = HOME, **plant: object) -> None:
        self.arm = BreakingArm(URDF, NAMES)
        adds = bool(plant.get("adds_gravity"))
        limits = safety.limits_of(self.arm, teaching_tool_speed=4.0)
        settings = ControllerSettings(driver_compensates_gravity=adds, limits=limits)
        self.controller = Controller(self.arm, settings)
        self.controller.load(POLICY)
        self.plant = Plant(q, **({"delay": 2, "sensing": True, "friction": 1.0} | plant))
        self.torques = [self.controller.step(*self.plant.state())]
        self.controller.hold()
        self.run(0.2)

    def run(self, seconds: float) -> list[float]:
        """Close the loop; every torque is checked. Returns the speeds [m/s]."""
        speeds = []
        for _ in range(round(seconds / 0.002)):
            tau = self.controller.step(*self.plant.state())
            check(tau, self.torques[-1])
            self.torques.append(tau)
            self.plant.step(tau)
            speeds.append(speed(self.plant))
        return speeds

    def begin(self, mode: str) -> None:
        """Begin to move in a mode, up to a moment at which the arm is fast."""
        if mode == "rollout":
            self.controller.execute()
            self.run(0.5)
        elif mode == "move":
            self.controller.move_to_start()
            self.run(0.8)
        elif mode == "teaching":
            self.controller.set_gravity_compensation(True)
            self.plant.push = lambda t, q, qd: MODEL.jacobian(q)[:3].T @ [0.0, 1.0, 3.0]
            self.run(0.2)
            self.plant.push = None


@pytest.mark.requirement("S-112")
@pytest.mark.parametrize(
    ("mode", "broken"),
    [
        ("rollout", ("motion",)),
        ("rollout", ALL),
        ("move", DYNAMICS),
        ("teaching", ("gravity",)),
        ("hold", ALL),
    ],
    ids=str,
)
def test_whatever_raises_the_arm_is_braked_and_stays_where_it_stopped(
    mode: str, broken: tuple[str, ...]
) -> None:
    bench = Bench(HOME + 0.4 if mode == "move" else HOME)
    bench.begin(mode)
    bench.arm.broken = broken
    for _ in range(200):
        peak = speed(bench.plant)
        bench.run(0.002)
        if bench.controller.latched is not None:
            break
    assert bench.controller.latched.kind is FaultKind.COMPUTATION
    braking = bench.run(0.5)
    assert max(braking) < peak + 0.1
    assert braking[-1] < safety.REST_SPEED
    stopped = tool(bench.plant)
    assert max(bench.run(2.0)) < safety.REST_SPEED
    assert np.linalg.norm(tool(bench.plant) - stopped) < 0.02
    bench.arm.broken = ()
    bench.run(0.3)
    bench.controller.reset()
    assert max(bench.run(0.3)) < safety.REST_SPEED
    assert bench.controller.mode is Mode.HOLD


@pytest.mark.requirement("S-112")
def test_an_exception_in_one_state_alone_is_a_fault_and_a_stop() -> None:
    bench = Bench()
    bench.begin("rollout")
    bench.arm.broken = ALL
    bench.run(0.002)
    bench.arm.broken = ()
    assert bench.controller.mode is Mode.FAULT and bench.controller.label == "fault"
    assert isinstance(bench.controller.take_error(), np.linalg.LinAlgError)
    assert bench.controller.take_error() is None
    assert bench.run(0.5)[-1] < safety.REST_SPEED
    assert bench.controller.take_finished().id == POLICY.id


@pytest.mark.requirement("S-112")
def test_a_driver_that_adds_gravity_is_not_sent_it_twice() -> None:
    bench = Bench(adds_gravity=True)
    bench.begin("rollout")
    bench.arm.broken = ALL
    assert bench.run(0.5)[-1] < safety.REST_SPEED
    bench.run(1.0)
    assert np.abs(bench.torques[-1]).max() < 0.2 * np.abs(MODEL.gravity(HOME)).max()


@pytest.mark.requirement("S-112")
def test_without_states_and_without_a_model_gravity_is_carried() -> None:
    bench = Bench()
    bench.begin("rollout")
    gravity = MODEL.gravity(bench.plant.q)
    bench.arm.broken = ALL
    for _ in range(100):
        tau = bench.controller.stale_torque(0.002)
        check(tau, bench.torques[-1])
        bench.torques.append(tau)
    np.testing.assert_allclose(tau, gravity, atol=1.0)
    assert bench.controller.latched.kind is FaultKind.COMPUTATION


@pytest.mark.requirement("S-112")
def test_no_more_than_a_period_of_the_torque_rate_is_given_to_a_failed_computation() -> None:
    bench = Bench()
    bench.begin("rollout")
    bench.arm.broken = ALL
    for elapsed in (1e-5, 0.002, 3.0):
        for step in (
            lambda: bench.controller.step(*bench.plant.state(), elapsed),  # noqa: B023
            lambda: bench.controller.stale_torque(elapsed),  # noqa: B023
        ):
            before = bench.controller._output.sent
            bench.plant.stamp += 2_000_000
            bench.plant.q = bench.plant.q + 0.01  # pulls the spring
            check(step(), before, min(elapsed, 0.002))


@pytest.mark.requirement("S-112")
def test_a_torque_that_is_not_finite_is_never_sent() -> None:
    bench = Bench()
    bench.begin("rollout")

    class NotANumber(BreakingArm):
        def gravity(self, q: np.ndarray) -> np.ndarray:
            return np.full(7, math.nan)

        def mass_matrix(self, q: np.ndarray) -> np.ndarray:
            return np.full((7, 7), math.nan)

    bench.arm.__class__ = NotANumber
    bench.arm.broken = ("dynamics", "inverse_dynamics")
    assert bench.run(0.5)[-1] < safety.REST_SPEED  # `run` checks every torque
    assert bench.controller.latched.kind is FaultKind.COMPUTATION


def observed() -> BrakeWithoutModel:
    """A brake of an arm that was at rest at home."""
    brake = BrakeWithoutModel(MODEL, driver_compensates_gravity=False)
    brake.observe(MODEL, HOME, np.zeros(7))
    return brake


def state(q: np.ndarray, qd: np.ndarray) -> JointState:
    return JointState(0, q, qd, 0.002, 0.002)


@pytest.mark.requirement("S-112")
def test_what_brakes_the_arm_is_of_a_posture_at_most_20_ms_before() -> None:
    brake = observed()
    for k in range(1, 30):
        brake.observe(MODEL, HOME + 0.01 * k, np.zeros(7))
    np.testing.assert_array_equal(brake.torque(None, 0.002), MODEL.gravity(HOME + 0.2))


@pytest.mark.requirement("S-112")
@pytest.mark.parametrize("offset", [-1.0, 0.001, 1.0])
def test_the_spring_that_holds_the_braked_arm_is_bounded(offset: float) -> None:
    brake, still = observed(), np.zeros(7)
    gravity, mass = MODEL.gravity(HOME), MODEL.mass_matrix(HOME)
    np.testing.assert_array_equal(brake.torque(state(HOME, still), 0.002), gravity)
    spring = brake.torque(state(HOME + offset, still), 0.002) - gravity
    bound = 2.0 * MODEL.friction + 0.05 * MODEL.tau_max
    pulled = -(25.0**2) * mass @ np.full(7, offset)
    np.testing.assert_allclose(spring, np.clip(pulled, -bound, bound), atol=1e-12)


@pytest.mark.requirement("S-112")
def test_motors_that_were_measured_to_be_weak_carry_the_arm_without_a_model() -> None:
    arm = BreakingArm(URDF, NAMES, corrections=Corrections.from_values(7, torque_scales=0.8))
    controller, plant = Controller(arm), Plant(HOME)
    controller.step(*plant.state())
    controller.hold()
    for k in range(200):
        arm.broken = ALL if k >= 100 else ()
        plant.stamp += 2_000_000
        tau = controller.step(*plant.state())
    assert controller.latched is not None
    assert np.allclose(0.8 * tau, MODEL.gravity(HOME), atol=0.05)


@pytest.mark.requirement("S-112")
def test_an_impossible_speed_is_not_braked_as_if_it_were_true() -> None:
    brake = observed()
    brake.torque(state(HOME, np.full(7, 400.0)), 0.002)
    q_ref, qd_ref = brake._reference
    assert np.all(qd_ref <= MODEL.qd_max) and np.all(q_ref - HOME <= 0.002 * MODEL.qd_max)


@pytest.mark.requirement("S-112")
def test_without_a_computed_torque_an_arm_is_neither_activated_nor_reset() -> None:
    arm = BreakingArm(URDF, NAMES)
    controller, plant = Controller(arm), Plant(HOME)
    arm.broken = ALL
    for _ in range(5):
        assert not controller.step(*plant.state()).any()
        plant.stamp += 2_000_000
    with pytest.raises(ControllerError, match="no torque could be computed"):
        controller.hold()
    assert controller.mode is Mode.INACTIVE
    arm.broken = ()
    controller.step(*plant.state())
    controller.hold()
    plant.stamp += 2_000_000
    arm.broken = ALL
    controller.step(*plant.state())
    with pytest.raises(ControllerError, match="reset refused: no torque could be computed"):
        controller.reset()


def test_a_stop_whose_rollout_has_no_path_is_a_fault() -> None:
    bench = Bench()
    bench.controller.execute()
    bench.arm.broken = ALL  # before the first state of the rollout
    bench.controller.stop()
    assert bench.controller.mode is Mode.FAULT
    assert bench.run(0.1)[-1] < safety.REST_SPEED


@pytest.mark.requirement("S-112")
@pytest.mark.parametrize("mode", ["rollout", "teaching"])
def test_when_torques_can_be_computed_again_the_arm_is_not_taken_for_one_that_still_moves(
    mode: str,
) -> None:
    bench = Bench()
    bench.begin(mode)
    bench.controller.fault(A_TEST)
    bench.run(0.01)  # its motion is estimated from now on
    bench.arm.broken = ALL
    bench.run(0.5)
    bench.arm.broken = ()
    assert max(bench.run(1.0)) < 0.02


@pytest.mark.requirement("S-112")
def test_without_a_model_an_arm_is_at_rest_below_a_joint_speed() -> None:
    bench = Bench()
    bench.arm.broken = ALL
    stamp, q, _ = bench.plant.state()
    for k, (joint_speed, rests) in enumerate(((0.049, True), (0.051, False)), 1):
        bench.controller.step(stamp + k, q, joint_speed * np.eye(7)[3])
        assert bench.controller.at_rest is rests


@pytest.mark.requirement("S-112")
def test_the_brake_without_a_model_holds_ahead_of_where_the_model_failed() -> None:
    brake, qd = observed(), np.eye(7)[3]
    for k in range(500):  # an arm that follows its reference exactly: no torque but g
        way, slower = -np.expm1(-0.04 * k) / safety.FAULT_DAMPING, np.exp(-0.04 * k)
        tau = brake.torque(state(HOME + way * qd, slower * qd), 0.002)
    assert np.abs(tau - MODEL.gravity(HOME)).max() < 0.1


@pytest.mark.requirement("S-112")
def test_the_brake_without_a_model_takes_a_later_speed_within_a_tenth_of_a_second() -> None:
    brake, later = observed(), 0.1 * np.eye(7)[3]
    for qd in (np.zeros(7), later):
        tau = brake.torque(state(HOME, qd), 0.002)
    braking = np.linalg.solve(MODEL.mass_matrix(HOME), tau - MODEL.gravity(HOME))
    assert -60.0 < braking[3] / later[3] < -20.0
    assert np.abs(np.delete(braking, 3)).max() < 1e-9
