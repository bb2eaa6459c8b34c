# SPDX-License-Identifier: Apache-2.0
"""Positions or poses in place of torques: what is sent, to an arm whose servo follows late."""

from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rigid_arm import A_TEST, HOME, NAMES, POLICY, URDF

from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.feasibility import simulate_policy
from wam_power_ros.control.inverse_kinematics import damped_step
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.reference_output import (
    SLACK,
    STOP_TIME,
    ReferenceController,
    controller_of,
)
from wam_power_ros.control.replay_trajectory import sampled
from wam_power_ros.control.safety import limits_of
from wam_power_ros.faults import FaultKind

ARM = Arm(URDF, NAMES)
LIMITS = limits_of(ARM)
FAST = ControllerSettings(limits=LIMITS, set_point_period=0.002, move_speed=1.0)


class Driver:
    """Controller, and an arm: a delay, then two low-passes of half a lag [s].

    With poses it finds a posture near its last, which wanders without moving the tool [rad/s].
    """

    def __init__(
        self,
        period: float = 0.002,
        set_point: float = 0.0,
        delay: float = 0.01,
        lag: float = 0.01,
        poses: bool = False,
    ) -> None:
        update = {"state_period": period, "set_point_period": set_point or period, "poses": poses}
        self.poses, self.wander, self.posture = poses, 0.0, HOME
        self.controller, self.period = controller_of(ARM, FAST.model_copy(update=update)), period
        self.stamp = 10**12
        self.q, self.qd = HOME.copy(), np.zeros(7)
        self.delayed = deque([HOME] * (round(delay / period) + 1), maxlen=round(delay / period) + 1)
        self.share, self.grip = 1.0 - np.exp(-2.0 * period / lag), 1.0
        self.smooth = HOME
        self.blocked = self.guided = False
        self.sent: list[np.ndarray] = []  # while active
        self.tick()
        self.sent.clear()
        self.controller.hold()

    def tick(self) -> np.ndarray:
        """One state, its answer, and what the arm makes of it."""
        self.stamp += round(self.period * 1e9)
        reference = self.controller.step(self.stamp, self.q, self.qd)
        return self.take(reference)

    def take(self, reference: np.ndarray) -> np.ndarray:
        """Move the arm by one period."""
        if self.controller.mode is not Mode.INACTIVE:
            self.sent.append(reference)
        if self.poses:
            reference = self.chosen(reference)
        self.delayed.append(reference)
        if not self.guided:
            self.grip = 0.9 * self.grip if self.blocked else 1.0
            self.smooth = self.smooth + self.share * (self.delayed[0] - self.smooth)
            moved = self.grip * self.share * (self.smooth - self.q)
            self.q, self.qd = self.q + moved, moved / self.period
        else:
            self.smooth = self.posture = self.q
        return self.sent[-1] if self.sent else reference

    def chosen(self, pose: np.ndarray) -> np.ndarray:
        """Posture with the tool at a pose, which is the driver's choice."""
        jacobian = ARM.jacobian(self.posture)
        free = np.linalg.svd(jacobian)[2][6]
        q = self.posture + self.wander * self.period * free * np.sign(free[2])
        for _ in range(2):  # it knows no limits
            now, turned = ARM.tool_pose(q)
            turn = rotations.log_of_one(rotations.matrix(pose[3:]) @ turned.T)
            q = q + damped_step(ARM.jacobian(q), np.concatenate([pose[:3] - now, turn]))
        self.posture = q
        return q

    def places(self, rows: np.ndarray) -> np.ndarray:
        """Postures (T, 7) as they are sent: the same, or the positions (T, 3) of the tool [m]."""
        return np.array([ARM.tool_pose(q)[0] for q in rows]) if self.poses else rows

    def sent_places(self) -> np.ndarray:
        """What was sent, as `places`."""
        return np.array(self.sent)[:, : 3 if self.poses else 7]

    def away(self) -> float:
        """Largest distance of the arm from what was sent last [rad], or of its tool [m]."""
        return float(np.abs(self.places(self.q[None])[0] - self.sent_places()[-1]).max())

    def run(self, seconds: float) -> None:
        """Tick for a time [s]."""
        for _ in range(round(seconds / self.period)):
            self.tick()

    def until(self, reached: Callable[[], bool], seconds: float = 30.0) -> None:
        """Tick until something is reached."""
        for _ in range(round(seconds / self.period)):
            if reached():
                return
            self.tick()
        raise AssertionError(self.controller.latched)

    def ready(self) -> None:
        """Move to the start of the policy."""
        self.controller.load(POLICY)
        self.until(lambda: self.controller.at_rest)
        self.controller.move_to_start()
        self.until(lambda: self.controller.ready)


