# SPDX-License-Identifier: Apache-2.0
"""Free flight of the pancake: a parabola and a constant spin through motion-capture frames.

At 30 frames/s the pancake falls 7-10 cm from one frame to the next and turns 20 degrees, so the
nearest frame says little about the instant t_f at which it passes Delta_h above the pan (Eq. 5).
Free flight has few unknowns: a position, a velocity and a little drag; a normal, an angular
velocity and a little decay. They are fitted to all frames of the flight, with covariance, and
evaluated at the crossing of the fitted height with the height of the pan.

A disc turning freely is a symmetric top: its normal moves on a cone about a constant axis at a
constant rate, whatever its angular velocity, so "constant spin of the normal" is exact in vacuum.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath

DELTA_H = 0.12  # [m] must exceed the pancake's radius: its edge may not have touched the pan yet
_GRID = 0.001  # [s]
_HUBER = 2.5  # standard deviations beyond which a frame counts less
_SLOWED_MIN = 0.2  # 1 + decay s, from which on the spin is not extrapolated
_UNKNOWN = 1.0  # [m], [s] or [rad]: the standard deviation of what was not seen
_STEP = math.sqrt(float(np.finfo(float).eps))  # of differences, as a share of a parameter


@dataclass(frozen=True)
class FlightSettings:
    """Sizes of pancake and pan, noise of the cameras, and what air does to a light disc.

    Attributes:
        gravity: [m/s^2].
        radius: Of the pancake [m].
        clearance: Gap between its lower edge and the pan's floor above which it flies [m]; the
            height of the pan's rim, over which the edge may still slide below that.
        position_noise: Of the tracked centre [m]: 0.25 mm for four markers of 0.5 mm, and as much
            again for the model's.
        tilt_noise: Of the tracked normal, each way [rad].
        drag: c in xdd = g - c |v| v for a middling attitude [1/m].
        acceleration_std: Of what attitude and draught add to that, at mid-flight [m/s^2].
        jerk_std: Of how fast that changes [m/s^3].
        spin_decay: Prior mean of the relative decay of the spin at mid-flight [1/s].
        spin_decay_std: Its standard deviation [1/s].
        spin_std: Prior of the angular velocity, each way [rad/s]; decides only where the frames are
            too far apart to count the turns.
        precession_std: Of the spin about the disc's own normal as it shows in the normal's path
            [rad/s].
        release_std: Of the pancake's normal against the pan's when they part [rad].
        inlier: Distance from a plain parabola within which a frame belongs to the flight [m].
        position_std_max: A less certain position at t_f counts as lost from view [m].
        pan_radius: Of the pan's floor [m].
        rest_height: Of the centre over the pan's floor at rest, at most [m].
        rest_cosine: |n . n_pan| at rest, at least.
        rest_window: Stretch at the path's end that is looked at for rest [s].
    """

    gravity: float = 9.81
    radius: float = 0.09
    clearance: float = 0.03
    position_noise: float = 0.0005
    tilt_noise: float = 0.0035
    drag: float = 0.3
    acceleration_std: float = 0.5
    jerk_std: float = 5.0
    spin_decay: float = 0.8
    spin_decay_std: float = 0.8
    spin_std: float = 12.0
    precession_std: float = 3.0
    release_std: float = 0.35
    inlier: float = 0.025
    position_std_max: float = 0.1
    pan_radius: float = 0.139
    rest_height: float = 0.015
    rest_cosine: float = 0.97
    rest_window: float = 0.2

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 <= value < math.inf or (value == 0.0 and name not in ("drag", "spin_decay")):
                raise ValueError(f"{name} = {value} must be finite and positive")


@dataclass(frozen=True, eq=False)
class Flight:
    """What one toss did, as far as the motion capture frames tell. Every number is finite.

    Attributes:
        tossed: It rose above the pan by more than Delta_h.
        seen: Its position at t_f is known. When False, `position` is the last one seen, its
            standard deviation is 1 m, and `landing_error` is 0.
        t_f: When it falls through pan height + Delta_h [s]; the path's end when never tossed.
        t_f_std: Standard deviation [s].
        position: At t_f, base frame [m]. Shape (3,).
        position_std: Standard deviation [m]. Shape (3,).
        pan_position: Of the pan at t_f, base frame [m]. Shape (3,).
        normal_start: v0: the pancake's normal at rest is the pan's at the start. Shape (3,).
        normal: v_tf: its normal at t_f, base frame. Shape (3,).
        normal_std: Standard deviation of its direction [rad].
        angle: Turned from rest to t_f [rad]: arccos(v0 . v_tf), unfolded by the half turns made
            about the spin axis, so that cos(angle) = v0 . v_tf always; 0 when never tossed.
        angle_std: Standard deviation [rad].
        spin_axis: Unit, base frame; the spin is positive about it. Shape (3,).
        spin_rate: At t_f [rad/s].
        apex: Highest point above the pan's height at the start [m].
        landing_error: Pancake - pan at t_f, base frame [m]; the horizontal part matters; 0 when
            never tossed. Shape (3,).
        resting: It lies flat in the pan at the path's end.
        flipped: At the path's end its normal is against the pan's.
        frames: Number of free-flight frames behind all this.
    """

    tossed: bool
    seen: bool
    t_f: float
    t_f_std: float
    position: np.ndarray
    position_std: np.ndarray
    pan_position: np.ndarray
    normal_start: np.ndarray
    normal: np.ndarray
    normal_std: float
    angle: float
    angle_std: float
    spin_axis: np.ndarray
    spin_rate: float
    apex: float
    landing_error: np.ndarray
    resting: bool
    flipped: bool
    frames: int


def observe_flight(
    pan: EndEffectorPath,
    pancake: BodyPath,
    delta_h: float = DELTA_H,
    settings: FlightSettings | None = None,
) -> Flight:
    """The toss in two trajectories, with uncertainty.

    The pancake's body-frame normal is the direction that is the pan's normal while it rests in
    the pan at the start, so the tracker's choice of axes does not matter. Where the paper is
    silent: several crossings, the first downward one after the apex counts; never above the
    level, `tossed` is False and t_f the end; not enough frames to know, `seen` is False.

    Args:
        pan: The pan through the rollout.
        pancake: The pancake, same id and clock; gaps are allowed.
        delta_h: Height of the level above the pan [m].
        settings: The defaults when omitted.

    Returns:
        The flight; every number finite.

    Raises:
        ValueError: Paths of different rollouts, or delta_h not positive.
    """
    if pan.id != pancake.id:
        raise ValueError(f"pan path {pan.id!r} and pancake path {pancake.id!r} must be one rollout")
    if not 0.0 < delta_h < math.inf:
        raise ValueError(f"delta_h = {delta_h} m must be positive")
    settings = FlightSettings() if settings is None else settings
    frames = _Frames.of(pan, pancake, settings)
    arc = _fit_arc(frames, settings)
    if arc is None:
        return _flight_without_arc(pan, frames, delta_h, settings)
    grid = _grid(arc, pan)
    height = arc.position(grid)[:, 2]
    above = height - np.interp(grid, pan.t, pan.position[:, 2]) - delta_h
    if above.max() <= 0.0:
        return _flight_without_arc(pan, frames, delta_h, settings)
    crossing = _crossing(grid, height, above)
    if crossing is None:
        return _flight_without_arc(pan, frames, delta_h, settings)
    t_f, slope = crossing
    position, position_std, t_f_std = arc.at_crossing(t_f, slope)
    spin = _fit_spin(frames, arc, pan, settings)
    normal, normal_cov = spin.normal_at(t_f, t_f_std)
    normal_cov += settings.tilt_noise**2 / frames.resting_frames * np.eye(3)
    axis, angle = spin.turned(frames.normal_start, t_f)
    along = _unit(np.cross(axis, normal))
    pan_position = _interp(t_f, pan.t, pan.position)
    seen = bool(position_std.max() <= settings.position_std_max)
    resting, flipped = frames.end(pan, settings)
    level = pan.position[0, 2]
    return Flight(
        tossed=True,
        seen=seen,
        t_f=t_f,
        t_f_std=t_f_std,
        position=position if seen else frames.position[-1],
        position_std=position_std if seen else np.full(3, _UNKNOWN),
        pan_position=pan_position,
        normal_start=frames.normal_start,
        normal=normal,
        normal_std=math.sqrt(max(np.linalg.eigvalsh(normal_cov)[-1], 0.0)),
        angle=angle,
        angle_std=_UNKNOWN if spin.unsure else math.sqrt(max(along @ normal_cov @ along, 0.0)),
        spin_axis=axis,
        spin_rate=spin.rate(t_f),
        apex=float(max(height.max(), frames.position[:, 2].max()) - level),
        landing_error=position - pan_position if seen else np.zeros(3),
        resting=resting,
        flipped=flipped,
        frames=len(arc.t),
    )


@dataclass(frozen=True, eq=False)
class _Frames:
    """Frames within the pan's path, seen from the pan. M may be 0."""

    t: np.ndarray  # (M,)
    position: np.ndarray  # (M, 3)
    normal: np.ndarray  # (M, 3) of the pancake, base frame; zeros when never seen at rest
    normal_start: np.ndarray  # (3,) of the pan at the start
    resting_frames: int  # behind the body-frame normal
    height: np.ndarray  # (M,) over the pan's floor, along its normal
    aside: np.ndarray  # (M,) from the pan's centre, along its floor
    cosine: np.ndarray  # (M,) normal . pan normal
    flying: np.ndarray  # (M,) bool

    @staticmethod
    def of(pan: EndEffectorPath, pancake: BodyPath, settings: FlightSettings) -> "_Frames":
        inside = (pancake.t >= pan.t[0]) & (pancake.t <= pan.t[-1])
        t, position = pancake.t[inside], pancake.position[inside]
        matrix = rotations.matrix(pancake.quat_xyzw[inside])
        pan_normal = _pan_normal(pan, t)
        start = _pan_normal(pan, pan.t[:1])[0]
        offset = position - _interp(t, pan.t, pan.position)
        height = np.sum(offset * pan_normal, axis=1)
        aside = np.linalg.norm(offset - height[:, None] * pan_normal, axis=1)
        # The first frames show the pancake flat in the pan: their mean is the body-frame normal.
        body = np.matmul(np.swapaxes(matrix, 1, 2), pan_normal[:, :, None])[:, :, 0]  # (M, 3)
        flat = (np.abs(height) < settings.rest_height) & (aside < settings.pan_radius)
        resting = _first_alike(flat, body)
        normal = np.zeros((len(t), 3))
        if len(resting):
            normal = matrix @ _unit(body[resting].mean(axis=0))
        cosine = np.sum(normal * pan_normal, axis=1)
        sine = np.sqrt(np.clip(1.0 - cosine**2, 0.0, 1.0))
        # Away from the pan its floor, extended, means nothing: there only the height counts.
        away = aside > settings.pan_radius + 2.0 * settings.radius
        gap = np.where(away, offset[:, 2] - settings.radius, height - sine * settings.radius)
        flying = gap > settings.clearance
        return _Frames(t, position, normal, start, len(resting), height, aside, cosine, flying)

    def end(self, pan: EndEffectorPath, settings: FlightSettings) -> tuple[bool, bool]:
        """Whether it rests in the pan at the end, and whether it is seen reversed there."""
        last = self.t >= pan.t[-1] - settings.rest_window
        if not last.any() or not self.resting_frames:
            return False, False
        cosine = float(np.median(self.cosine[last]))
        resting = (
            abs(float(np.median(self.height[last]))) < settings.rest_height
            and float(np.median(self.aside[last])) < settings.pan_radius
            and abs(cosine) > settings.rest_cosine
        )
        return resting, cosine < 0.0


