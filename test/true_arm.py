# SPDX-License-Identifier: Apache-2.0
"""Recording of a movement by an arm that is not as its URDF says; computed, not simulated."""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy

from wam_power_ros import rotations
from wam_power_ros.commissioning.camera_frame import Pose
from wam_power_ros.commissioning.excitation import Excitation, excitation
from wam_power_ros.commissioning.measurement import Commissioned, Recording, analyse
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.corrections import Corrections
from wam_power_ros.control.safety import limits_of
from wam_power_ros.params.resources import share

URDF = share("urdf/wam7.urdf").read_text()
JOINTS = [f"wam_j{number}" for number in range(1, 8)]
HOME = np.deg2rad([0.0, 20.0, 0.0, 122.0, 0.0, -27.0, 0.0])
MOUNTED = Pose(np.array([0.02, -0.01, 0.01]), rotations.exp(np.array([0.05, 0.1, 0.3])))
CAMERAS = Pose(np.array([0.015, -0.01, 0.02]), rotations.exp(np.array([0.01, -0.012, 0.03])))
ZEROS = np.deg2rad([0.0, 2.0, -1.5, 1.0, 2.5, -3.0, 0.0])  # the first and last cannot be seen
PERIOD, FRAMES = 0.004, 0.02  # [s]


def plain() -> Arm:
    return Arm(URDF, JOINTS)


def truth() -> Corrections:
    """What is to be found."""
    friction = plain().friction
    return Corrections.from_values(
        7,
        zeros=ZEROS,
        torque_scales=[0.96, 1.04, 0.97, 1.03, 1.02, 0.98, 1.0],
        coulomb_friction=friction * [1.6, 0.6, 1.3, 0.7, 1.5, 0.8, 1.2],
        friction_asymmetry=[0.1, -0.08, 0.1, 0.05, -0.1, 0.08, 0.0],
        low_speed_friction=[0.15, 0.1, 0.2, 0.15, 0.1, 0.15, 0.0],
        payload=[0.08, -0.002, 0.001, 0.012],
        base_tilt=np.deg2rad([0.6, -0.8]),
    )


@cache
def planned(seed: int = 0) -> Excitation:
    arm = plain()
    rng = np.random.default_rng(seed)
    return excitation(arm, limits_of(arm), HOME, rng, 14, (10.0, 8.0, 6.0, 4.0))


def recording(
    plan: Excitation,
    true: Corrections,
    delay: int = 1,
    late: float = 0.003,
    noise: float = 1.0,
    mounted: Pose = MOUNTED,
) -> Recording:
    """States 250 times a second and poses 50 times, from the beginning of the movement on.

    Args:
        plan: The movement, which the arm follows exactly.
        true: Arm.
        delay: Periods after which a torque acts.
        late: Time by which the stamps of the poses are late [s].
        noise: Factor on the noise of torques and cameras.
        mounted: Pose of the body in the tool.
    """
    arm, rng = plain().corrected(true), np.random.default_rng(1)
    spline = scipy.interpolate.CubicSpline(plan.t, plan.q)
    t = np.arange(round((plan.t[-1] + 0.02) / PERIOD)) * PERIOD
    q, qd, qdd = (spline(np.minimum(t, plan.t[-1]), order) for order in range(3))
    qd, qdd = (np.where(np.abs(each) < 1e-6, 0.0, each) for each in (qd, qdd))
    direction = np.zeros(7)  # of the motion before a rest, which friction still holds against
    tau = np.empty_like(q)
    for k in range(len(t)):
        direction = np.where(np.abs(qd[k]) > 1e-3, np.sign(qd[k]), direction)
        rigid = arm.inverse_dynamics(q[k], qd[k], qdd[k])
        rest = arm.friction * (direction + np.abs(direction) * true.friction_asymmetry)
        rubbing = np.where(np.abs(qd[k]) > 1e-3, arm.friction_torque(qd[k]), rest)
        tau[k] = (rigid + rubbing) / true.torque_scales
    tau += noise * rng.normal(0.0, 0.05, tau.shape)
    tau = np.roll(tau, -delay, axis=0)
    seen_t = np.arange(0.0, t[-1], FRAMES)
    poses = [_seen(arm, spline(when), mounted) for when in seen_t]
    position = np.array([pose.position for pose in poses])
    turns = rotations.exp(noise * rng.normal(0.0, np.deg2rad(0.2), (len(poses), 3)))
    return Recording(
        t=100.7 + t,
        q=q,
        tau=tau,
        seen_t=100.7 + seen_t + late,
        position=position + noise * rng.normal(0.0, 3e-4, position.shape),
        rotation=turns @ np.array([pose.rotation for pose in poses]),
    )


def _seen(arm: Arm, q: np.ndarray, mounted: Pose = MOUNTED) -> Pose:
    """Pose of the body in the cameras' frame."""
    position, axes = arm.tool_pose(q)
    position, axes = position + axes @ mounted.position, axes @ mounted.rotation
    return Pose(CAMERAS.rotation @ position + CAMERAS.position, CAMERAS.rotation @ axes)


@cache
def recorded() -> Recording:
    """The planned movement of the true arm."""
    return recording(planned(), truth())


@cache
def commissioned() -> Commissioned:
    """What is found from it."""
    return analyse(plain(), planned(), recorded(), payload=float(truth().payload[0]))
