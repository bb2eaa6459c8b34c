# SPDX-License-Identifier: Apache-2.0
"""The stand-in's world against physics, against Pinocchio, and against itself."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hardware_sim import scene
from hardware_sim.motors import CABLE_LIMIT, MOTOR_OF_JOINT, Motors, joint_motion, motor_motion
from hardware_sim.sensors import Encoders, MocapFrame, MocapSettings
from hardware_sim.world import DELTA_H, HOME, JOINTS, PERIOD, PERIOD_NS, QUIET, World, WorldSettings
from wam_power_ros.control.arm import Arm
from wam_power_ros.params.resources import share
from wam_power_ros.tracking.marker_fit import LAYOUT

URDF = share("urdf/wam7.urdf").read_text()
LEVEL = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])  # [rad] the pan is level
CALM = WorldSettings(wind_sd=0.0, pancake_offset_sd=0.0, torque_scale_sd=0.0, friction_sd=0.0)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm(URDF, JOINTS)


@pytest.fixture(scope="module")
def world() -> World:
    """The stand-in as it is; each test resets it."""
    return World(seed=3)


@pytest.fixture(scope="module")
def calm() -> World:
    """Without draught, offset and scatter of the arm."""
    return World(CALM, seed=3)


def begin(world: World, rollout_id: str = "trial-0001", q: np.ndarray = LEVEL) -> np.ndarray:
    """Reset and release; returns the gravity torque of the start."""
    world.reset(rollout_id, q)
    world.release()
    return Arm(world.urdf, JOINTS).gravity(q)


def run(world: World, tau: np.ndarray | None, ticks: int) -> None:
    for _ in range(ticks):
        world.step(tau)


# The model


def test_mujoco_and_pinocchio_agree_on_the_arm_of_the_urdf(arm: Arm) -> None:
    model = scene.arm(URDF).compile()
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    mass = np.zeros((7, 7))
    rng = np.random.default_rng(0)
    for _ in range(100):
        data.qpos[:] = rng.uniform(arm.q_min, arm.q_max)
        data.qvel[:] = rng.normal(scale=2.0, size=7)
        data.qacc[:] = qdd = rng.normal(scale=8.0, size=7)
        q, qd = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_inverse(model, data)
        mujoco.mj_fullM(model, data, mass)
        position, rotation = arm.tool_pose(q)
        np.testing.assert_allclose(data.qfrc_inverse, arm.inverse_dynamics(q, qd, qdd), atol=1e-6)
        np.testing.assert_allclose(mass, arm.mass_matrix(q), atol=1e-9)
        np.testing.assert_allclose(data.body("pan").xpos, position, atol=1e-9)
        np.testing.assert_allclose(data.body("pan").xmat.reshape(3, 3), rotation, atol=1e-9)


def test_the_arm_keeps_its_figures_in_the_scene(arm: Arm, world: World) -> None:
    model = world.model
    assert model.body_mass[1 : model.body("pancake").id].sum() == pytest.approx(
        19.459 + 9.971 + 0.6, abs=1e-3
    )
    np.testing.assert_array_equal(model.dof_armature[:7], arm.armature)
    np.testing.assert_array_equal(model.jnt_range[:7].T, [arm.q_min, arm.q_max])
    np.testing.assert_allclose(world.motors.no_load_speed, arm.qd_max, rtol=2e-3)
    np.testing.assert_allclose(world.motors.tau_max, arm.tau_max, rtol=4e-3)
    assert sum(model.geom_group == 1) > 10  # there is an arm to be seen


def test_the_guarded_points_are_those_of_the_arm_model(arm: Arm, world: World) -> None:
    begin(world)
    data = world.data
    mujoco.mj_forward(world.model, data)
    names = ("elbow", "forearm", "pan")
    before = {name: data.site(name).xpos.copy() for name in names}
    rng = np.random.default_rng(1)
    qd, small = rng.normal(size=7), 1e-6
    data.qpos[:7] = LEVEL + small * qd
    mujoco.mj_kinematics(world.model, data)
    moved = [np.linalg.norm(data.site(name).xpos - before[name]) / small for name in names]
    np.testing.assert_allclose(moved, arm.reference_point_speeds(LEVEL, qd), rtol=1e-4)


@pytest.mark.parametrize(
    ("q", "tool_plate"),  # from Barrett's DH table, computed apart from this model
    [
        ((0.0,) * 7, (0.0, 0.0, 1.2569)),
        ((0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0), (0.43670872, 0.0, 1.14538996)),
        ((0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0), (0.17853346, 0.0, 1.2342937)),
        ((0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0), (0.02919702, 0.0, 1.24944478)),
        ((0.0, -2.0, 0.0, 3.13, 0.0, 0.0, 0.0), (-0.212, 0.0, 0.353)),
    ],
)
def test_the_tool_plate_is_where_barretts_table_has_it(
    q: tuple[float, ...], tool_plate: tuple[float, ...]
) -> None:
    position, _ = Arm(URDF, JOINTS, tool_frame="wam_tool_plate").tool_pose(np.array(q))
    np.testing.assert_allclose(position, tool_plate, atol=6e-4 if q[1] == -2.0 else 1e-7)


def test_the_arm_without_its_pan_weighs_what_the_facts_sheet_says(arm: Arm) -> None:
    tree = ElementTree.fromstring(URDF)
    pan = tree.find("link[@name='pan']")
    pan.remove(pan.find("inertial"))
    bare = Arm(ElementTree.tostring(tree, encoding="unicode"), JOINTS)
    q = np.array([0.0, 0.6, 0.0, 1.6, 0.0, 0.0, 0.0])
    links = np.diag(bare.mass_matrix(q)) - bare.armature
    sheet = [1.039, 1.495, 0.179, 0.126, 0.00084, 0.00077, 0.00008]
    np.testing.assert_allclose(links, sheet, rtol=4e-3, atol=6e-6)
    rng = np.random.default_rng(0)
    poses = rng.uniform(arm.q_min, arm.q_max, size=(5000, 7))
    worst = np.abs([bare.gravity(pose) for pose in poses]).max(axis=0)
    np.testing.assert_allclose(worst, [0.0, 28.1, 6.6, 5.2, 0.15, 0.14, 0.0], rtol=0.1, atol=0.01)


# The arm


def test_an_arm_at_rest_stays_where_it_is_under_its_gravity_torque(calm: World) -> None:
    gravity = begin(calm)
    run(calm, gravity, 500)
    assert np.abs(calm.data.qpos[:7] - LEVEL).max() < 1e-3
    assert np.abs(calm.data.qvel[:7]).max() < 1e-3


def test_a_joint_stops_at_its_limit(calm: World, arm: Arm) -> None:
    start = LEVEL.copy()
    start[5] = arm.q_max[5] - 0.1
    gravity = begin(calm, q=start)
    gravity[5] += 3.0
    run(calm, gravity, 300)
    assert arm.q_max[5] - 0.01 < calm.data.qpos[5] < arm.q_max[5] + 0.02


def test_without_commands_the_arm_holds_the_last_one_for_10_ms_and_then_carries_itself(
    calm: World,
) -> None:
    gravity = begin(calm)
    pushed = gravity + 15.0 * np.eye(7)[3]
    run(calm, pushed, 25)
    efforts = []
    for _ in range(500):
        calm.step(None)
        efforts.append(calm.joint_state().tau)
    delay = calm.settings.command_delay_ticks
    assert all((effort == pushed).all() for effort in efforts[: 5 + delay])
    assert not (efforts[5 + delay] == pushed).any()
    assert np.abs(calm.data.qvel[:7]).max() < 0.02  # braked, and not fallen
    now = calm.joint_state()
    np.testing.assert_allclose(now.tau, Arm(calm.urdf, JOINTS).gravity(now.q), atol=0.5)
    run(calm, pushed, 5)  # commands are heard again
    assert (calm.joint_state().tau == pushed).all()


def test_an_arm_that_carries_itself_brakes_itself() -> None:
    speeds = []
    for damping in (0.0, 5.0):
        world = World(replace(CALM, watchdog_damping=damping))
        begin(world)
        run(world, None, 10)
        world.data.qvel[3] = 2.0
        run(world, None, 50)
        speeds.append(world.data.qvel[3])
    assert speeds[1] < 0.75 * speeds[0]


def test_what_pulls_at_the_pan_pulls_at_its_centre(calm: World, arm: Arm) -> None:
    """A torque of minus J^T times the wrench balances it."""
    pull = np.array([20.0, 5.0, 40.0, 0.0, 2.0, 1.0])

    class Weight:
        def wrench(self, t: float, *_: np.ndarray) -> np.ndarray | None:
            return pull if t < 0.3 else None

    gravity = begin(calm)
    balance = gravity - arm.jacobian(LEVEL).T @ pull
    run(calm, balance, calm.settings.command_delay_ticks)
    calm.attach(Weight())
    run(calm, balance, 100)
    assert calm.pulled
    assert np.abs(calm.data.qvel[:7]).max() < 0.01
    run(calm, gravity, 100)
    assert not calm.pulled
    assert not calm.data.xfrc_applied.any()


def test_an_idle_arm_sinks_slowly_whatever_is_commanded(calm: World) -> None:
    gravity = begin(calm)
    calm.idle = True
    run(calm, 3.0 * gravity, 500)
    assert 0.05 < calm.truth().peak_pan_speed < 1.0  # falling freely: 4 m/s after this second
    sunk = Arm(calm.urdf, JOINTS).tool_pose(LEVEL)[0][2] - calm.pan_pose[0][2]
    assert 0.05 < sunk < 0.6
    assert (calm.joint_state().tau == 0.0).all()


def test_a_driver_that_compensates_gravity_carries_the_arm_on_zero_torque() -> None:
    world = World(replace(CALM, driver_compensates_gravity=True))
    gravity = begin(world)
    run(world, np.zeros(7), 500)
    assert np.abs(world.data.qpos[:7] - LEVEL).max() < 1e-3
    np.testing.assert_allclose(world.joint_state().tau, gravity, atol=0.01)


def test_a_driver_without_a_watchdog_holds_the_last_torque_for_ever() -> None:
    world = World(replace(CALM, watchdog=False))
    gravity = begin(world)
    run(world, gravity + 1.0, 20)
    run(world, None, 200)
    np.testing.assert_array_equal(world.joint_state().tau, gravity + 1.0)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_command_takes_its_delay_to_the_motors(delay: int) -> None:
    world = World(replace(CALM, command_delay_ticks=delay))
    gravity = begin(world)
    ticks = 0
    while (world.joint_state().tau == gravity).all():
        world.step(gravity + 1.0)
        ticks += 1
    assert ticks == delay + 1


@pytest.mark.parametrize("bad", [np.full(7, math.nan), np.full(7, math.inf), np.zeros(6)])
def test_torques_that_are_not_seven_finite_numbers_are_refused_and_move_nothing(
    calm: World, bad: np.ndarray
) -> None:
    gravity = begin(calm)
    before = calm.time_ns, calm.data.qpos.tolist()
    with pytest.raises(ValueError, match="must be 7 finite numbers"):
        calm.step(bad)
    assert (calm.time_ns, calm.data.qpos.tolist()) == before
    calm.step(gravity)


def test_a_start_outside_the_limits_is_refused(calm: World) -> None:
    for q in (LEVEL + 4.0, np.full(7, math.nan), LEVEL[:6]):
        with pytest.raises(ValueError, match="within their limits"):
            calm.reset("trial-0001", q)


# The motors


@given(arrays(float, 7, elements=st.floats(-20.0, 20.0)))
def test_joint_and_motor_motion_are_each_others_inverse(q: np.ndarray) -> None:
    np.testing.assert_allclose(motor_motion(q.tolist()), MOTOR_OF_JOINT @ q, atol=1e-9)
    np.testing.assert_allclose(joint_motion(motor_motion(q.tolist())), q, atol=1e-12)


torques = arrays(float, 7, elements=st.floats(-200.0, 200.0))
speeds = arrays(float, 7, elements=st.floats(-30.0, 30.0))


@settings(max_examples=300)
@given(torques, speeds, st.sampled_from([36.0, 48.0, 80.0]))
def test_no_motor_gives_more_than_its_envelope_and_none_less_than_asked_within(
    tau: np.ndarray, qd: np.ndarray, voltage: float
) -> None:
    motors = Motors(voltage)
    given_tau = np.array(motors.limit(tau.tolist(), qd.tolist()))
    to_motor = np.linalg.inv(MOTOR_OF_JOINT).T
    wanted, got, speed = to_motor @ tau, to_motor @ given_tau, MOTOR_OF_JOINT @ qd
    assert (np.abs(got) <= CABLE_LIMIT * (1.0 + 1e-9)).all()
    driven = got * speed > 0.0
    over = np.abs(speed) >= motors.motor_no_load_speed
    assert (np.abs(got[driven & over]) < 1e-9).all()  # beyond the no-load speed nothing drives
    braking = wanted * speed <= 0.0
    full = np.abs(wanted) <= CABLE_LIMIT
    np.testing.assert_allclose(
        got[braking & full & ~over], wanted[braking & full & ~over], atol=1e-9
    )
    again = np.array(motors.limit(given_tau.tolist(), qd.tolist()))
    np.testing.assert_allclose(again, given_tau, atol=1e-9)


@pytest.mark.parametrize("joint", range(7))
def test_torque_is_full_up_to_a_speed_and_zero_at_no_load(joint: int) -> None:
    motors = Motors(48.0)
    one = np.eye(7)[joint]

    def given_at(speed: float) -> float:
        return float(motors.limit(list(1e3 * one), list(speed * one))[joint])

    full, no_load = motors.full_torque_speed[joint], motors.no_load_speed[joint]
    # Barrett's figures: J4 has its 28.8 N m to 4.36 rad/s and turns at most at 5.57
    assert given_at(0.0) == pytest.approx(motors.tau_max[joint])
    assert given_at(full) == pytest.approx(motors.tau_max[joint])
    assert given_at(0.5 * (full + no_load)) == pytest.approx(0.5 * motors.tau_max[joint])
    assert given_at(no_load) == pytest.approx(0.0, abs=1e-9)
    assert given_at(-no_load) == pytest.approx(motors.tau_max[joint])  # braking


def test_the_envelope_is_that_of_the_facts_sheet() -> None:
    motors = Motors(48.0)
    no_load = [2.39, 3.55, 5.96, 5.57, 19.8, 19.8, 38.1]
    full = [1.79, 2.66, 4.47, 4.36, 14.1, 14.1, 34.5]
    np.testing.assert_allclose(motors.no_load_speed, no_load, rtol=5e-3)
    np.testing.assert_allclose(motors.full_torque_speed, full, rtol=1e-2)
    np.testing.assert_allclose(Motors(80.0).no_load_speed, np.array(no_load) * 80 / 48, rtol=5e-3)


def test_joints_that_share_motors_share_their_torque() -> None:
    motors = Motors(48.0)
    both = motors.limit([0.0, 101.0, 60.0, 0.0, 11.0, 11.0, 0.0], [0.0] * 7)
    assert max(both[1] / 56.5 + both[2] / 33.631, both[4] / 11.64 + both[5] / 11.64) <= 1.81
    assert both[1] < 100.0
    assert both[5] < 10.0


def test_a_torque_beyond_the_envelope_is_clipped_and_told(calm: World) -> None:
    gravity = begin(calm)
    run(calm, gravity, 10)
    assert calm.truth().saturated == 0.0
    run(calm, gravity + 60.0 * np.eye(7)[3], 20)
    truth = calm.truth()
    assert truth.peak_tau[3] == pytest.approx(28.8)
    assert truth.saturated > 0.5
    assert not truth.beyond_no_load
    calm.data.qvel[3] = 8.0
    calm.step(gravity)
    assert calm.truth().beyond_no_load


@pytest.mark.parametrize("voltage", [20.0, 100.0, math.nan])
def test_a_bus_voltage_the_arm_cannot_have_is_refused(voltage: float) -> None:
    with pytest.raises(ValueError, match="36 to 90 V"):
        Motors(voltage)


# The sensors


def test_encoders_count_and_the_velocity_follows_through_its_filter() -> None:
    encoders = Encoders(PERIOD)
    q, qd = LEVEL.copy(), np.array([0.1, -0.3, 0.2, 0.7, -0.5, 1.1, 2.3])
    encoders.reset(q.tolist())
    seen = []
    for _ in range(100):
        q = q + PERIOD * qd
        encoders.read(q.tolist())
        counts = np.array(motor_motion(encoders.q)) * 4096 / math.tau
        np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
        seen.append(encoders.qd)
    resolution = np.array([3.65, 2.72, 4.56, 8.52, 7.91, 7.91, 10.27]) * 1e-5
    assert (np.abs(np.array(encoders.q) - q) <= 1.01 * resolution).all()
    late = np.array(seen)[50:]
    np.testing.assert_allclose(late.mean(axis=0), qd, atol=3e-3)
    # noise of differenced counts after the 180 rad/s filter, some mrad/s
    assert (late.std(axis=0) < 0.02).all()
    assert late.std(axis=0).max() > 5e-4
    # a step of the velocity has risen to 1 - 1/e after 1/180 s
    rise = np.array(seen)[:, 6] / qd[6]
    assert np.interp(1 - math.exp(-1), rise[:10], PERIOD * np.arange(1, 11)) == pytest.approx(
        1 / 180, abs=1e-3
    )


def test_the_arm_reports_rounded_positions_and_late_speeds(calm: World) -> None:
    gravity = begin(calm)
    run(calm, gravity + 10.0 * np.eye(7)[3], 30)
    sample = calm.joint_state()
    assert sample.stamp_ns == calm.time_ns
    error = np.abs(sample.q - calm.data.qpos[:7])
    assert 0.0 < error.max() < 1.1e-4
    assert 0.5 * calm.data.qvel[3] < sample.qd[3] < calm.data.qvel[3]  # speeding up: behind


def filmed(world: World, seconds: float) -> list[tuple[int, MocapFrame]]:
    """Frames with the time each came in, from a pancake at rest."""
    gravity = begin(world)
    frames = []
    for _ in range(round(seconds / PERIOD)):
        world.step(gravity)
        frames += [(world.time_ns, frame) for frame in world.mocap_frames()]
    return frames


def test_frames_come_at_their_rate_and_late() -> None:
    world = World(replace(CALM, mocap=MocapSettings(rate=30.0, latency=0.04, dropout=0.0)))
    frames = filmed(world, 2.0)
    stamps = np.array([frame.stamp_ns for _, frame in frames])
    late = np.array([now for now, _ in frames]) - stamps
    assert len(frames) == pytest.approx(59, abs=1)
    assert set(late.tolist()) == {40_000_000}
    assert (np.abs(np.diff(stamps) - 1e9 / 30) <= PERIOD_NS).all()


def test_frames_are_as_noisy_as_their_markers() -> None:
    world = World(replace(CALM, mocap=MocapSettings(rate=250.0, noise=0.0005, dropout=0.0)))
    world.reset("trial-0001", LEVEL)  # and nothing moves
    run(world, None, 1000)
    frames = world.mocap_frames()
    truth = world.data.qpos[7:10]
    errors = np.array([frame.position for frame in frames]) - truth
    markers = np.array([frame.markers for frame in frames])
    assert np.abs(errors.mean(axis=0)).max() < 1e-4
    np.testing.assert_allclose(markers.std(axis=0), 0.0005, rtol=0.25)
    assert 0.0002 < errors.std() < 0.0005  # four markers, and a centre away from theirs
    np.testing.assert_allclose(np.linalg.norm([f.quat_xyzw for f in frames], axis=1), 1.0)
    spacing = np.linalg.norm(markers[:, 0] - markers[:, 1], axis=1).mean()
    assert spacing == pytest.approx(np.linalg.norm(LAYOUT[0] - LAYOUT[1]), abs=2e-4)


def test_frames_and_markers_are_lost_as_often_as_asked() -> None:
    mocap = MocapSettings(rate=250.0, dropout=0.2, occlusion=0.3)
    frames = [frame for _, frame in filmed(World(replace(CALM, mocap=mocap)), 2.0)]
    assert len(frames) == pytest.approx(0.8 * 490, rel=0.12)
    hidden = sum(len(frame.markers) == 3 for frame in frames)
    assert hidden / len(frames) == pytest.approx(0.3, abs=0.08)


# The pancake


def test_a_pancake_rests_in_a_level_pan(calm: World) -> None:
    gravity = begin(calm)
    start = calm.data.qpos[7:10] - calm.pan_pose[0]
    run(calm, gravity, 500)
    truth = calm.truth()
    drift = calm.data.qpos[7:10] - calm.pan_pose[0] - start
    assert np.abs(drift).max() < 1e-3
    assert (truth.caught, truth.flipped, truth.tossed, truth.t_f) == (True, False, False, None)
    assert abs(truth.apex) < 0.01


def test_in_a_tilted_pan_it_has_slid_to_the_rim_before_a_rollout_begins(calm: World) -> None:
    gravity = begin(calm, q=HOME)
    position, rotation = calm.pan_pose
    offset = rotation.T @ (calm.data.qpos[7:10] - position)
    assert offset[0] > 0.04
    run(calm, gravity, 250)
    moved = rotation.T @ (calm.data.qpos[7:10] - position) - offset
    assert np.abs(moved).max() < 2e-3
    assert calm.truth().caught


def throw(world: World, spin: float, up: float, outward: float = 0.0) -> float:
    """Let go of the pancake 15 cm above a still pan, with a spin [rad/s] and speeds [m/s].

    Returns:
        The angle it has turned by the time it has fallen [rad], the integral of its spin.
    """
    gravity = begin(world)
    data = world.data
    data.qpos[9] += 0.15
    data.qvel[7:13] = [outward, 0.0, up, 0.0, spin, 0.0]
    angles = [0.0]
    for _ in range(300):
        before = data.qvel[11]
        world.step(gravity)
        angles.append(angles[-1] + 0.5 * PERIOD * (before + data.qvel[11]))
    truth = world.truth()
    return angles[round(truth.t_f / PERIOD)] if truth.t_f else math.nan


@pytest.mark.parametrize("spin", [-25.0, -14.0, 5.0, 18.0])
def test_the_true_angle_counts_on_beyond_half_a_turn(calm: World, spin: float) -> None:
    turned = throw(calm, spin, up=1.5)
    truth = calm.truth()
    assert truth.tossed
    assert truth.angle_deg == pytest.approx(math.degrees(abs(turned)), abs=1.0)
    assert truth.apex == pytest.approx(0.15 + 1.5**2 / 19.62, abs=0.02)


def test_the_fall_is_judged_where_it_passes_the_height_above_the_pan(calm: World) -> None:
    throw(calm, 3.0, up=1.0, outward=0.2)
    truth = calm.truth()
    expected = (1.0 + math.sqrt(1.0 + 2 * 9.81 * (0.15 - DELTA_H))) / 9.81
    assert truth.t_f == pytest.approx(expected, abs=0.015)
    assert truth.landing_error[0] == pytest.approx(0.2 * truth.t_f, abs=0.02)
    assert abs(truth.landing_error[1]) < 0.005


def test_a_pancake_thrown_over_is_caught_on_its_other_side(calm: World) -> None:
    throw(calm, 15.0, up=1.7)
    run(calm, begin_gravity(calm), 300)
    truth = calm.truth()
    assert (truth.caught, truth.flipped, truth.true_flip) == (True, True, True)


@pytest.mark.parametrize(
    ("moved", "tilt", "caught"),
    [
        ((0.0, 0.0, 0.0), 0.0, True),
        ((0.04, 0.02, 0.0), math.pi, True),
        ((0.0, 0.0, 0.015), 0.0, False),  # still in the air
        ((0.15, 0.0, 0.0), 0.0, False),  # beside
        ((0.0, 0.0, 0.0), 0.25, False),  # leaning on the rim
    ],
)
def test_caught_is_flat_in_the_pan(
    calm: World, moved: tuple[float, ...], tilt: float, caught: bool
) -> None:
    begin(calm)
    calm.data.qpos[7:10] += moved
    calm.data.qpos[10:14] = [math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0]
    truth = calm.truth()
    assert truth.caught == caught
    assert truth.flipped == (tilt > 1.0)


def begin_gravity(world: World) -> np.ndarray:
    return Arm(world.urdf, JOINTS).gravity(LEVEL)


def test_a_pancake_beside_the_pan_is_not_caught_and_lies_on_the_ground(calm: World) -> None:
    throw(calm, 2.0, up=1.0, outward=1.5)
    run(calm, begin_gravity(calm), 500)
    assert not calm.truth().caught
    assert calm.data.qpos[9] == pytest.approx(scene.PANCAKE_HALF_HEIGHT, abs=0.005)


# The same again


def outcome(world: World, rollout_id: str, frozen_ticks: int = 0) -> tuple[object, ...]:
    """Everything a rollout of a swinging arm shows, stamps since the release."""
    world.reset(rollout_id, LEVEL)
    gravity = begin_gravity(world)
    for _ in range(frozen_ticks):
        world.step(gravity + 0.1)
        world.mocap_frames()
    world.release()
    start_ns = world.time_ns
    seen: list[object] = []
    for tick in range(150):
        swing = math.sin(0.05 * tick)
        world.step(gravity + swing * np.array([0.0, 4.0, 0.0, 8.0, 0.0, -3.0, 0.0]))
        sample = world.joint_state()
        seen.append((sample.q.tolist(), sample.qd.tolist(), sample.tau.tolist()))
        seen += [
            (frame.stamp_ns - start_ns, frame.position.tolist(), frame.quat_xyzw.tolist())
            for frame in world.mocap_frames()
            if frame.stamp_ns > start_ns
        ]
    return *seen, world.data.qpos.tolist(), asdict(world.truth())


def test_a_rollout_is_bit_for_bit_a_function_of_seed_and_id(world: World) -> None:
    first = outcome(world, "trial-0007")
    assert outcome(world, "trial-0008") != first
    assert outcome(world, "trial-0007", frozen_ticks=123) == first
    run(world, None, 50)
    assert outcome(World(seed=3), "trial-0007") == first
    assert outcome(World(seed=4), "trial-0007") != first


def test_a_frozen_world_repeats_its_state_while_clock_and_cameras_go_on(world: World) -> None:
    world.reset("trial-0001", LEVEL)
    first, before = world.joint_state(), world.data.qpos.tolist()
    frames = []
    for tick in range(1, 200):
        world.step(None if tick % 3 else np.ones(7))
        sample = world.joint_state()
        assert sample.stamp_ns == first.stamp_ns + tick * PERIOD_NS
        for now, then in zip(sample[1:], first[1:], strict=True):
            np.testing.assert_array_equal(now, then)
        frames += world.mocap_frames()
    assert world.data.qpos.tolist() == before
    assert len(frames) > 8
    assert (frames[-1].position != frames[-2].position).all()  # a still pancake, not a dead camera


def test_every_rollout_draws_draught_offset_and_arm_anew_and_a_quiet_one_none(
    world: World,
) -> None:
    def drawn(rollout_id: str) -> np.ndarray:
        world.reset(rollout_id, LEVEL)
        offset = world.data.qpos[7:9] - world.pan_pose[0][:2]
        return np.concatenate([world.model.opt.wind, offset, world.model.dof_frictionloss[:7]])

    noisy = np.array([drawn(f"trial-{number:04}") for number in range(60)])
    assert noisy[:, :3].std() == pytest.approx(0.1, rel=0.25)
    assert noisy[:, 3:5].std() == pytest.approx(0.003, rel=0.3)
    assert noisy[:, 5].std() == pytest.approx(0.27, rel=0.4)
    quiet = drawn(f"trial-0001{QUIET}")
    assert np.abs(quiet[:5]).max() < 1e-4
    np.testing.assert_allclose(quiet[5:], [2.7, 2.5, 1.5, 1.1, 0.4, 0.4, 0.1])


def test_a_trace_keeps_100_poses_a_second(calm: World) -> None:
    calm.trace = []
    gravity = begin(calm)
    run(calm, gravity, 100)
    trace, calm.trace = calm.trace, None
    assert len(trace) == 20
    assert all(pose.shape == (14,) for pose in trace)


@pytest.mark.parametrize(
    "wrong",
    [
        {"command_delay_ticks": -1},
        {"wind_sd": math.nan},
        {"friction_sd": -0.1},
        {"watchdog_damping": math.inf},
    ],
)
def test_settings_out_of_range_are_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        WorldSettings(**wrong)
