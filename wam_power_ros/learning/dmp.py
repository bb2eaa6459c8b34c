# SPDX-License-Identifier: Apache-2.0
"""Dynamic movement primitive: a mixture of spring-dampers with full stiffness matrices (Eq. 1).

    xdd = sum_i h_i(t) [K_i (mu_i - x) - kappa_V xd]

is affine in x, so A(t) = sum h_i K_i and b(t) = sum h_i K_i mu_i are tabulated once on the control
grid; a step then takes microseconds. The canonical system s = exp(-alpha t) depends on t only, so
time itself, clamped to the movement, serves as the phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wam_power_ros.learning.demonstration import MOVEMENT, Demonstration, Movement, rotation_from
from wam_power_ros.learning.policy import PERIOD, Basis, Policy, symmetric_part

ROTATION_STIFFNESS = 400.0  # stiffness of the orientation [1/s^2]
ROTATION_DAMPING = 36.0  # damping of the orientation [1/s]
END_WEIGHT = 1e4  # of the orientation of the end, among samples of 1 [1]
HOLD_TIME = 1.0  # time after the movement over which the fit holds its end position [s]
# Smallest spread of a movement along an axis, as a fraction of that along its longest axis [1]
SPREAD_MIN = 0.02
STANDSTILL = 1e-3  # spread of a position that does not move: noise, or a slip of the hand [m]
REFINED_MAX = 32  # of the spring-dampers that `FitSettings.error` asks for


def activations(basis: Basis, t: np.ndarray) -> np.ndarray:
    """Weights h_i of the spring-dampers (Eq. 1) at times t (T,) [s]. Shape (T, n).

    Times are clamped to [0, duration]; each row sums to one.
    """
    t = np.clip(np.asarray(t, dtype=float), 0.0, basis.duration)
    exponent = -0.5 * (t[:, None] - basis.centres) ** 2 / basis.variance  # (T, n)
    # The largest weight is shifted to exp(0), so no row of a narrow basis underflows to 0/0.
    weights = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class TabulatedPolicy:
    """What a rollout needs of a policy: Eq. 1 on the control grid.

    The tables are read-only and have T = round(duration / dt) + 1 rows.
    """

    id: str
    duration: float  # of the movement [s]
    q_start: np.ndarray  # joint angles at the start [rad], shape (nj,)
    orientation_reference: np.ndarray  # R_ref as a unit quaternion xyzw, shape (4,)
    a: np.ndarray  # sum_i h_i K_i [1/s^2], shape (T, 3, 3)
    b: np.ndarray  # sum_i h_i K_i mu_i [m/s^2], shape (T, 3)
    rotation_b: np.ndarray  # rotation_stiffness * sum_i h_i r_i [rad/s^2], shape (T, 3)
    damping: float  # kappa_V [1/s]
    rotation_stiffness: float  # [1/s^2]
    rotation_damping: float  # [1/s]
    content: str = ""  # digest of the policy without its id, where one is needed


def tabulate(policy: Policy, dt: float = PERIOD) -> TabulatedPolicy:
    """Tabulate Eq. 1 on the control grid 0, dt, ... duration; a ValueError if dt [s] is none."""
    if not dt > 0.0:
        raise ValueError(f"dt = {dt} must be positive")
    basis = policy.basis
    rows = round(basis.duration / dt) + 1
    h = activations(basis, np.arange(rows) * dt)  # (T, n)
    forces = np.matmul(policy.stiffness, policy.attractors[:, :, None])[:, :, 0]  # (n, 3)
    a = (h @ policy.stiffness.reshape(-1, 9)).reshape(rows, 3, 3)
    b = h @ forces
    rotation_b = policy.rotation_stiffness * (h @ policy.rotation_attractors)
    for array in (a, b, rotation_b):
        array.setflags(write=False)
    return TabulatedPolicy(
        id=policy.id,
        duration=basis.duration,
        q_start=policy.q_start,
        orientation_reference=policy.orientation_reference,
        a=a,
        b=b,
        rotation_b=rotation_b,
        damping=policy.damping,
        rotation_stiffness=policy.rotation_stiffness,
        rotation_damping=policy.rotation_damping,
    )


def acceleration(
    policy: TabulatedPolicy,
    k: int,
    position: np.ndarray,
    rotation: Sequence[float],
    twist: Sequence[float],
) -> np.ndarray:
    """Reference acceleration of the tool at tick k: Eq. 1, and the same law for the rotation.

    Args:
        k: Tick since the start, >= 0; beyond the last row, the last row is used.
        position: Position x of the tool [m]. Shape (3,).
        rotation: Rotation vector r of R = exp(r) R_ref, in the base frame [rad]; three numbers.
        twist: Linear [m/s] and angular [rad/s] velocity in the base frame; six numbers.

    Returns:
        Linear [m/s^2] and angular [rad/s^2] acceleration. Shape (6,).
    """
    if k >= len(policy.b):
        k = -1
    # Plain floats: one NumPy operation on three numbers takes longer than all of these.
    x, y, z = policy.b[k].tolist()
    ax, ay, az = policy.a[k].dot(position).tolist()
    u, v, w = policy.rotation_b[k].tolist()
    ru, rv, rw = rotation
    xd, yd, zd, ud, vd, wd = twist
    damping, stiffness = policy.damping, policy.rotation_stiffness
    rotation_damping = policy.rotation_damping
    return np.array(
        (
            x - ax - damping * xd,
            y - ay - damping * yd,
            z - az - damping * zd,
            u - stiffness * ru - rotation_damping * ud,
            v - stiffness * rv - rotation_damping * vd,
            w - stiffness * rw - rotation_damping * wd,
        )
    )


def reproduce_many(
    basis: Basis,
    stiffness: np.ndarray,
    attractors: np.ndarray,
    damping: float,
    x0: np.ndarray,
    xd0: np.ndarray,
    steps: int,
    dt: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate Eq. 1 open loop for many policies of one basis and damping at once.

    Semi-implicit Euler: the velocity first, then the position with the new velocity.

    Args:
        stiffness: Stiffness K_i of each policy [1/s^2]. Shape (B, n, 3, 3).
        attractors: Attractors mu_i of each policy [m]. Shape (B, n, 3).
        damping: Damping kappa_V of all policies [1/s].
        x0: Initial position [m]. Shape (3,) or (B, 3).
        xd0: Initial velocity [m/s]. Shape (3,) or (B, 3).
        steps: Number of samples, including the initial one; after the duration the last weights
            are kept.
        dt: Time between samples [s].

    Returns:
        Positions [m] and velocities [m/s], each of shape (B, steps, 3).
    """
    stiffness = np.asarray(stiffness, dtype=float)
    count, n = stiffness.shape[:2]
    h = activations(basis, np.arange(max(steps - 1, 1)) * dt)  # (T, n)
    forces = np.matmul(stiffness, np.asarray(attractors)[..., None])[..., 0]  # (B, n, 3)
    # The policies are the last axis: every operation of a step works on contiguous rows.
    a = (h @ stiffness.transpose(1, 2, 3, 0).reshape(n, -1)).reshape(-1, 3, 3, count)
    b = (h @ forces.transpose(1, 2, 0).reshape(n, -1)).reshape(-1, 3, count)
    x = np.empty((steps, 3, count))
    xd = np.empty((steps, 3, count))
    x[0] = np.broadcast_to(x0, (count, 3)).T
    xd[0] = np.broadcast_to(xd0, (count, 3)).T
    a *= -dt
    b *= dt
    keep = 1.0 - dt * damping
    for k in range(steps - 1):
        step = np.einsum("ijb,jb->ib", a[k], x[k])
        step += b[k]
        np.multiply(xd[k], keep, out=xd[k + 1])
        xd[k + 1] += step
        np.multiply(xd[k + 1], dt, out=x[k + 1])
        x[k + 1] += x[k]
    return x.transpose(2, 0, 1).copy(), xd.transpose(2, 0, 1).copy()


