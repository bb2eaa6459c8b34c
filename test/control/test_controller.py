# SPDX-License-Identifier: Apache-2.0
"""The controller against the arm of `rigid_arm`."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from open_loop import reproduced
from rigid_arm import (
    A_TEST,
    HOME,
    LIMITS,
    MODEL,
    NAMES,
    PERIOD_NS,
    POLICY,
    URDF,
    Plant,
    begin,
    check,
    make,
    make_policy,
    run,
    tool,
)

from wam_power_ros import rotations
from wam_power_ros.control import safety, torque_law
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import TRANSITIONS, ControllerError, Mode
from wam_power_ros.learning import dmp
from wam_power_ros.learning.policy import Policy, with_id
from wam_power_ros.learning.rollout import EndEffectorPath, FaultKind

# ------------------------------------------------------------------------------ gravity and hold


def test_gravity_compensation_carries_the_arm_where_it_is() -> None:
    for q in (HOME, np.deg2rad([30.0, -40.0, 20.0, 80.0, -50.0, 30.0, 60.0])):
        controller, plant = begin(q)
        controller.set_gravity_compensation(True)
        run(controller, plant, 2.0)
        assert np.abs(plant.q - q).max() < 1e-3
        assert controller.label == "gravity_compensation"


def test_a_hand_can_teach_a_toss_at_2_5_metres_a_second() -> None:
    start = MODEL.tool_pose(HOME)[0]
    wrist = start - np.array([0.34, 0.0, 0.0])
    speeds = []

    def pan(t: float) -> tuple[np.ndarray, np.ndarray]:
        """The hand's wish: up by 6 cm while the front edge flicks up by 46 degrees."""
        s = np.clip((t - 0.3) / 0.25, 0.0, 1.0)
        share = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
        rotation = rotations.exp(np.array([0.0, -0.8 * share, 0.0]))
        return wrist + np.array([0.0, 0.0, 0.06 * share]) + 0.34 * rotation[:, 0], rotation

    def hand(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        motion = MODEL.motion(q, qd)
        (before, turned_before), (after, turned_after) = pan(t - 1e-4), pan(t + 1e-4)
        speed = (after - before) / 2e-4
        spin = rotations.log(turned_after @ turned_before.T) / 2e-4
        force = 3000.0 * (0.5 * (before + after) - motion.position)
        turn = 60.0 * rotations.log(turned_after @ motion.rotation.T)
        speeds.append(motion.tool_speed)
        wrench = np.concatenate(
            [force + 120.0 * (speed - motion.twist[:3]), turn + 3.0 * (spin - motion.twist[3:])]
        )
        return MODEL.jacobian(q).T @ wrench

    controller, plant = begin(sensing=True, delay=2, friction=1.0)
    controller.set_gravity_compensation(True)
    plant.push = hand
    run(controller, plant, 0.7)
    assert controller.mode is Mode.GRAVITY_COMPENSATION, controller.latched
    assert max(speeds) > 2.4
    assert np.linalg.norm(tool(plant) - pan(9.0)[0]) < 0.01


@pytest.mark.parametrize(("delay", "sensing"), [(0, False), (2, True), (4, True)])
def test_hold_returns_after_a_push(delay: int, sensing: bool) -> None:
    def push(t: float, q: np.ndarray, _: np.ndarray) -> np.ndarray:
        return MODEL.jacobian(q)[:3].T @ (20.0, 30.0, 10.0) if 0.2 < t < 0.4 else np.zeros(7)

    felt = make(contact_share=1.0)  # as little as can be
    controller, plant = begin(controller=felt, delay=delay, sensing=sensing, push=push)
    run(controller, plant, 0.3)
    assert np.linalg.norm(tool(plant) - MODEL.tool_pose(HOME)[0]) > 0.01
    run(controller, plant, 1.2)
    assert np.abs(plant.q - HOME).max() < 2e-3
    assert controller.mode is Mode.HOLD


def test_hold_brakes_a_moving_arm_without_a_jerk() -> None:
    controller, plant = begin()
    controller.set_gravity_compensation(True)
    run(controller, plant, 0.01)
    plant.qd = np.array([0.5, -0.5, 0.5, 1.0, -1.0, 2.0, 1.0])
    run(controller, plant, 0.01)
    q, qd = plant.q.copy(), plant.qd.copy()
    controller.hold()
    run(controller, plant, 1.0)
    assert np.abs(plant.qd).max() < 1e-3
    assert np.allclose(plant.q, q + 0.5 * 0.15 * qd, atol=0.02)


# -------------------------------------------------------------------------------- joint movement


@pytest.mark.requirement("S-29")
@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_a_move_to_start_arrives_at_limited_speed_and_is_ready(friction: float) -> None:
    away = HOME + np.array([0.4, -0.3, 0.2, 0.5, -0.6, 0.4, 0.8])
    controller, plant = begin(away, friction=friction, sensing=True, delay=2)
    assert not controller.ready
    controller.move_to_start()
    peak = 0.0

    def arrived() -> bool:
        nonlocal peak
        peak = max(peak, np.abs(plant.qd).max())
        return controller.mode is Mode.HOLD

    run(controller, plant, 10.0, until=arrived)
    run(controller, plant, 0.5)
    assert peak < 1.3 * 0.3
    assert np.abs(plant.q - HOME).max() < 0.03
    assert controller.ready
    assert controller.label == "hold"


@pytest.mark.requirement("S-25")
def test_a_blocked_move_is_a_fault() -> None:
    controller, plant = begin(HOME + 0.6, controller=make(contact_share=100.0))
    controller.move_to_start()
    stuck = plant.q.copy()
    for k in range(3000):  # its encoders flicker by a count: it does not look frozen
        controller.step(plant.stamp, stuck + 1e-5 * (k % 2), np.zeros(7))
        plant.stamp += PERIOD_NS
    assert controller.mode is Mode.FAULT
    assert "rad away" in controller.latched.text


@pytest.mark.requirement("S-25")
def test_a_held_arm_that_was_carried_off_does_not_spring_back() -> None:
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
    assert "rad away" in controller.latched.text
    q, plant.push = plant.q.copy(), None  # the board lets torques through again
    run(controller, plant, 1.0)
    assert np.abs(plant.q - q).max() < 0.25  # it was falling
    assert controller.mode is Mode.FAULT


def test_a_replay_follows_the_recording_and_reports_its_error() -> None:
    t = np.linspace(0.0, 1.5, 300)
    wave = 0.5 * (1.0 - np.cos(2.0 * np.pi * t / 1.5))[:, None]
    recording = SimpleNamespace(t=t, q=HOME + wave * np.array([0.1, 0.2, 0.1, 0.5, 0.2, -0.4, 0.3]))
    controller, plant = begin(HOME + 0.05, sensing=True, delay=2, friction=1.0)
    controller.start_replay(recording, speed=1.5)
    run(controller, plant, 6.0, until=lambda: controller.mode is not Mode.REPLAY)
    assert controller.mode is Mode.HOLD, controller.latched
    error = controller.replay_error
    assert np.all(error.rms < 0.03)
    assert np.all(error.largest >= error.rms)
    assert 0.0 < error.tool()[0] < error.tool()[1] < 0.03
    run(controller, plant, 0.5)
    assert np.abs(plant.q - HOME).max() < 0.03


@pytest.mark.requirement("S-16")
def test_a_replay_that_does_not_fit_is_refused() -> None:
    controller, _ = begin()
    t = np.linspace(0.0, 1.0, 100)
    fine = HOME + 0.5 * np.sin(t)[:, None] * np.ones(7)
    for trajectory, speed, reason in (
        (SimpleNamespace(t=t, q=fine), 50.0, "speed limit"),
        (SimpleNamespace(t=t, q=fine + 3.0), 1.0, "joint limits"),
        (SimpleNamespace(t=t, q=fine[:, :6]), 1.0, "6 joints"),
        (SimpleNamespace(t=t[::-1], q=fine), 1.0, "increase"),
        (SimpleNamespace(t=t, q=fine * np.nan), 1.0, "finite"),
        (SimpleNamespace(t=t, q=fine), 0.0, "speed"),
        (SimpleNamespace(t=t, q=fine), 1e-4, "600"),
        (SimpleNamespace(t=t, q=fine[:5]), 1.0, "N >= 4"),
        (object(), 1.0, "refused"),
    ):
        with pytest.raises(ControllerError, match=reason):
            controller.start_replay(trajectory, speed)
    assert controller.mode is Mode.HOLD


# -------------------------------------------------------------------------------------- rollouts


def rollout(controller: Controller, plant: Plant) -> SimpleNamespace:
    """Execute; positions and rotations tick by tick, the torques, and the path."""
    controller.execute()
    positions, turns, torques = [], [], []
    while controller.mode is Mode.ROLLOUT:
        position, rotation = MODEL.tool_pose(plant.q)
        positions.append(position)
        turns.append(rotation)
        torques.append(controller.step(*plant.state()))
        plant.step(torques[-1])
    return SimpleNamespace(
        position=np.array(positions),
        rotation=turns,
        torques=torques,
        path=controller.take_finished(),
    )


def deviation(result: SimpleNamespace, policy: Policy) -> tuple[float, float]:
    """Rms of position [m] and angle [deg] against Eq. 1 as it would run on an ideal arm."""
    tables = dmp.tabulate(policy)
    steps = tables.rows
    x, _ = reproduced(policy, result.position[0])
    reference = rotations.matrix(policy.orientation_reference)
    vector, omega = rotations.log(result.rotation[0] @ reference.T), np.zeros(3)
    angles = []
    for k in range(steps):
        ideal = rotations.exp(vector) @ reference
        angles.append(np.linalg.norm(rotations.log(result.rotation[k] @ ideal.T)))
        twist = np.concatenate([np.zeros(3), omega])
        omega = omega + 0.002 * dmp.acceleration(tables, k, np.zeros(3), vector, twist)[3:]
        vector = vector + 0.002 * omega
    away = np.linalg.norm(result.position[:steps] - x, axis=1)
    rms = np.sqrt(np.mean(np.square([away, angles]), axis=1))
    return float(rms[0]), float(np.rad2deg(rms[1]))


@pytest.mark.parametrize(
    ("law", "delay", "sensing", "millimetres", "degrees"),
    [
        ("operational_space", 0, False, 1.5, 0.5),
        ("operational_space", 2, True, 6.0, 1.0),
        ("operational_space", 4, True, 8.0, 1.5),
        ("virtual_mass", 0, False, 30.0, 6.0),
        ("virtual_mass", 2, True, 30.0, 6.0),
    ],
)
def test_a_rollout_follows_the_reproduced_path(
    law: str, delay: int, sensing: bool, millimetres: float, degrees: float
) -> None:
    controller = make(law=law)
    controller, plant = begin(controller=controller, delay=delay, sensing=sensing)
    result = rollout(controller, plant)
    assert controller.mode is Mode.HOLD, controller.latched
    away, angle = deviation(result, POLICY)
    assert 1e3 * away < millimetres
    assert angle < degrees
    assert np.abs(np.diff(result.position, axis=0)).max() > 0.0008  # it did throw


@pytest.mark.parametrize("friction", [0.3, 1.0])
def test_a_rollout_through_the_wrist_singularity_stays_calm(friction: float) -> None:
    q = HOME.copy()
    q[[3, 5]] = np.deg2rad([80.0, -10.0])
    policy = make_policy(q_start=q, pitch=0.6)
    controller, plant = begin(q, controller=make(policy), delay=2, sensing=True, friction=friction)
    crossed = rollout(controller, plant)
    assert controller.mode is Mode.HOLD, controller.latched
    assert deviation(crossed, policy)[0] < 0.01
    assert controller.counters["limited"] < 150


@pytest.mark.parametrize(("turn", "mode"), [(1.8, Mode.HOLD), (2.4, Mode.FAULT)])
def test_the_pan_may_turn_as_far_as_its_law_holds(turn: float, mode: Mode) -> None:
    turning = np.zeros((8, 3))
    turning[:, 0] = np.linspace(0.0, turn, 8)  # about the handle [rad]
    still = make_policy(size=0.0)
    policy = Policy(**{**vars(still), "rotation_attractors": turning})
    controller, plant = begin(controller=make(policy))
    result = rollout(controller, plant)
    assert controller.mode is mode, controller.latched
    if mode is Mode.HOLD:
        assert plant.q[6] == pytest.approx(1.8, abs=0.05)
        assert deviation(result, policy)[1] < 3.0
    else:
        assert "turned by more" in controller.latched.text


def test_the_path_covers_the_movement_and_the_settling_and_is_handed_out_once() -> None:
    controller, plant = begin()
    stamp = plant.stamp
    result = rollout(controller, plant)
    assert result.path.id == "trial-0001"
    assert np.allclose(result.path.t, np.arange(181) * 0.01)
    assert np.allclose(result.path.position, result.position[::5][:181], atol=1e-12)
    assert np.allclose(rotations.matrix(result.path.quat_xyzw[40]), result.rotation[200])
    assert controller.rollout_stamp_ns == stamp
    assert controller.take_finished() is None


def test_the_pan_stays_where_the_rollout_ended() -> None:
    controller, plant = begin(sensing=True, delay=2, friction=1.0)
    rollout(controller, plant)
    end = tool(plant)
    torques = run(controller, plant, 1.0)
    assert np.linalg.norm(tool(plant) - end) < 1e-3
    assert np.abs(np.diff(torques, axis=0)).max() < 1.5  # and no jolt [N m a period]


def test_lost_states_do_not_slow_a_movement() -> None:
    controller, plant = begin()
    whole = rollout(controller, plant)
    controller, plant = begin()
    controller.execute()
    tau, k = controller.step(*plant.state()), 0
    while controller.mode is Mode.ROLLOUT:
        plant.step(tau)
        k += 1
        if k % 7:
            tau = controller.step(*plant.state())
    path = controller.take_finished()
    assert path.t[-1] == pytest.approx(whole.path.t[-1], abs=0.01)
    at = np.interp(0.4, path.t, path.position[:, 2])
    assert at == pytest.approx(np.interp(0.4, whole.path.t, whole.path.position[:, 2]), abs=2e-3)


def test_an_aborted_rollout_leaves_a_shorter_path() -> None:
    for abort in (Controller.stop, Controller.deactivate, lambda c: c.fault(A_TEST)):
        controller, plant = begin()
        controller.execute()
        run(controller, plant, 0.3)
        abort(controller)
        path = controller.take_finished()
        assert path.id == "trial-0001"
        assert path.t[-1] == pytest.approx(0.29)
    controller, plant = begin()
    controller.execute()
    controller.stop()  # before its first state
    assert len(controller.take_finished().t) == 1


def test_the_label_belongs_to_the_torque_and_not_to_the_request() -> None:
    controller, plant = begin()
    stamp, q, qd = plant.state()
    answer = controller.step(stamp, q, qd)
    controller.execute()
    assert controller.mode is Mode.ROLLOUT
    assert controller.step(stamp, q, qd) is answer  # the same state again: the torque of hold
    assert controller.label == "hold"
    controller.step(stamp + PERIOD_NS, q, qd)
    assert controller.label == "rollout trial-0001"


def test_a_rollout_from_rest_depends_on_nothing_before_it() -> None:
    torques = []
    for history in (0, 1):
        controller, plant = begin(HOME + 0.02 * history)
        controller.load(make_policy("another", size=0.5))
        if history:
            rollout(controller, plant)
            controller.set_gravity_compensation(True)
            run(controller, plant, 0.4)
            controller.hold()
        controller.load(POLICY)
        plant.q, plant.qd = HOME.copy(), np.zeros(7)  # put there, as the stand-in does
        for _ in range(25):
            controller.step(*plant.state())
            plant.stamp += PERIOD_NS
        assert controller.ready
        torques.append(rollout(controller, plant).torques)
    assert np.array_equal(*torques)


def test_the_torque_comes_to_a_fixed_point_while_a_state_repeats() -> None:
    controller, plant = begin(HOME + 0.03)
    for differentiated in (False, True):
        stamp, q, qd = plant.state()
        answers = []
        for k in range(60):
            qd = None if differentiated else 0.001 * np.ones(7)
            answers.append(controller.step(stamp + k * PERIOD_NS, q, qd))
        plant.stamp += 60 * PERIOD_NS
        assert all(np.array_equal(answers[-1], tau) for tau in answers[25:])


# ------------------------------------------------------------------------------ stamps and faults


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
    ("q", "qd"),
    [
        (HOME * math.nan, np.zeros(7)),
        (HOME, np.full(7, math.inf)),
        (HOME[:6], np.zeros(7)),
        (HOME, np.zeros((1, 7))),
        (HOME + 1e6, np.zeros(7)),
        (HOME, np.full(7, 1e200)),
        (["a"] * 7, np.zeros(7)),
        (None, None),
    ],
)
def test_a_state_that_is_not_valid_is_ignored_and_five_are_a_fault(q: object, qd: object) -> None:
    controller, plant = begin()
    stamp, good, _ = plant.state()
    answer = controller.step(stamp, good, np.zeros(7))
    for k in range(1, 5):
        tau = controller.step(stamp + k * PERIOD_NS, q, qd)
        check(tau, answer)
        answer = tau
    assert controller.mode is Mode.HOLD
    assert controller.counters["rejected"] == 4
    assert np.array_equal(answer, tau)  # nothing new is to be sent
    check(controller.step(stamp + 5 * PERIOD_NS, q, qd), answer)
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
    assert controller.mode is Mode.FAULT
    assert controller.latched.kind is FaultKind.STATES_REFUSED
    assert controller.counters["rejected"] == 5


