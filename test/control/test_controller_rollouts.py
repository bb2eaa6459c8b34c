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
    POLICY,
    Plant,
    begin,
    executing,
    make,
    make_policy,
    refusal_of,
    run,
)

from wam_power_ros import rotations
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import Mode, Refusal
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
    ("law", "delay", "millimetres", "degrees"),
    [
        ("operational_space", 0, 1.5, 0.5),
        ("operational_space", 4, 8.0, 1.5),
        ("virtual_mass", 2, 30.0, 6.0),
    ],
)
def test_a_rollout_follows_the_reproduced_path(
    law: str, delay: int, millimetres: float, degrees: float
) -> None:
    controller, plant = begin(controller=make(law=law), delay=delay, sensing=delay > 0)
    result = rollout(controller, plant)
    assert controller.mode is Mode.HOLD, controller.latched
    away, angle = deviation(result, POLICY)
    assert 1e3 * away < millimetres and angle < degrees
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
        controller, *_ = executing(0.3)
        abort(controller)
        assert controller.rollout_stamp_ns is not None
        path = controller.take_finished()
        assert path.id == "trial-0001"
        assert path.t[-1] == pytest.approx(0.29)
    controller, plant, _ = executing(0.002)
    controller.stop()  # nobody takes its path
    run(controller, plant, 0.5, until=lambda: controller.ready)
    controller.execute()
    assert controller.take_finished() is None and controller.rollout_stamp_ns is None
    controller.stop()  # before its first state
    assert len(controller.take_finished().t) == 1


def test_a_rollout_ends_without_a_fault_where_the_tool_enters_the_guarded_region() -> None:
    centre = MODEL.tool_pose(HOME)[0] + np.array([0.0, 0.0, -0.06])
    controller, plant = begin(
        controller=make(region=Region("box", tuple(centre), 0.03), hold_to_run=True)
    )
    controller.enabled = True
    result = rollout(controller, plant)
    assert (controller.mode, controller.latched) == (Mode.HOLD, None)
    assert controller.counters["faults"] == 0 and controller.stopped_in == "box"
    distance = np.linalg.norm(result.path.position - centre, axis=1)
    assert distance[-1] < 0.03 and np.all(distance[:-1] >= 0.03)
    lasted = 0.002 * (len(result.torques) - 1)  # to the same state
    assert result.path.t[-1] == pytest.approx(lasted, abs=1e-9) and lasted < 1.0
    run(controller, plant, 1.0)
    assert np.abs(plant.qd).max() < 1e-3  # it has braked
    controller.move_to_start()
    run(controller, plant, 10.0, until=lambda: controller.ready)
    controller.enabled = False
    assert refusal_of(controller.execute) is Refusal.SWITCH  # it does not count as completed


@pytest.mark.requirement("S-04")
def test_no_residual_gravity_is_sent_to_a_driver_that_compensates_it() -> None:
    controller, plant = begin(controller=make(driver_compensates_gravity=True), adds_gravity=True)
    torques = run(controller, plant, 0.2)
    assert np.abs(torques[-1]).max() < 0.05
    assert np.abs(plant.q - HOME).max() < 1e-3
    result = rollout(controller, plant)
    assert 1e3 * deviation(result, POLICY)[0] < 1.5
    for _ in range(60):
        tau = controller.stale_torque()
    assert np.abs(tau).max() < 0.02  # the driver adds g where the arm is, the model knows it nearly