@dataclass(frozen=True)
class FitSettings:
    """Settings of the fit of a policy to demonstrations, from the recording on.

    Raises:
        ValueError: If a value is out of range.
    """

    count: int  # of spring-dampers, if `error` does not need more
    width: float  # standard deviation of each Gaussian, in units of duration / count [1]
    # Smallest and largest eigenvalue of the K_i along the axes of the movement [1/s^2]; along the
    # other axes the stiffness is the geometric mean of both
    k_min: float
    k_max: float
    damping: float  # kappa_V [1/s]
    # Whether the rotation attractors hold the orientation of the end; with few spring-dampers they
    # otherwise trade it for the way there
    turn_to_end: bool = False
    # Root mean square of the distance between the demonstrations and Eq. 1 from rest, above which
    # the spring-dampers are doubled [m]. So is their stiffness: each has half the time
    error: float = np.inf
    movement: Movement = MOVEMENT  # how it is cut out of a recording

    def __post_init__(self) -> None:
        if not 0.0 < self.k_min <= self.k_max < np.inf:
            raise ValueError(f"k_min = {self.k_min}, k_max = {self.k_max}: 0 < k_min <= k_max")
        for name in ("count", "width", "damping"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} = {getattr(self, name)} must be positive")
        if not self.error > 0.0:
            raise ValueError(f"error = {self.error} must be positive")

    def with_count(self, count: int) -> FitSettings:
        """The same with so many spring-dampers: with twice as many, they are twice as stiff."""
        more = count / self.count
        return replace(self, count=count, k_min=more * self.k_min, k_max=more * self.k_max)