def swing(duration: float = 1.0, size: float = 0.4) -> tuple[np.ndarray, np.ndarray]:
    """A movement of two joints there and back."""
    t = np.linspace(0.0, duration, 100)
    s = np.sin(np.pi * t / duration) ** 2
    return t, HOME + size * s[:, None] * np.array([1.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("period", "set_point", "delay", "lag", "poses"),
    [(0.002, 0.008, 0.04, 0.02, False), (0.004, 0.0, 0.08, 0.04, True)],
)
def test_a_rollout_by_references_is_the_simulated_one_at_any_rate_and_delay(
    period: float, set_point: float, delay: float, lag: float, poses: bool
) -> None:
    driver = Driver(period, set_point, delay, lag, poses)
    driver.ready()
    driver.sent.clear()
    driver.controller.execute()
    driver.until(lambda: driver.controller.mode is not Mode.ROLLOUT)
    assert driver.controller.mode is Mode.HOLD, driver.controller.latched
    simulated = simulate_policy(ARM, driver.controller.settings, POLICY).q
    rows = np.round(np.arange(1, len(driver.sent) + 1) * period / 0.002).astype(int)
    known = rows < len(simulated)
    wanted = driver.places(simulated[rows[known]])
    assert np.abs(driver.sent_places()[known] - wanted).max() < 0.03
    path = driver.controller.take_finished()
    assert path.t[-1] > POLICY.basis.duration + 0.9
    assert np.ptp(path.position, axis=0).max() > 0.05  # of the arm: it did throw


@pytest.mark.requirement("S-150")
@settings(max_examples=10)
@given(st.data())
def test_no_reference_is_a_step_whatever_is_asked_reported_or_lost(data: st.DataObject) -> None:
    period = data.draw(st.sampled_from((0.002, 0.008)), "period")
    poses = data.draw(st.booleans(), "poses")
    driver = Driver(period, data.draw(st.sampled_from((0.0, 0.008)), "set point"), poses=poses)
    driver.wander = data.draw(st.sampled_from((0.0, 0.3)), "wander")
    controller = driver.controller
    step = LIMITS.qd_max * max(period, controller.settings.set_point_period)
    movement = sampled(*swing(size=0.7), controller.settings.period, LIMITS)
    rng = np.random.default_rng(data.draw(st.integers(0, 1000), "seed"))
    controller.load(POLICY)

    def lose() -> None:
        for _ in range(data.draw(st.integers(1, 30), "lost")):
            driver.take(controller.stale_torque(period))
        driver.stamp += 20_000_000

    def miss() -> None:
        driver.stamp += 16_000_000

    def jump() -> None:
        driver.q = driver.q + rng.normal(0.0, 0.5, 7)

    def guide() -> None:
        controller.set_gravity_compensation(True)
        driver.guided = True
        for _ in range(100):
            driver.q = driver.q + (moved := 0.3 * period * rng.uniform(-1.0, 1.0, 7))
            driver.qd = moved / period
            driver.tick()
        driver.qd = np.zeros(7)

    def release() -> None:
        driver.guided = False
        controller.set_gravity_compensation(False)

    def refuse() -> None:
        for _ in range(5):
            driver.take(controller.step(driver.stamp + 1, np.full(7, np.nan), None))

    acts = (
        *(controller.move_to_start, controller.execute, controller.stop, controller.hold),
        *(lambda: controller.start_replay(movement), lambda: controller.fault(A_TEST)),
        *(controller.reset, lose, miss, jump, guide, release, refuse),
        *(lambda: setattr(driver, "blocked", not driver.blocked), lambda: driver.run(1.0)),
        lambda: setattr(controller._joints, "torque", None),  # a mistake in the code
    )
    for _ in range(data.draw(st.integers(1, 12), "acts")):
        try:
            data.draw(st.sampled_from(acts), "act")()
        except ControllerError:
            pass
        driver.run(data.draw(st.sampled_from((0.0, 0.05, 0.5)), "time"))
    if not driver.sent:
        return
    sent = np.array(driver.sent)
    assert np.isfinite(sent).all()
    if poses:  # each joint turns the tool by its own step, and moves it by that times the reach
        turn = rotations.matrix(sent[1:, 3:]) @ rotations.matrix(sent[:-1, 3:]).transpose(0, 2, 1)
        assert np.all(np.linalg.norm(rotations.log(turn), axis=1) <= step.sum() + 1e-6)
        assert np.all(np.linalg.norm(np.diff(sent[:, :3], axis=0), axis=1) <= 1.3 * step.sum())
        assert np.all(np.sum(sent[1:, 3:] * sent[:-1, 3:], axis=1) > 0.9)  # no change of sign
        return
    assert np.all(np.abs(sent[0] - HOME) <= step * (1.0 + 1e-9))
    assert np.all(np.abs(np.diff(sent, axis=0)) <= step * (1.0 + 1e-9))


@pytest.mark.requirement("S-150")
def test_after_a_gap_of_states_the_references_catch_up_without_a_step() -> None:
    driver = Driver(lag=0.05)
    driver.until(lambda: driver.controller.at_rest)
    driver.controller.start_replay(sampled(*swing(size=0.7), 0.002, LIMITS))
    driver.run(0.25)  # and some time to get to the start
    driver.until(lambda: bool(np.abs(np.subtract(*driver.sent[-2:])).max() > 0.6 * 0.002 * 2.0))
    for _ in range(7):  # nothing is sent in this time
        driver.stamp += 2_000_000
        driver.take(driver.sent[-1])
    driver.run(0.1)
    assert np.all(np.abs(np.diff(driver.sent, axis=0)) <= 0.002 * LIMITS.qd_max * (1.0 + 1e-9))
    assert driver.controller.mode is Mode.REPLAY, driver.controller.latched


@pytest.mark.requirement("S-151")
@pytest.mark.parametrize(("begun", "poses"), [(0.25, True), (0.4, False)])
def test_in_a_fault_the_references_come_to_rest_and_stay(begun: float, poses: bool) -> None:
    driver = Driver(poses=poses)
    driver.ready()
    driver.controller.execute()
    driver.run(begun)
    driver.sent.clear()
    driver.controller.fault(A_TEST)
    driver.run(1.0)
    speeds = np.diff(driver.sent, axis=0) / 0.002
    assert np.abs(np.diff(speeds, axis=0)).max() / 0.002 <= 7.6 * LIMITS.qd_max.max()
    assert not speeds[round(STOP_TIME / 0.002) + 1 :].any()
    assert driver.away() < 1e-3


@pytest.mark.requirement("S-151")
def test_lost_states_are_a_fault_for_which_no_state_is_needed() -> None:
    driver = Driver()
    driver.ready()
    driver.controller.execute()
    driver.run(0.3)
    for _ in range(10):  # it goes on
        driver.take(driver.controller.stale_torque(0.002))
    assert np.abs(driver.sent[-1] - driver.sent[-5]).max() > 0.001
    driver.controller.fault(A_TEST)  # as the watchdog finds
    for _ in range(200):
        driver.take(driver.controller.stale_torque(0.002))
    np.testing.assert_array_equal(driver.sent[-1], driver.sent[-2])


@pytest.mark.requirement("S-152")
@pytest.mark.parametrize("poses", [False, True])
def test_an_arm_that_does_not_follow_is_a_fault_and_a_reset_brings_the_references_back(
    poses: bool,
) -> None:
    driver = Driver(poses=poses)
    driver.until(lambda: driver.controller.at_rest)
    movement = sampled(*swing(2.0, 1.0), 0.002, LIMITS)
    driver.controller.start_replay(movement)
    driver.run(0.4)
    driver.blocked = True
    driver.until(lambda: driver.controller.mode is Mode.FAULT, 2.0)
    assert driver.controller.latched.kind is FaultKind.TRACKING
    driver.run(1.0)
    assert driver.away() > 0.1
    driver.controller.reset()
    driver.run(1.0)
    assert driver.controller.mode is Mode.HOLD
    assert driver.away() < 0.01


def test_references_stay_near_a_guided_arm_and_one_that_sags_does_not_sink() -> None:
    driver = Driver(lag=0.05)
    driver.until(lambda: driver.controller.unexplained.known)
    driver.controller.set_gravity_compensation(True)
    held = driver.tick()
    for share in np.linspace(0.0, 1.0, 500):  # of the slack: in no free drive it sags
        np.testing.assert_array_equal(driver.tick(), held)
        driver.q, driver.qd = held + share * 0.9 * SLACK, np.zeros(7)
    driver.guided = True
    for speed in 0.05 * np.sin(np.linspace(0.0, np.pi, 3000)):
        driver.q, driver.qd = driver.q + 0.002 * speed, np.full(7, speed)
        driver.tick()
    assert driver.controller.mode is Mode.GRAVITY_COMPENSATION, driver.controller.latched
    assert np.abs(driver.tick() - driver.q).max() <= SLACK + 1e-9
    driver.controller.set_gravity_compensation(False)
    driver.guided = False
    driver.run(0.5)
    assert driver.controller.mode is Mode.HOLD, driver.controller.latched


@pytest.mark.requirement("S-150")
def test_after_a_deactivation_in_a_fault_the_references_begin_where_the_arm_is() -> None:
    driver = Driver()
    driver.ready()
    driver.controller.fault(A_TEST)
    driver.run(0.5)
    driver.controller.deactivate()
    driver.guided = True  # another controller moves it
    for _ in range(1000):
        driver.q = driver.q + 0.0003
        driver.tick()
    assert np.abs(driver.tick() - driver.q).max() <= SLACK + 1e-9
    latched = ReferenceController(ARM, driver.controller.settings, A_TEST)
    for tick in range(1, 150):
        reference = latched.step(driver.stamp + tick * 2_000_000, driver.q, np.zeros(7))
        np.testing.assert_array_equal(reference, driver.q)
    latched.reset()


def fail(*_: object) -> None:
    raise ZeroDivisionError


@pytest.mark.requirement("S-150")
@pytest.mark.parametrize(
    ("name", "broken"), [("resisted_dynamics", lambda *_: np.full(7, np.nan)), ("motion", fail)]
)
def test_a_model_that_is_nowhere_or_raises_leaves_references_that_come_to_rest(
    monkeypatch: pytest.MonkeyPatch, name: str, broken: Callable[..., object]
) -> None:
    driver = Driver()
    driver.ready()
    driver.controller.execute()
    driver.run(0.2)
    monkeypatch.setattr(ARM, name, broken)
    driver.run(0.5)
    assert driver.controller.latched.kind is FaultKind.COMPUTATION
    assert np.isfinite(driver.sent).all()
    np.testing.assert_array_equal(driver.sent[-1], driver.sent[-2])


def wandered() -> Driver:
    """Driver that has gone into another posture than the model's in a hold."""
    driver = Driver(period=0.008, poses=True)
    driver.ready()
    driver.wander = 0.3
    driver.until(lambda: bool(np.abs(driver.q - HOME).max() > 0.3))
    driver.wander = 0.0
    driver.run(0.5)
    return driver


def test_a_posture_that_is_beyond_a_joint_limit_is_a_fault_whoever_chose_it() -> None:
    driver = wandered()
    driver.wander = 1.0
    driver.until(lambda: driver.controller.mode is Mode.FAULT)
    assert driver.controller.latched.kind is FaultKind.JOINT_POSITION
    assert np.ptp(driver.sent_places(), axis=0).max() < 0.002  # the tool tells nothing of it


@pytest.mark.requirement("S-150")
@pytest.mark.parametrize("then", ["reset", "guide"])
def test_the_tool_rests_while_references_take_up_the_posture_that_the_driver_chose(
    then: str,
) -> None:
    driver = wandered()
    if then == "reset":
        driver.controller.fault(A_TEST)
        driver.run(0.5)
    driver.sent.clear()
    if then == "reset":
        driver.controller.reset()
    else:
        driver.controller.set_gravity_compensation(True)
    driver.run(1.0)
    assert driver.controller.mode is not Mode.FAULT
    assert np.ptp(driver.sent_places(), axis=0).max() < 1e-3
    if then == "guide":
        driver.controller.set_gravity_compensation(False)
    driver.ready()  # by postures that begin at that of the arm
    assert driver.controller.mode is Mode.HOLD, driver.controller.latched


def test_the_numbers_of_a_pose_do_not_jump_where_its_quaternion_changes_sign() -> None:
    controller, turn = Driver(poses=True).controller, np.eye(ARM.n)[-1]
    angles = np.linspace(-2.0 * np.pi, 2.0 * np.pi, 800)
    sent = np.array([controller._pose_of(HOME + angle * turn) for angle in angles])
    assert np.abs(np.diff(sent, axis=0)).max() < 0.02


def test_a_tool_that_is_away_from_the_start_is_refused_there() -> None:
    driver = Driver(poses=True)
    driver.ready()
    driver.guided = True
    for speed in 0.2 * np.sin(np.linspace(0.0, np.pi, 300)):  # 6 cm: that is no fault yet
        driver.qd = speed * np.eye(7)[0]
        driver.q = driver.q + 0.002 * driver.qd
        driver.tick()
    with pytest.raises(ControllerError, match=r"the tool is .* from the start"):
        driver.controller.execute()