@pytest.mark.requirement("S-42")
def test_a_long_gap_is_a_fault_and_a_short_one_is_counted() -> None:
    controller, plant = begin()
    plant.stamp += 5 * PERIOD_NS
    controller.step(*plant.state())
    assert controller.mode is Mode.HOLD
    assert controller.counters["gaps"] == 1
    plant.stamp += 12 * PERIOD_NS
    controller.step(*plant.state())
    assert controller.mode is Mode.FAULT
    assert "24 ms" in controller.latched.text


@pytest.mark.requirement("S-44")
def test_a_joint_that_jumps_is_a_fault_unless_a_person_holds_the_arm() -> None:
    controller, plant = begin()
    controller.set_gravity_compensation(True)
    plant.q = plant.q + 0.2
    controller.step(*plant.state())
    assert controller.mode is Mode.GRAVITY_COMPENSATION
    assert controller.counters["jumps"] == 1
    controller.hold()
    plant.stamp += PERIOD_NS
    controller.step(*plant.state())
    plant.stamp += PERIOD_NS
    plant.q = plant.q + 0.2
    controller.step(*plant.state())
    assert controller.mode is Mode.FAULT


@pytest.mark.requirement("S-21")
@pytest.mark.parametrize("joint", range(7))
def test_overspeed_is_a_fault_in_the_third_state(joint: int) -> None:
    controller, plant = begin()
    stamp, q, qd = plant.state()
    qd = np.zeros(7)
    qd[joint] = 1.01 * LIMITS.qd_max[joint]
    for k in range(2):
        controller.step(stamp + k * PERIOD_NS, q, qd)
        assert controller.mode is Mode.HOLD
    controller.step(stamp + 2 * PERIOD_NS, q, qd)
    assert controller.mode is Mode.FAULT
    assert controller.label == "fault"  # and this very torque is the fallback's