def _first_alike(flat: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Indices of the first flat frames in a row with the same body-frame normal (within 6 deg).

    Of the first five the one most like the others leads, so that one bad frame spoils nothing.
    """
    candidates = np.flatnonzero(flat)
    first = candidates[:5]
    if len(first) == 0:
        return first
    leader = body[first[int(np.argmax((body[first] @ body[first].T).sum(axis=1)))]]
    alike = body[candidates] @ leader > math.cos(0.1)
    start = int(np.argmax(alike))
    length = int(np.argmin(alike[start:])) if not alike[start:].all() else len(alike) - start
    return candidates[start : start + length]


@dataclass(frozen=True, eq=False)
class _Arc:
    """p(t) = p0 + v s + (g + a) s^2/2 + j s^3/6 + c w(s), s = t - origin.

    A parabola with the drag of a middling attitude, w being the double integral of -|v| v along
    the plain parabola; a and j, small, are what the attitude and a draught make of that.
    """

    t: np.ndarray  # (m,) frames used
    used: np.ndarray  # (m,) their indices
    origin: float
    theta: np.ndarray  # (12,) p0, v, a, j
    covariance: np.ndarray  # (12, 12)
    velocity0: np.ndarray  # (3,) of the plain parabola that w is taken along
    settings: FlightSettings

    def position(self, t: np.ndarray) -> np.ndarray:
        s = np.atleast_1d(t) - self.origin
        drag, _ = _drag(s, self.velocity0, self.settings)
        return _powers(s) @ self.theta + _fall(s, self.settings) + drag

    def at_crossing(self, t_f: float, slope: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Position at t_f and both standard deviations; the crossing moves with the fit."""
        step = 1e-4
        before, now, after = self.position(t_f + step * np.array([-1.0, 0.0, 1.0]))
        velocity = (after - before) / (2.0 * step)
        jacobian = _powers(np.array([t_f - self.origin]))[0]  # (3, 12)
        dt = -jacobian[2] / slope  # (12,)
        moved = jacobian + np.outer(velocity, dt)
        noise = self.settings.position_noise
        variance = np.einsum("ij,jk,ik->i", moved, self.covariance, moved) + noise**2
        t_f_std = math.sqrt(dt @ self.covariance @ dt + (noise / slope) ** 2)
        return now, np.sqrt(variance), t_f_std


@dataclass(frozen=True, eq=False)
class _Spin:
    """n(t) = exp(Omega ln(1 + decay s) / decay) n0, s = t - origin.

    The spin Omega / (1 + decay s) is that of a drag which grows with its square.
    """

    origin: float
    release: float
    normal0: np.ndarray  # (3,) about which the first two parameters turn
    theta: np.ndarray  # (6,) turn of normal0 about its two tangents, Omega, decay
    covariance: np.ndarray  # (6, 6)
    unsure: bool  # of the number of turns

    def normal(self, t: np.ndarray) -> np.ndarray:
        return _spun(self.theta, np.atleast_1d(t) - self.origin, self.normal0)

    def rate(self, t: float) -> float:
        slowed = 1.0 + self.theta[5] * (t - self.origin)
        return float(np.linalg.norm(self.theta[2:5]) / max(slowed, _SLOWED_MIN))

    def normal_at(self, t_f: float, t_f_std: float) -> tuple[np.ndarray, np.ndarray]:
        """Normal at t_f and its covariance (3, 3)."""
        step = 1e-5
        columns = [
            _spun(self.theta + step * row, np.array([t_f - self.origin]), self.normal0)[0]
            - _spun(self.theta - step * row, np.array([t_f - self.origin]), self.normal0)[0]
            for row in np.eye(6)
        ]
        jacobian = np.array(columns).T / (2.0 * step)  # (3, 6)
        later, earlier = self.normal(np.array([t_f + step, t_f - step]))
        moved = (later - earlier) / (2.0 * step) * t_f_std
        covariance = jacobian @ self.covariance @ jacobian.T + np.outer(moved, moved)
        return self.normal(np.array([t_f]))[0], covariance

    def turned(self, start: np.ndarray, t_f: float) -> tuple[np.ndarray, float]:
        """Spin axis, and the angle from `start` to the normal at t_f, unfolded."""
        omega = self.theta[2:5]
        speed = float(np.linalg.norm(omega))
        end = self.normal(np.array([t_f]))[0]
        folded = _between(start, end)
        if speed * (t_f - self.release) < 0.2:  # hardly any spin: its axis means nothing
            return _axis(start, end), folded
        axis = omega / speed
        path = self.normal(np.linspace(self.release, t_f, 200))
        sine = np.cross(start, path) @ axis
        cosine = path @ start - (path @ axis) * (start @ axis)
        half_turns = math.floor(abs(np.unwrap(np.arctan2(sine, cosine))[-1]) / math.pi)
        if half_turns % 2:
            return axis, (half_turns + 1) * math.pi - folded
        return axis, half_turns * math.pi + folded


def _powers(s: np.ndarray) -> np.ndarray:
    """Design of p0 + v s + a s^2/2 + j s^3/6. Shape (m, 3, 12)."""
    powers = np.stack([np.ones_like(s), s, s**2 / 2.0, s**3 / 6.0], axis=1)  # (m, 4)
    return np.einsum("mk,ij->mikj", powers, np.eye(3)).reshape(-1, 3, 12)


def _fall(s: np.ndarray, settings: FlightSettings) -> np.ndarray:
    return np.outer(-0.5 * settings.gravity * s * s, [0.0, 0.0, 1.0])


def _drag(
    s: np.ndarray, velocity: np.ndarray, settings: FlightSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Drag c w(s) and its rate: integrals of -c |v| v from 0 along a parabola. Shapes (m, 3)."""
    low, high = min(float(s.min()), 0.0) - _GRID, max(float(s.max()), 0.0) + _GRID
    grid = np.linspace(low, high, max(int((high - low) / 0.002), 8))
    v = velocity + np.outer(grid, [0.0, 0.0, -settings.gravity])
    rate = _integral(-settings.drag * np.linalg.norm(v, axis=1, keepdims=True) * v, grid)
    return _interp(s, grid, _integral(rate, grid)), _interp(s, grid, rate)


def _integral(values: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Running trapezium integral from s = 0. Shape (m, 3)."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(grid)[:, None]
    total = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    return total - _interp(np.zeros(1), grid, total)


def _fit_arc(frames: _Frames, settings: FlightSettings) -> _Arc | None:
    """Robust weighted least squares of the flight's frames; None with fewer than two."""
    run = _highest_run(frames)
    if len(run) < 2:
        return None
    used = run[_consensus(frames.t[run], frames.position[run], settings)]
    t, position = frames.t[used], frames.position[used]
    origin = float(t.mean())
    s = t - origin
    target = position - _fall(s, settings)
    velocity = np.polyfit(s, target, 1)[0]
    design = _powers(s)  # (m, 3, 12)
    prior = np.diag(np.repeat([0.0, 0.0, settings.acceleration_std**-2, settings.jerk_std**-2], 3))
    weights = np.ones(len(t))
    for _ in range(8):
        drag, _ = _drag(s, velocity, settings)
        scale = weights / settings.position_noise**2
        information = np.einsum("m,mij,mik->jk", scale, design, design) + prior
        covariance = np.linalg.inv(information)
        theta = covariance @ np.einsum("m,mij,mi->j", scale, design, target - drag)
        distance = np.linalg.norm(target - drag - design @ theta, axis=1)
        residual = distance / settings.position_noise
        weights = np.minimum(1.0, _HUBER / np.maximum(residual, 1e-9))
        velocity = theta[3:6]
    # Where frames scatter more than the cameras do, say so.
    freedom = 3 * len(t) - 12
    if freedom > 0:
        excess = float(np.sum(weights * residual**2)) / freedom
        covariance = covariance * max(1.0, excess)
    return _Arc(t, used, origin, theta, covariance, velocity, settings)


def _highest_run(frames: _Frames) -> np.ndarray:
    """Indices of the flying frames in a row around the highest of them."""
    if not frames.flying.any() or not frames.resting_frames:
        return np.zeros(0, dtype=int)
    flying = np.flatnonzero(frames.flying)
    top = flying[np.argmax(frames.position[flying, 2])]
    runs = np.split(flying, np.flatnonzero(np.diff(flying) > 1) + 1)
    return next(run for run in runs if top in run)


def _consensus(t: np.ndarray, position: np.ndarray, settings: FlightSettings) -> np.ndarray:
    """Which frames lie on one parabola: the one through two frames that most agree with. (m,)."""
    lifted = position + 0.5 * settings.gravity * np.outer(t**2, [0.0, 0.0, 1.0])  # straight lines
    picks = np.unique(np.linspace(0, len(t) - 1, min(len(t), 25)).round().astype(int))
    first, second = (picks[index] for index in np.triu_indices(len(picks), 1))
    slope = (lifted[second] - lifted[first]) / (t[second] - t[first])[:, None]
    line = lifted[first][:, None] + (t[None] - t[first][:, None])[:, :, None] * slope[:, None]
    distance = np.linalg.norm(line - lifted[None], axis=2)  # (pairs, m)
    near = distance < settings.inlier
    score = near.sum(axis=1) - np.minimum(distance, settings.inlier).mean(axis=1)
    return near[int(np.argmax(score))]


def _grid(arc: _Arc, pan: EndEffectorPath) -> np.ndarray:
    """Times at which the arc is looked at: a little beyond its frames."""
    start = max(arc.t[0] - 0.1, pan.t[0])
    end = min(arc.t[-1] + 0.5, pan.t[-1])
    return start + _GRID * np.arange(max(int((end - start) / _GRID), 1) + 1)


def _crossing(
    grid: np.ndarray, height: np.ndarray, above: np.ndarray
) -> tuple[float, float] | None:
    """First time after the apex at which `above` falls through zero, and its slope there."""
    apex = int(np.argmax(height))
    if above[apex] <= 0.0:
        apex = int(np.argmax(above))
    below = np.flatnonzero(above[apex:] <= 0.0)
    if len(below) == 0:
        return None
    k = apex + int(below[0])
    slope = (above[k] - above[k - 1]) / (grid[k] - grid[k - 1])
    return float(grid[k] - above[k] / slope), float(slope)


def _fit_spin(frames: _Frames, arc: _Arc, pan: EndEffectorPath, settings: FlightSettings) -> _Spin:
    """Robust weighted least squares of the normals of the flight's frames."""
    normals = frames.normal[arc.used]
    t, origin = arc.t, arc.origin
    release = _release(frames, arc, pan)
    release_normal = _pan_normal(pan, np.array([release]))[0]
    normal0 = normals[int(np.argmin(np.abs(t - origin)))]
    times = np.append(t, release) - origin
    targets = np.vstack([normals, release_normal])
    noise = np.append(np.full(len(t), settings.tilt_noise), settings.release_std)[:, None]

    def many_residuals(thetas: np.ndarray) -> np.ndarray:  # (B, 6) -> (B, residuals)
        modelled = _spun(thetas, np.append(times, 0.0), normal0)  # (B, m + 1, 3)
        along = np.sum(thetas[:, 2:5] * modelled[:, -1], axis=1)
        priors = (
            thetas[:, 2:5] / settings.spin_std,
            (thetas[:, 5:] - settings.spin_decay) / settings.spin_decay_std,
            along[:, None] / settings.precession_std,
        )
        misses = (modelled[:, :-1] - targets) / noise
        return np.concatenate([misses.reshape(len(thetas), -1), *priors], axis=1)

    def residuals(theta: np.ndarray) -> np.ndarray:
        return many_residuals(theta[np.newaxis])[0]

    def jacobian(theta: np.ndarray) -> np.ndarray:  # forward differences, all in one go
        steps = _STEP * np.maximum(1.0, np.abs(theta))
        rows = many_residuals(np.vstack([theta, theta + np.diag(steps)]))
        return (rows[1:] - rows[0]).T / steps

    fits = []
    for omega in _spin_guesses(np.append(release, t), np.vstack([release_normal, normals])):
        turn = _turn(normal0, omega, t, origin, normals)
        start = np.concatenate([turn, omega, [settings.spin_decay]])
        fits.append(
            least_squares(residuals, start, jacobian, loss="huber", f_scale=_HUBER, max_nfev=60)
        )
    fits.sort(key=lambda fitted: fitted.cost)
    best = fits[0]
    information = best.jac.T @ best.jac
    freedom = 2 * len(t) - 5
    excess = 2.0 * best.cost / freedom if freedom > 0 else 1.0
    covariance = np.linalg.pinv(information) * max(1.0, excess)
    # Another number of turns that explains the frames almost as well: the angle is not known.
    unsure = any(
        fitted.cost < best.cost + 6.0 and np.linalg.norm(fitted.x[2:5] - best.x[2:5]) > 1.0
        for fitted in fits
    )
    return _Spin(origin, release, normal0, best.x, covariance, unsure)


def _spun(theta: np.ndarray, s: np.ndarray, normal0: np.ndarray) -> np.ndarray:
    """Normals after the turn theta[:2] of normal0 and the spin theta[2:].

    Shapes: theta (..., 6), s (m,); returns (..., m, 3).
    """
    start = rotations.exp(theta[..., :2] @ np.array(_tangents(normal0))) @ normal0
    decay = theta[..., 5:] * s  # (..., m)
    small = np.abs(decay) < 1e-6
    safe = np.where(small, 1.0, np.maximum(decay, _SLOWED_MIN - 1.0))
    elapsed = s * np.where(small, 1.0 - 0.5 * decay, np.log1p(safe) / safe)
    turns = rotations.exp(elapsed[..., None] * theta[..., None, 2:5])  # (..., m, 3, 3)
    return (turns @ start[..., None, :, None])[..., 0]


def _turn(
    normal0: np.ndarray, omega: np.ndarray, t: np.ndarray, origin: float, normals: np.ndarray
) -> np.ndarray:
    """First guess of the turn of normal0: the frame nearest the origin, spun to it. Shape (2,)."""
    nearest = int(np.argmin(np.abs(t - origin)))
    at_origin = rotations.exp(omega * (origin - t[nearest])) @ normals[nearest]
    turn = np.cross(normal0, at_origin)
    return np.array(_tangents(normal0)) @ turn


def _spin_guesses(t: np.ndarray, normals: np.ndarray) -> list[np.ndarray]:
    """Angular velocities that frames in succession suggest; the first entry is the release."""
    turn = np.cross(normals[:-1], normals[1:])
    sine = np.linalg.norm(turn, axis=1)
    angle = np.arctan2(sine, np.sum(normals[:-1] * normals[1:], axis=1))
    gaps = np.maximum(np.diff(t), 1e-6)
    rates = turn / np.maximum(sine, 1e-12)[:, None] * (angle / gaps)[:, None]
    shortest = float(gaps[1:].min())
    close = np.append(False, gaps[1:] < 1.5 * shortest)
    omega = np.median(rates[close], axis=0)
    speed = float(np.linalg.norm(omega))
    if shortest < 0.07 or speed < 1e-6:
        return [omega]
    # Frames this far apart may hide a larger turn, or one the other way.
    axis = omega / speed
    return [omega, omega - 2.0 * math.pi / shortest * axis, omega + 2.0 * math.pi / shortest * axis]


def _release(frames: _Frames, arc: _Arc, pan: EndEffectorPath) -> float:
    """When pancake and pan parted: the last instant the arc is down at the pan's floor."""
    before = frames.t[: arc.used[0]][~frames.flying[: arc.used[0]]]
    earliest = float(before[-1]) if len(before) else float(pan.t[0])
    count = max(int((arc.t[0] - earliest) / _GRID), 1)
    times = np.linspace(earliest, arc.t[0], count + 1)
    offset = arc.position(times) - _interp(times, pan.t, pan.position)
    height = np.sum(offset * _pan_normal(pan, times), axis=1)
    low = np.flatnonzero(height < 0.01)
    return float(times[low[-1]]) if len(low) else earliest


def _flight_without_arc(
    pan: EndEffectorPath, frames: _Frames, delta_h: float, settings: FlightSettings
) -> Flight:
    """Never tossed, or not seen often enough in the air to know."""
    end = float(pan.t[-1])
    last_pan = pan.position[-1]
    resting, flipped = frames.end(pan, settings)
    above = frames.position[:, 2] - np.interp(frames.t, pan.t, pan.position[:, 2])
    tossed = bool(np.any(frames.flying & (above > delta_h)))
    normal, angle = frames.normal_start, 0.0
    if tossed and frames.resting_frames:
        normal = frames.normal[int(np.argmax(np.where(frames.flying, above, -np.inf)))]
        angle = _between(frames.normal_start, normal)
    elif len(frames.t) and frames.resting_frames:
        normal = frames.normal[-1]
    seen = not tossed and bool(len(frames.t)) and end - frames.t[-1] <= settings.rest_window
    known = math.sqrt(3.0) * settings.position_noise
    return Flight(
        tossed=tossed,
        seen=bool(seen),
        t_f=end,
        t_f_std=_UNKNOWN if tossed else 0.0,
        position=frames.position[-1] if len(frames.t) else last_pan,
        position_std=np.full(3, known if seen else _UNKNOWN),
        pan_position=last_pan,
        normal_start=frames.normal_start,
        normal=normal,
        normal_std=settings.tilt_noise if seen else _UNKNOWN,
        angle=angle,
        angle_std=_UNKNOWN if tossed else 0.0,
        spin_axis=_axis(frames.normal_start, normal),
        spin_rate=0.0,
        apex=float(frames.position[:, 2].max() - pan.position[0, 2]) if len(frames.t) else 0.0,
        landing_error=np.zeros(3),
        resting=resting,
        flipped=flipped,
        frames=int(frames.flying.sum()),
    )


def _pan_normal(pan: EndEffectorPath, t: np.ndarray) -> np.ndarray:
    quat = rotations.normalised(pan.quat_xyzw)
    return rotations.matrix(rotations.interpolate(t, pan.t, quat))[:, :, 2]


def _interp(t: np.ndarray | float, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Straight lines between the rows of `values`. Shape (m, 3), or (3,) for one time."""
    return np.stack([np.interp(t, times, column) for column in values.T], axis=-1)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across a unit vector and each other."""
    helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = _unit(np.cross(normal, helper))
    return first, np.cross(normal, first)


def _between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between unit vectors [rad]."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def _axis(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Unit axis that turns one unit vector into another; any across `a` when they are parallel."""
    axis = np.cross(a, b)
    length = float(np.linalg.norm(axis))
    return axis / length if length > 1e-9 else _tangents(a)[0]