def fit(demonstrations: Sequence[Demonstration], settings: FitSettings, policy_id: str) -> Policy:
    """Fit a policy to demonstrations by least squares (paper Sec. II-A and its reference [21]).

    1. With one mean stiffness k: mu = pinv(H) Y with Y = xdd/k + xd kappa_V/k + x.
    2. S_i: covariance over the samples of h_i (Y - mu_i).
    3. K_i: the eigenvalues of S_i^-1, over all i, rescaled logarithmically to [k_min, k_max] within
       the subspace in which the demonstrations move. Orthogonal to it they contain no information
       on the stiffness, which is the geometric mean there; otherwise the axis of least variance
       would take the whole range.
    4. All attractors are solved jointly for these K_i, so that Eq. 1, started at rest
       at the start of the demonstrations, follows them and stays at their end.
    5. With an `error`: the same again with twice as many spring-dampers, to at most `REFINED_MAX`,
       until Eq. 1 is that near the demonstrations.

    The rotation attractors come from the same least squares on the rotation vectors.
    Demonstrations of different length are stretched in time to their mean duration. The K_i are
    symmetric; q_start and R_ref are those of the first demonstration.

    Raises:
        ValueError: If there is no demonstration, there are too few samples, or a value of the
            policy is out of range.
    """
    if not demonstrations:
        raise ValueError("no demonstration to fit; at least one is needed")
    policy = _fit(demonstrations, settings, policy_id)
    finer = settings.with_count(2 * settings.count)
    shortest = min(len(demonstration.t) for demonstration in demonstrations)
    if finer.count > REFINED_MAX or 3 * finer.count > shortest:
        return policy
    near = settings.error == np.inf or path_error(policy, demonstrations) <= settings.error
    return policy if near else fit(demonstrations, finer, policy_id)


