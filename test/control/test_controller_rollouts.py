# SPDX-License-Identifier: Apache-2.0
"""The controller executes policies on the arm of `rigid_arm`."""

from types import SimpleNamespace

import numpy as np
import pytest
from open_loop import reproduced
from rigid_arm import (
    A_TEST,
    HOME,
    MODEL,
    PERIOD_NS,
    POLICY,
    Plant,
    begin,
    make,
    make_policy,
    run,
)

from wam_power_ros import rotations
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import ControllerError, Mode, Refusal
from wam_power_ros.learning import dmp
from wam_power_ros.learning.policy import Policy
from wam_power_ros.regions import Region


def rollout(controller: Controller, plant: Plant) -> SimpleNamespace:
    """Execute; returns positions and rotations by tick, the torques, and the path."""
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
    """Rms deviation of position [m] and angle [deg] from Eq. 1 on an ideal arm."""
    tables = dmp.tabulate(policy)
    steps = len(tables.b)
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
        ("operational_space", 4, True, 8.0, 1.5),
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


def test_a_rollout_through_the_wrist_singularity_stays_calm() -> None:
    q = HOME.copy()
    q[[3, 5]] = np.deg2rad([80.0, -10.0])
    policy = make_policy(q_start=q, pitch=0.6)
    controller, plant = begin(q, controller=make(policy), delay=2, sensing=True, friction=0.3)
    crossed = rollout(controller, plant)
    assert controller.mode is Mode.HOLD, controller.latched
    assert deviation(crossed, policy)[0] < 0.01
    assert controller.counters["limited"] < 150


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
    assert controller.rollout_stamp_ns is None
    assert len(controller.take_finished().t) == 1


def test_a_path_that_was_not_taken_is_dropped_when_the_next_rollout_begins() -> None:
    controller, plant = begin()
    controller.execute()
    assert controller.take_finished() is None
    run(controller, plant, 0.002)
    controller.stop()
    assert controller.rollout_stamp_ns is not None
    run(controller, plant, 0.5, until=lambda: controller.ready)
    controller.execute()
    assert controller.take_finished() is None and controller.rollout_stamp_ns is None


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


def test_a_rollout_from_rest_does_not_depend_on_what_happened_before() -> None:
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
        plant.q, plant.qd = HOME.copy(), np.zeros(7)  # placed there, as the stand-in does
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


def test_a_rollout_ends_without_a_fault_where_the_tool_enters_the_guarded_region() -> None:
    free_controller, free_plant = begin()
    free = rollout(free_controller, free_plant).path
    lowest = int(np.argmin(free.position[:, 2]))
    centre = free.position[lowest]
    controller, plant = begin(controller=make(region=Region("box", tuple(centre), 0.02)))
    controller.execute()
    torques = run(controller, plant, 3.0, until=lambda: controller.mode is not Mode.ROLLOUT)
    path = controller.take_finished()
    assert (controller.mode, controller.latched) == (Mode.HOLD, None)
    assert controller.counters["faults"] == 0 and controller.stopped_in == "box"
    distance = np.linalg.norm(path.position - centre, axis=1)
    assert distance[-1] < 0.02 and np.all(distance[:-1] >= 0.02)
    assert path.t[-1] == pytest.approx(0.002 * (len(torques) - 1), abs=1e-9)  # the same state
    assert path.t[-1] < free.t[lowest] < free.t[-1] - 0.5
    shared = len(path.t) - 1
    np.testing.assert_allclose(path.position[:shared], free.position[:shared], atol=1e-9)
    assert controller.rollout_stamp_ns is not None
    run(controller, plant, 1.0)
    assert np.abs(plant.qd).max() < 1e-3  # it has braked


def test_a_policy_that_was_stopped_in_a_region_does_not_count_as_completed() -> None:
    centre = MODEL.tool_pose(HOME)[0] + np.array([0.0, 0.0, -0.06])
    controller, plant = begin(
        controller=make(region=Region("box", tuple(centre), 0.03), hold_to_run=True)
    )
    controller.enabled = True
    controller.execute()
    run(controller, plant, 3.0, until=lambda: controller.mode is not Mode.ROLLOUT)
    assert controller.take_finished().t[-1] < 1.0
    assert controller.stopped_in == "box"
    run(controller, plant, 1.0)
    controller.move_to_start()
    run(controller, plant, 10.0, until=lambda: controller.ready)
    controller.enabled = False
    with pytest.raises(ControllerError) as refused:
        controller.execute()
    assert refused.value.refusal is Refusal.SWITCH


@pytest.mark.requirement("S-04")
def test_no_residual_gravity_is_sent_to_a_driver_that_compensates_it() -> None:
    controller = make(driver_compensates_gravity=True)
    controller, plant = begin(controller=controller, adds_gravity=True)
    torques = run(controller, plant, 0.2)
    assert np.abs(torques[-1]).max() < 0.05
    assert np.abs(plant.q - HOME).max() < 1e-3
    result = rollout(controller, plant)
    assert 1e3 * deviation(result, POLICY)[0] < 1.5
    for _ in range(60):
        tau = controller.stale_torque()
    assert np.abs(tau).max() < 0.02  # the driver adds g where the arm is, the model knows it nearly