@pytest.mark.requirement("S-22")
def test_teaching_has_a_speed_limit_of_its_own() -> None:
    limits = safety.limits_of(MODEL, teaching_tool_speed=0.5)
    for teaching, mode in ((False, Mode.HOLD), (True, Mode.FAULT)):
        controller, plant = begin(controller=make(limits=limits, contact_share=100.0))
        controller.set_gravity_compensation(teaching)
        stamp, q, _ = plant.state()
        qd = np.array([0.8, 0, 0, 0, 0, 0, 0])
        for k in range(4):
            controller.step(stamp + k * PERIOD_NS, q + k * 0.002 * qd, qd)
        assert controller.mode is mode


@pytest.mark.requirement("S-23")
def test_a_rollout_that_leaves_the_workspace_is_a_fault() -> None:
    top = MODEL.tool_pose(HOME)[0][2] + 0.02
    limits = safety.limits_of(MODEL, workspace_max=(2.0, 2.0, top))
    controller, plant = begin(controller=make(limits=limits))
    controller.execute()
    run(controller, plant, 2.0)
    assert controller.mode is Mode.FAULT
    assert "z =" in controller.latched.text


@pytest.mark.requirement("S-23")
@pytest.mark.parametrize("guarded", ["elbow", "tool"])
def test_neither_tool_nor_guarded_point_comes_behind_the_plane(guarded: str) -> None:
    elbow, _ = MODEL.motion(HOME, np.zeros(7)).guarded_positions
    tool, _ = MODEL.tool_pose(HOME)
    plane = {"elbow": (-1.0, 0.0, 0.0, 0.01 - elbow[0]), "tool": (-1.0, 0.0, 0.0, -0.01 - tool[0])}
    controller, plant = begin(controller=make(limits=safety.limits_of(MODEL, plane=plane[guarded])))
    run(controller, plant, 0.1)
    assert controller.mode is Mode.HOLD  # there it may be: only what moves by itself is judged
    controller.execute()
    run(controller, plant, 1.0)
    assert controller.mode is Mode.FAULT
    assert controller.latched.text.startswith(f"{guarded} is 0.0")