def path_error(policy: Policy, demonstrations: Sequence[Demonstration]) -> float:
    """Root mean square of the distance between demonstrations and Eq. 1 from rest [m]."""
    squares = []
    for each in demonstrations:
        steps, dt = len(each.t), policy.basis.duration / (len(each.t) - 1)
        given = policy.basis, policy.stiffness[None], policy.attractors[None], policy.damping
        x, _ = reproduce_many(*given, each.position[0], np.zeros(3), steps, dt)
        squares.append(np.sum((x[0] - each.position) ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def _fit(demonstrations: Sequence[Demonstration], settings: FitSettings, policy_id: str) -> Policy:
    """Steps 1 to 4 of `fit`."""
    n = settings.count
    duration = float(np.mean([demonstration.duration for demonstration in demonstrations]))
    basis = Basis(n, duration, (settings.width * duration / n) ** 2)
    reference = demonstrations[0].quat_xyzw[0]
    samples = [_samples(demonstration, duration, reference) for demonstration in demonstrations]
    t, x, xd, xdd, r, omega, omegad = (
        np.concatenate(column) for column in zip(*samples, strict=True)
    )
    if len(t) < 3 * n:
        raise ValueError(f"{len(t)} samples for {n} spring-dampers; at least {3 * n} are needed")
    h = activations(basis, t)  # (N, n)
    mean_stiffness = 0.5 * (settings.k_min + settings.k_max)
    y = xdd / mean_stiffness + xd * (settings.damping / mean_stiffness) + x
    attractors = np.linalg.lstsq(h, y, rcond=None)[0]  # (n, 3)
    stiffness = _fitted_stiffness(h, y, attractors, x, settings)
    attractors = _fitted_attractors(basis, stiffness, settings.damping, demonstrations)
    target = omegad + ROTATION_DAMPING * omega + ROTATION_STIFFNESS * r
    target /= ROTATION_STIFFNESS
    if settings.turn_to_end:
        ends = [r_of[-1] for _, _, _, _, r_of, _, _ in samples]
        h = np.vstack([h, END_WEIGHT * activations(basis, np.array([duration]))])
        target = np.vstack([target, END_WEIGHT * np.mean(ends, axis=0)])
    rotation = np.linalg.lstsq(h, target, rcond=None)[0]
    return Policy(
        id=policy_id,
        basis=basis,
        stiffness=stiffness,
        attractors=attractors,
        damping=settings.damping,
        orientation_reference=reference,
        rotation_attractors=rotation,
        rotation_stiffness=ROTATION_STIFFNESS,
        rotation_damping=ROTATION_DAMPING,
        q_start=demonstrations[0].q[0],
    )


def positive_definite(stiffness: np.ndarray, k_min: float) -> np.ndarray:
    """Raise the eigenvalues of the symmetric parts of matrices (n, 3, 3) to at least k_min.

    Skew parts are kept, and matrices within the limit are unchanged; a ValueError if it is not > 0.
    """
    if not k_min > 0.0:
        raise ValueError(f"k_min = {k_min} must be positive")
    stiffness = np.array(stiffness, dtype=float)
    values, vectors = np.linalg.eigh(symmetric_part(stiffness))
    low = values[..., 0] < k_min
    lift = np.maximum(k_min - values, 0.0)  # (n, 3)
    added = np.matmul(vectors * lift[..., None, :], np.swapaxes(vectors, -1, -2))
    return np.where(low[..., None, None], stiffness + added, stiffness)


def _samples(
    demonstration: Demonstration, duration: float, reference: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Samples t, x, xd, xdd, r, omega, omegad of a demonstration, stretched to `duration`."""
    stretch = duration / demonstration.duration
    r = rotation_from(demonstration.quat_xyzw, reference)
    omega = _angular_velocity(r, np.gradient(r, demonstration.period, axis=0, edge_order=2))
    omegad = np.gradient(omega, demonstration.period, axis=0, edge_order=2)
    return (
        demonstration.t * stretch,
        demonstration.position,
        demonstration.velocity / stretch,
        demonstration.acceleration / stretch**2,
        r,
        omega / stretch,
        omegad / stretch**2,
    )


def _angular_velocity(r: np.ndarray, rd: np.ndarray) -> np.ndarray:
    """Angular velocity in the base frame of R = exp(r) R_ref, from r and its rate. Shape (N, 3)."""
    angle = np.linalg.norm(r, axis=1, keepdims=True)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    versine = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    cubic = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    turned = np.cross(r, rd)
    return rd + versine * turned + cubic * np.cross(r, turned)


def moving_axes(x: np.ndarray) -> np.ndarray:
    """Principal axes along which samples x (N, 3) move, as columns. Shape (3, d), d of 0 to 3."""
    variances, axes = np.linalg.eigh(np.cov(x.T))
    moves = variances[-1] >= STANDSTILL**2
    return axes[:, moves & (variances >= SPREAD_MIN**2 * variances[-1])]


def _fitted_stiffness(
    h: np.ndarray, y: np.ndarray, attractors: np.ndarray, x: np.ndarray, settings: FitSettings
) -> np.ndarray:
    """Steps 2 and 3 of `fit`. Shape (n, 3, 3)."""
    axes = moving_axes(x)  # (3, d)
    if not axes.size:  # the tool only turns
        middle = np.sqrt(settings.k_min * settings.k_max) * np.eye(3)
        return np.tile(middle, (settings.count, 1, 1))
    residuals = h.T[:, :, None] * (y[None] - attractors[:, None]) @ axes  # (n, N, d)
    residuals -= residuals.mean(axis=1, keepdims=True)
    covariance = np.matmul(np.swapaxes(residuals, 1, 2), residuals) / (len(y) - 1)
    # Relative, not absolute: 1e-3 m^2 is (3 cm)^2, more than the movement itself.
    trace = np.trace(covariance, axis1=1, axis2=2)
    smallest = max(float(trace.max()) * 1e-9, 1e-15)  # for a Gaussian during standstill
    d = axes.shape[1]
    covariance += (1e-3 * trace / d + smallest)[:, None, None] * np.eye(d)
    values, vectors = np.linalg.eigh(covariance)
    values = -np.log(values)  # logarithms of the eigenvalues of the inverse
    low, high = values.min(), values.max()
    share = (values - low) / (high - low) if high > low else np.full_like(values, 0.5)
    scaled = settings.k_min ** (1.0 - share) * settings.k_max**share
    vectors = axes @ vectors  # (n, 3, d)
    stiffness = np.matmul(vectors * scaled[:, None, :], np.swapaxes(vectors, 1, 2))
    orthogonal = np.eye(3) - axes @ axes.T
    return symmetric_part(stiffness + np.sqrt(settings.k_min * settings.k_max) * orthogonal)


def _fitted_attractors(
    basis: Basis, stiffness: np.ndarray, damping: float, demonstrations: Sequence[Demonstration]
) -> np.ndarray:
    """Step 4 of `fit`. Shape (n, 3).

    The position is linear in the attractors: a column of the design matrix is the response to one
    attractor coordinate, and the target is the demonstration minus the response to its start.
    """
    n = basis.count
    steps = round((basis.duration + HOLD_TIME) / PERIOD) + 1
    t = np.arange(steps) * PERIOD
    unit_attractors = np.eye(3 * n).reshape(3 * n, n, 3)
    starts = np.array([demonstration.position[0] for demonstration in demonstrations])

    def response(attractors: np.ndarray, x0: np.ndarray) -> np.ndarray:
        same = np.broadcast_to(stiffness, (len(attractors), *stiffness.shape))
        at_rest = np.zeros(3)
        return reproduce_many(basis, same, attractors, damping, x0, at_rest, steps, PERIOD)[0]

    design = response(unit_attractors, np.zeros(3)).reshape(3 * n, -1).T
    response_to_start = response(np.zeros((len(starts), n, 3)), starts)
    demonstrated = np.array(
        [
            np.stack([np.interp(t, d.t * basis.duration / d.duration, x) for x in d.position.T], 1)
            for d in demonstrations
        ]
    )
    # One design for all: the best attractors for several movements are those for their mean.
    target = (demonstrated - response_to_start).mean(axis=0).ravel()
    return np.linalg.lstsq(design, target, rcond=None)[0].reshape(n, 3)
