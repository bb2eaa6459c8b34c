# SPDX-License-Identifier: Apache-2.0
"""Masses, torque constants, friction and tilt of an arm from the torques of a movement.

A maximum-a-posteriori fit: torques are linear in what is unknown, but for the torque constants, and
what a laboratory may find is known in advance to a few percent. The torques alone do not tell the
mass of the tool from the scale of all torque constants, so the tool is weighed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from wam_power_ros.commissioning.excitation import Excitation
from wam_power_ros.control.arm import STRIBECK_SPEED, Arm
from wam_power_ros.control.corrections import GRAVITY, Corrections

WINDOW = 0.09  # [s] of the filter that differentiates positions
SAMPLING = 0.01  # [s] from one sample that is used to the next
SETTLED = 0.3  # [s] at the end of a rest that are averaged
MOVING = 0.02  # [rad/s] from which a joint moves, and Coulomb friction has its full size
ITERATIONS = 4  # of the fit, whose torque scales multiply what else is unknown
DELAYS = 0.014  # [s] largest delay of the loop that is tried
# Deviations that are expected before anything is measured
LINKS, SCALES = 0.05, 0.05  # shares
PAYLOAD, WEIGHED = 0.15, 0.002  # [kg] of the tool; on a scale
CENTRE = 0.01  # [m] of the tool's centre of mass from that of the URDF
COULOMB, ASYMMETRY, STRIBECK, VISCOUS = 0.7, 0.15, 0.2, 0.7  # shares of the model's friction
TILT = np.deg2rad(1.5)  # [rad]
SHARE_MAX = 0.5  # largest asymmetry and largest share at low speed of a friction
KNOWN = 1e-4  # factor on the deviations of what is taken as known
TORQUE_NOISE = 0.05  # [N m]
FRICTION_NOISE = 0.04  # share of a joint's friction that varies
CORRELATED = 0.5  # [s] for which the torque that no model explains stays alike
REST_NOISE = 0.08  # the same in the mean of two rests


@dataclass(frozen=True, eq=False)
class Samples:
    """States of an arm, filtered, with the torques that acted. Shapes (N, n)."""

    q: np.ndarray  # [rad]
    qd: np.ndarray  # [rad/s]
    qdd: np.ndarray  # [rad/s^2]
    tau: np.ndarray  # commanded [N m]
    used: np.ndarray  # True where a joint's torque counts, which near a reversal it does not


@dataclass(frozen=True, eq=False)
class Identified:
    """Result of `identify`; `sd` is a standard deviation."""

    corrections: Corrections  # with which the model of the arm explains the torques
    scales_sd: np.ndarray  # of the torque scales (n,)
    moment_sd: np.ndarray  # of the payload's first moment [kg m] (3,)
    payload_sd: float  # of its mass [kg]
    felt_payload: float  # its mass by the torques alone, even if it was weighed [kg]
    felt_sd: float  # of that [kg]
    loop_delay: float  # from a command to the motion [s]


def sweep(
    t: np.ndarray, q: np.ndarray, tau: np.ndarray, between: np.ndarray, delay: float
) -> Samples:
    """Samples of a part of a recording between two times [s], filtered.

    The states, at evenly spaced t (T,) [s], have reported positions q (T, n) [rad] and commanded
    torques tau (T, n) [N m], which act after a delay [s].
    """
    period = float(np.median(np.diff(t)))
    window = 2 * round(0.5 * WINDOW / period) + 1
    part = slice(*np.searchsorted(t, between).tolist())
    commanded = np.roll(tau, round(delay / period), axis=0)
    # Imported here: the import is slow, and every command of `wam-power` would wait for it.
    from scipy.signal import savgol_filter

    rows = [savgol_filter(q[part], window, 3, order, period, axis=0) for order in range(3)]
    rows.append(savgol_filter(commanded[part], window, 3, 0, period, axis=0))
    inner = slice(window, -window, max(1, round(SAMPLING / period)))
    positions, speeds, accelerations, torques = (each[inner] for each in rows)
    used = np.abs(speeds) > MOVING + 0.5 * WINDOW * np.abs(accelerations)
    return Samples(positions, speeds, accelerations, torques, used)


def rests(t: np.ndarray, q: np.ndarray, tau: np.ndarray, planned: np.ndarray) -> Samples:
    """Postures at rest with the mean torque of both sides; arguments as for `sweep`."""
    rows = []
    for _, end in planned:
        part = slice(*np.searchsorted(t, (end - SETTLED, end)).tolist())
        rows.append((q[part].mean(axis=0), tau[part].mean(axis=0)))
    positions, torques = (np.array(column) for column in zip(*rows, strict=True))
    positions, torques = (0.5 * (each[0::2] + each[1::2]) for each in (positions, torques))
    still = np.zeros_like(positions)
    return Samples(positions, still, still, torques, np.full(still.shape, True))


def residual(arm: Arm, samples: Samples) -> np.ndarray:
    """Torque that the model of an arm, corrections included, does not explain [N m]. (N, n)."""
    # Friction that is larger in one direction is left in the mean of two rests, too.
    offset = arm.asymmetry * arm.friction
    scales = 1.0 if arm.torque_scales is None else arm.torque_scales
    rows = zip(samples.q, samples.qd, samples.qdd, samples.tau, strict=True)
    torques = [
        scales * tau
        - arm.inverse_dynamics(q, qd, qdd)
        - arm.friction_torque(qd)
        - offset * (qd == 0.0)
        for q, qd, qdd, tau in rows
    ]
    return np.where(samples.used, torques, 0.0)


def identify(
    arm: Arm,
    plan: Excitation,
    t: np.ndarray,
    q: np.ndarray,
    tau: np.ndarray,
    zeros: np.ndarray,
    payload: float | None = None,
) -> Identified:
    """Find corrections of an arm from a recording of its movement.

    Args:
        arm: Arm as its URDF describes it, without corrections.
        plan: The movement, whose beginning is at t = 0.
        t, q, tau: As of `sweep`; gravity is included in the torques.
        zeros: Zeros of the joints, from the cameras [rad]. Shape (n,).
        payload: Mass of the tool beyond the URDF's, from a scale [kg]; None if it was not weighed.
    """
    period = float(np.median(np.diff(t)))
    still = rests(t, q, tau, plan.rests)
    moving = [sweep(t, q, tau, part, 0.0) for part in plan.sweeps]
    linear = [_derivatives(arm, each, zeros) for each in (still, *moving)]
    # Neighbouring samples are not independent: what the model leaves out changes with the posture.
    share = np.sqrt(SAMPLING / CORRELATED)
    noise = [TORQUE_NOISE + REST_NOISE * arm.friction]
    noise += [(TORQUE_NOISE + FRICTION_NOISE * arm.friction) / share] * len(moving)
    weight = np.concatenate(
        [each.used / sd for each, sd in zip((still, *moving), noise, strict=True)]
    )
    matrix, known = (np.concatenate(column) for column in zip(*linear, strict=True))

    def fit(delay: float, weighed: float | None) -> tuple[float, Identified]:
        torques = [still.tau, *(sweep(t, q, tau, part, delay).tau for part in plan.sweeps)]
        cost, found = _fit(arm, matrix, known, np.concatenate(torques), weight, weighed)
        corrections = replace(found.corrections, zeros=zeros)
        return cost, replace(found, corrections=corrections, loop_delay=delay)

    delays = [shift * period for shift in range(round(DELAYS / period) + 1)]
    best = min((fit(delay, payload) for delay in delays), key=lambda each: each[0])[1]
    felt = best if payload is None else fit(best.loop_delay, None)[1]
    return replace(best, felt_payload=felt.felt_payload, felt_sd=felt.felt_sd)


def _fit(
    arm: Arm,
    matrix: np.ndarray,
    known: np.ndarray,
    tau: np.ndarray,
    weight: np.ndarray,
    payload: float | None,
) -> tuple[float, Identified]:
    """Cost and result of the fit: tau = (known + matrix x) / scales, for likely x and scales.

    The scales divide the model. As factors on the measured torques they would all become too small,
    and the masses with them, because that makes the noise smaller.

    Args:
        arm: Arm without corrections.
        matrix: Derivatives of the torques by what is unknown. Shape (N, n, 5 n + 6).
        known: Torques of the model without corrections [N m]. Shape (N, n).
        tau: Commanded torques [N m]. Shape (N, n).
        weight: 1 / standard deviation of each torque, 0 for those that do not count. Shape (N, n).
        payload: Mass of the tool beyond the URDF's [kg]; None if it is not known.
    """
    n, count = arm.n, matrix.shape[2]
    friction, viscous = arm.friction, np.maximum(arm.damping, 0.1 * arm.friction)
    tool, centre = tool_centre(arm)
    spread = np.concatenate(
        [
            np.full(n - 1, LINKS),
            [KNOWN],  # of the last link the tool is a part, whose payload is found
            [PAYLOAD if payload is None else WEIGHED],
            np.full(3, CENTRE * (tool.mass + (payload or 0.0))),
            *(COULOMB * friction, ASYMMETRY * friction, STRIBECK * friction, VISCOUS * viscous),
            np.full(2, TILT),
            np.full(n, SCALES),
        ]
    )
    expected = np.zeros(count + n)
    expected[n] = payload or 0.0
    precision = np.diag(1.0 / spread**2)
    x = expected.copy()
    for _ in range(ITERATIONS):
        shares = 1.0 + x[count:]  # 1 / scales
        model = known + matrix @ x[:count]
        full = np.concatenate([shares[:, None] * matrix, model[:, :, None] * np.eye(n)], axis=2)
        full = (weight[:, :, None] * full).reshape(-1, count + n)
        wanted = (weight * (tau - shares * model)).ravel() + full @ x
        covariance = np.linalg.inv(full.T @ full + precision)
        x = covariance @ (full.T @ wanted + precision @ expected)
    errors = weight * (tau - (1.0 + x[count:]) * (known + matrix @ x[:count]))
    cost = float((errors**2).sum() + ((x - expected) ** 2 / spread**2).sum())
    sd = np.sqrt(covariance.diagonal())
    of_moment = np.hstack([centre[:, None], np.eye(3)])
    spread_of_moment = of_moment @ covariance[n : n + 4, n : n + 4] @ of_moment.T
    parts = np.split(x, np.cumsum([n, 1, 3, n, n, n, n, 2]))
    links, mass, moment, coulomb, asymmetry, stribeck, damping, tilt, shares = parts
    coulomb = np.maximum(friction + coulomb, 0.0)
    per_coulomb = 1.0 / np.maximum(coulomb, 1e-9)
    found = Corrections.from_values(
        n,
        torque_scales=1.0 / (1.0 + shares),
        coulomb_friction=coulomb,
        viscous_friction=np.maximum(arm.damping + damping, 0.0),
        friction_asymmetry=np.clip(asymmetry * per_coulomb, -SHARE_MAX, SHARE_MAX),
        low_speed_friction=np.clip(stribeck * per_coulomb, -SHARE_MAX, SHARE_MAX),
        link_masses=1.0 + links,
        payload=np.concatenate([mass, mass * centre + moment]),
        base_tilt=tilt,
    )
    result = Identified(
        corrections=found,
        scales_sd=sd[count:],
        moment_sd=np.sqrt(spread_of_moment.diagonal()),
        payload_sd=float(sd[n]),
        felt_payload=float(x[n]),
        felt_sd=float(sd[n]),
        loop_delay=0.0,
    )
    return cost, result


def tool_centre(arm: Arm) -> tuple[pin.Inertia, np.ndarray]:
    """Inertia of what the last joint carries, and its centre in the frame of the tool (3,) [m]."""
    frame = arm.model.frames[arm.tool_frame]
    carried = arm.model.inertias[frame.parentJoint]
    return carried, frame.placement.actInv(carried.lever)


def _derivatives(arm: Arm, samples: Samples, zeros: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the torques by what is unknown, in the order of `_fit`, and known torques.

    Shapes (N, n, 5 n + 6) and (N, n).
    """
    model, n, frame = arm.model, arm.n, arm.model.frames[arm.tool_frame]
    data, placement, last = model.createData(), frame.placement, 10 * (frame.parentJoint - 1)
    tool = tool_centre(arm)[0]
    masses = [link.toDynamicParameters() for link in list(model.inertias)[1:]]
    sideways = [_pulled(model, axis) for axis in arm.root.rotation.T[:2]]
    rows = []
    for posture, qd, qdd in zip(samples.q, samples.qd, samples.qdd, strict=True):
        q = posture - zeros
        regressor = pin.computeJointTorqueRegressor(model, data, q, qd, qdd)  # (n, 10 n)
        links = [regressor[:, 10 * k : 10 * k + 10] @ masses[k] for k in range(n)]
        moments = regressor[:, last + 1 : last + 4]
        mass = regressor[:, last] + moments @ tool.lever  # more of the same tool
        forwards = np.tanh(qd / MOVING)
        along = [pin.computeGeneralizedGravity(each, data, q).copy() for each in sideways]
        columns = [*links, mass, *(moments @ placement.rotation).T]
        diagonals = forwards, np.ones(n), _slow(qd) * forwards, qd
        matrix = np.hstack(
            [
                np.stack(columns, axis=1),
                *(np.diag(each) for each in diagonals),
                np.stack([-along[1], along[0]], axis=1),
            ]
        )
        inertial = sum(links) + arm.armature * qdd
        rows.append((matrix, inertial + arm.friction * forwards + arm.damping * qd))
    matrices, known = zip(*rows, strict=True)
    return np.array(matrices), np.array(known)


def _slow(qd: np.ndarray) -> np.ndarray:
    return np.exp(-((qd / STRIBECK_SPEED) ** 2))


def _pulled(model: pin.Model, axis: np.ndarray) -> pin.Model:
    """The model with gravity along an axis of the base."""
    turned = model.copy()
    turned.gravity.linear = GRAVITY * axis
    return turned