@pytest.mark.requirement("S-30")
def test_hold_to_run_is_asked_for_and_its_release_is_a_fault_in_the_same_state() -> None:
    def teach(controller: Controller) -> None:
        controller.set_gravity_compensation(True)

    def replay(controller: Controller) -> None:
        t = np.linspace(0.0, 1.0, 11)
        controller.start_replay(SimpleNamespace(t=t, q=np.tile(HOME, (11, 1))))

    for request in (teach, replay, Controller.execute):
        controller, plant = begin(controller=make(hold_to_run=True))
        with pytest.raises(ControllerError, match="enabling switch"):
            request(controller)
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
    with pytest.raises(ControllerError, match="enabling switch"):
        controller.execute()


@pytest.mark.requirement("S-24")
def test_soft_springs_push_a_taught_arm_off_its_limits() -> None:
    q = HOME.copy()
    q[5] = LIMITS.q_max[5] - 0.01
    controller, plant = begin(q)
    controller.set_gravity_compensation(True)
    run(controller, plant, 0.3)
    assert LIMITS.q_max[5] - plant.q[5] > 0.05


@pytest.mark.requirement("S-26")
def test_a_fault_brings_the_arm_to_rest_carries_it_and_stays_until_reset() -> None:
    controller, plant = begin(sensing=True, delay=2)
    controller.execute()
    run(controller, plant, 0.45)  # in the middle of the throw
    start = tool(plant)
    assert np.abs(plant.qd).max() > 0.5
    controller.fault(A_TEST)
    with pytest.raises(ControllerError, match="moves at"):
        controller.reset()
    run(controller, plant, 1.0)
    assert MODEL.motion(plant.q, plant.qd).tool_speed < 0.01
    assert np.linalg.norm(tool(plant) - start) < 0.15
    for request in (
        controller.hold,
        controller.execute,
        controller.move_to_start,
        lambda: controller.set_gravity_compensation(True),
    ):
        with pytest.raises(ControllerError):
            request()
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
@pytest.mark.parametrize("friction", [0.5, 1.0, 2.0])
def test_without_states_the_arm_is_braked_on_its_model_alone(friction: float) -> None:
    assert np.array_equal(make().stale_torque(), np.zeros(7))
    controller, plant = begin(friction=friction)
    controller.execute()
    tau = run(controller, plant, 0.4)[-1]
    speeds = []
    for _ in range(500):
        before, tau = tau, controller.stale_torque()
        check(tau, before)
        plant.step(tau)
        speeds.append(MODEL.motion(plant.q, plant.qd).tool_speed)
    assert max(speeds) < speeds[0] + 0.05
    assert max(speeds[250:]) < safety.REST_SPEED
    assert np.abs(tau - MODEL.gravity(plant.q)).max() < MODEL.friction.max()


@pytest.mark.requirement("S-41")
@pytest.mark.parametrize("moment", [0.22, 0.33, 0.4])
def test_a_silence_noticed_late_is_braked_from_where_the_arm_is_then(moment: float) -> None:
    controller, plant = begin(friction=1.0, delay=2, sensing=True)
    controller.execute()
    tau = run(controller, plant, moment)[-1]
    for _ in range(8):
        plant.step(tau)
    speeds, elapsed = [], 9 * 0.002
    for _ in range(500):
        tau = controller.stale_torque(elapsed)
        plant.step(tau)
        speeds.append(MODEL.motion(plant.q, plant.qd).tool_speed)
        elapsed = 0.002
    assert max(speeds) > 0.5
    assert max(speeds[60:]) < 0.02
    assert np.abs(tau - MODEL.gravity(plant.q)).max() < 0.07


@pytest.mark.requirement("S-04")
def test_no_rest_of_the_gravity_is_sent_to_a_driver_that_compensates_it() -> None:
    controller = make(driver_compensates_gravity=True)
    controller, plant = begin(controller=controller, adds_gravity=True)
    torques = run(controller, plant, 0.2)
    assert np.abs(torques[-1]).max() < 0.05
    assert np.abs(plant.q - HOME).max() < 1e-3
    result = rollout(controller, plant)
    assert 1e3 * deviation(result, POLICY)[0] < 1.5
    for _ in range(60):
        tau = controller.stale_torque()
    assert np.array_equal(tau, np.zeros(7))


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
def test_a_law_that_finds_no_torque_is_a_fault_and_no_exception(
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
        controller, plant = begin()
        controller.execute()
        run(controller, plant, 0.1)
        assert controller.mode is Mode.FAULT
        assert reason in controller.latched.text


# ------------------------------------------------------------------------------------- obstacle


def test_a_rollout_ends_without_a_fault_where_the_tool_enters_the_obstacle() -> None:
    free_controller, free_plant = begin()
    free = rollout(free_controller, free_plant).path
    lowest = int(np.argmin(free.position[:, 2]))
    centre = free.position[lowest]
    controller, plant = begin(controller=make(obstacle=(*centre, 0.02)))
    controller.execute()
    torques = run(controller, plant, 3.0, until=lambda: controller.mode is not Mode.ROLLOUT)
    path = controller.take_finished()
    assert (controller.mode, controller.latched) == (Mode.HOLD, None)
    assert controller.counters["faults"] == 0
    distance = np.linalg.norm(path.position - centre, axis=1)
    assert distance[-1] < 0.02 and np.all(distance[:-1] >= 0.02)
    assert path.t[-1] == pytest.approx(0.002 * (len(torques) - 1), abs=1e-9)  # that very state
    assert path.t[-1] < free.t[lowest] < free.t[-1] - 0.5
    shared = len(path.t) - 1
    np.testing.assert_allclose(path.position[:shared], free.position[:shared], atol=1e-9)
    assert controller.rollout_stamp_ns is not None
    run(controller, plant, 1.0)
    assert np.abs(plant.qd).max() < 1e-3  # it has braked
    controller.move_to_start()
    run(controller, plant, 10.0, until=lambda: controller.ready)
    controller.execute()
    again = rollout_to_end(controller, plant)
    assert again.t[-1] == pytest.approx(path.t[-1], abs=0.01)


def rollout_to_end(controller: Controller, plant: Plant) -> EndEffectorPath:
    run(controller, plant, 3.0, until=lambda: controller.mode is not Mode.ROLLOUT)
    return controller.take_finished()


def test_a_rollout_that_begins_in_the_obstacle_ends_with_its_first_state() -> None:
    centre = MODEL.tool_pose(HOME)[0]
    controller, plant = begin(controller=make(obstacle=(*centre, 0.1)))
    controller.execute()
    run(controller, plant, 0.01)
    assert controller.mode is Mode.HOLD
    path = controller.take_finished()
    assert path.t.tolist() == [0.0]
    np.testing.assert_allclose(path.position[0], centre, atol=1e-3)


def test_outside_rollouts_an_obstacle_has_no_effect() -> None:
    centre = MODEL.tool_pose(HOME)[0]
    t = np.linspace(0.0, 0.5, 51)
    still = SimpleNamespace(t=t, q=np.tile(HOME, (51, 1)))
    torques = []
    for obstacle in ((0.0, 0.0, 0.0, 0.0), (*centre, 0.5)):
        controller, plant = begin(HOME + 0.1, controller=make(obstacle=obstacle))
        controller.move_to_start()
        sent = run(controller, plant, 4.0)
        controller.set_gravity_compensation(True)
        sent += run(controller, plant, 0.1)
        controller.start_replay(still)
        sent += run(controller, plant, 0.3)
        assert controller.mode is Mode.REPLAY
        torques.append(np.array(sent))
    assert np.array_equal(*torques)


def test_an_obstacle_of_radius_zero_is_none_even_where_the_tool_is() -> None:
    centre = MODEL.tool_pose(HOME)[0]
    paths = []
    for obstacle in ((0.0, 0.0, 0.0, 0.0), (*centre, 0.0)):
        controller, plant = begin(controller=make(obstacle=obstacle))
        paths.append(rollout(controller, plant).path.position)
    assert np.array_equal(*paths)


def test_a_policy_that_met_the_obstacle_has_not_run_to_its_end() -> None:
    centre = MODEL.tool_pose(HOME)[0] + np.array([0.0, 0.0, -0.06])
    controller, plant = begin(controller=make(obstacle=(*centre, 0.03), hold_to_run=True))
    controller.enabled = True
    controller.execute()
    assert rollout_to_end(controller, plant).t[-1] < 1.0
    run(controller, plant, 1.0)
    controller.move_to_start()
    run(controller, plant, 10.0, until=lambda: controller.ready)
    controller.enabled = False
    with pytest.raises(ControllerError, match="enabling switch"):
        controller.execute()


# --------------------------------------------------------------------------------------- requests


def in_mode(mode: Mode) -> Controller:
    controller, plant = begin(HOME + (0.2 if mode is Mode.MOVE_TO_START else 0.0))
    enter = {
        Mode.INACTIVE: controller.deactivate,
        Mode.GRAVITY_COMPENSATION: lambda: controller.set_gravity_compensation(True),
        Mode.HOLD: lambda: None,
        Mode.MOVE_TO_START: controller.move_to_start,
        Mode.ROLLOUT: controller.execute,
        Mode.REPLAY: lambda: controller.start_replay(
            SimpleNamespace(t=np.arange(9.0), q=HOME + np.arange(9.0)[:, None] * np.full(7, 0.01))
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
    for target, request in REQUESTS.items():
        controller = in_mode(mode)
        if mode is target or (mode, target) == (Mode.FAULT, Mode.INACTIVE):
            continue
        if target in TRANSITIONS[mode] and (mode, target) != (Mode.FAULT, Mode.HOLD):
            request(controller)
            assert controller.mode is target
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
    with pytest.raises(ControllerError, match="no policy"):
        controller.execute()
    with pytest.raises(ControllerError, match="no policy"):
        controller.move_to_start()


@pytest.mark.requirement("S-28")
def test_a_rollout_starts_only_at_rest_at_its_start() -> None:
    controller, plant = begin(HOME + np.array([0, 0, 0, 0.06, 0, 0, 0]))
    with pytest.raises(ControllerError, match=r"wam_j4 is 0\.060 rad"):
        controller.execute()
    controller, plant = begin()
    stamp, q, _ = plant.state()
    controller.step(stamp, q, np.array([0.2, 0, 0, 0, 0, 0, 0]))
    assert not controller.at_rest
    with pytest.raises(ControllerError, match="moves at"):
        controller.execute()


@pytest.mark.requirement("S-15")
def test_a_policy_that_does_not_fit_is_refused_and_the_old_one_kept() -> None:
    controller, _ = begin()
    stiff = make_policy("stiff")
    stiff = Policy(**{**vars(stiff), "stiffness": stiff.stiffness * 7.0})
    for policy, reason in (
        (make_policy("long", q_start=HOME), "rollout"),
        (Policy(**{**vars(POLICY), "q_start": HOME[:6]}), "6 joints"),
        (Policy(**{**vars(POLICY), "q_start": HOME + 2.0}), "outside the limits"),
        (stiff, "above the limit"),
    ):
        if reason == "rollout":
            controller.execute()
        with pytest.raises(ControllerError, match=reason):
            controller.load(policy)
        controller.stop()
        assert controller.policy_id == "trial-0001"
    controller.load(with_id(POLICY, "trial-0002"))
    assert controller.policy_id == "trial-0002"


def test_settings_that_make_no_sense_are_refused_by_name() -> None:
    for wrong in (
        {"period": 0.0},
        {"move_speed": math.nan},
        {"stiffness_max": -1.0},
        {"settle_time": math.inf},
        {"obstacle": (0.0, 0.0, 0.0, -0.1)},
        {"obstacle": (0.0, 0.0, 0.1)},
        {"obstacle": (math.nan, 0.0, 0.0, 0.1)},
        {"limits": safety.limits_of(Arm(URDF, NAMES[:4]))},
    ):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            make(**wrong)


# ------------------------------------------------------------------------------------------ fuzz

number = st.one_of(
    st.floats(-3.0, 3.0), st.floats(), st.sampled_from([math.nan, math.inf, 1e308, -1e308])
)
state = st.tuples(
    st.sampled_from([PERIOD_NS] * 6 + [0, -PERIOD_NS, 4 * PERIOD_NS, 10**12, 3]),
    st.one_of(
        st.none(),  # near home
        st.lists(st.floats(-4.0, 4.0), min_size=7, max_size=7),
        st.lists(number, min_size=6, max_size=8),
    ),
    st.one_of(st.none(), st.just([0.0] * 7), st.lists(number, min_size=7, max_size=7)),
)
call = st.sampled_from(
    [
        Controller.hold,
        Controller.stop,
        Controller.execute,
        Controller.move_to_start,
        Controller.reset,
        lambda c: c.set_gravity_compensation(True),
        lambda c: c.fault(A_TEST),
        Controller.stale_torque,
    ]
)


@pytest.mark.requirement("S-01")
@settings(max_examples=150, deadline=None)
@given(st.lists(st.one_of(state, state, state, call), max_size=60), st.booleans(), st.booleans())
def test_no_sequence_of_states_and_calls_gives_a_torque_beyond_the_limits(
    events: list, driver: bool, law: bool
) -> None:
    kind = "virtual_mass" if law else "operational_space"
    controller = make(driver_compensates_gravity=driver, law=kind)
    controller, plant = begin(controller=controller)
    previous, stamp = controller.step(*plant.state()), plant.stamp
    for event in events:
        if callable(event):
            before = controller.mode
            try:
                answer = event(controller)
            except ControllerError:
                assert controller.mode is before
                continue
            if answer is None:
                continue
            tau = answer
        else:
            step, q, qd = event
            stamp += step
            tau = controller.step(stamp, HOME if q is None else q, qd)
        check(tau, previous, 0.004)
        previous = tau


@pytest.mark.parametrize("stamp", [None, 1.5, "now", math.nan])
def test_a_stamp_that_is_no_integer_is_refused(stamp: object) -> None:
    controller, plant = begin()
    answer = controller.step(*plant.state())
    check(controller.step(stamp, HOME, np.zeros(7)), answer)
    assert controller.counters["rejected"] == 1
