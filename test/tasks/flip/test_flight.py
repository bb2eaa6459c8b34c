# SPDX-License-Identifier: Apache-2.0
"""Flights of a simulated light disc, seen at 30 Hz, against what it truly did."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.tasks.flip.flight import DELTA_H, Flight, observe_flight

STEP = 0.0005  # [s]
END = 2.0  # [s]
G = 9.81
RADIUS = 0.09


@dataclass(frozen=True)
class Toss:
    """A toss and its air: the truth at every step, and the pan's path."""

    t: np.ndarray  # (T,)
    pan: EndEffectorPath
    position: np.ndarray  # (T, 3)
    matrix: np.ndarray  # (T, 3, 3) body frame; the body's own axes are arbitrary
    normal: np.ndarray  # (T, 3)
    winding: np.ndarray  # (T,) turned from rest about the spin axis
    release: float
    t_f: float


def toss(
    rng: np.random.Generator,
    vz: float | None = None,
    half_turns: float | None = None,
    air: float = 1.0,
    precession: float = 0.0,
) -> Toss:
    """A disc that leaves a moving, tilted pan, flies through air and comes to rest in the pan.

    `air` scales a drag that depends on the attitude (0.15/m edge on to 0.45/m face on), a decay
    of the spin and a draught of 0.1 m/s.
    """
    t = np.arange(0.0, END, STEP)
    vz = rng.uniform(1.9, 2.7) if vz is None else vz
    release = rng.uniform(0.35, 0.6)
    late = np.maximum(t - release, 0.0)
    # The pan: dips and tilts until the release, then slows down and moves under the pancake.
    share = np.clip(t / release, 0.0, 1.0)
    tilt = rng.uniform(0.0, 0.25)
    pan_z = 0.9 - 0.08 * np.sin(math.pi * share) ** 2 + 0.05 * (1.0 - np.exp(-late / 0.05))
    pan_x = 0.6 + 0.1 * share + 0.05 * (1.0 - np.exp(-late / 0.1))
    tilts = (tilt * share**2 - 0.3 * np.sin(math.pi * share)) * np.exp(-late / 0.1)
    vectors = np.stack([0.0 * t, -tilts, 0.0 * t], axis=1)
    pan_position = np.stack([pan_x, 0.02 * share, pan_z], axis=1)
    pan_matrix = rotations.exp(vectors)
    every = slice(None, None, round(0.01 / STEP))
    pan = EndEffectorPath(
        "t", t[every], pan_position[every], rotations.quat_of_vector(vectors[every])
    )
    # The flight.
    k = int(np.searchsorted(t, release))
    centre = pan_position + 0.0025 * pan_matrix[:, :, 2]
    position = centre.copy()
    flight_time = 2.0 * vz / G
    turns = rng.uniform(0.0, 300.0 / 180.0) if half_turns is None else half_turns
    rate = max(turns * math.pi - tilt, 0.0) / flight_time
    axis = rotations.exp([0.0, 0.0, rng.uniform(-0.3, 0.3)]) @ [0.0, -1.0, 0.0]
    # A symmetric top: the normal turns about a fixed axis that leans towards it by the precession.
    axis = axis + precession * pan_matrix[k, :, 2]
    axis /= np.linalg.norm(axis)
    decay = 0.12 * air  # the drag's torque grows with the square of the spin
    turned = np.log1p(decay * rate * late) / decay if decay else rate * late
    attitude = rotations.exp(turned[:, None] * axis)
    matrix = np.where((t >= release)[:, None, None], attitude @ pan_matrix[k], pan_matrix)
    normal = matrix[:, :, 2]
    v = np.array([rng.uniform(-0.1, 0.4), rng.uniform(-0.1, 0.1), vz])
    wind = np.array([*rng.normal(0.0, 0.1, 2), 0.0]) * air
    landed = len(t)
    for i in range(k, len(t) - 1):
        relative = v - wind
        speed = np.linalg.norm(relative)
        facing = abs(relative @ normal[i]) / max(speed, 1e-9)
        a = -air * (0.15 + 0.3 * facing) * speed * relative
        a[2] -= G
        position[i + 1] = position[i] + STEP * v + 0.5 * STEP**2 * a
        v = v + STEP * a
        gap = pan_matrix[i + 1, :, 2] @ (position[i + 1] - pan_position[i + 1])
        if i > k + 100 and gap < RADIUS * math.sqrt(max(0.0, 1.0 - normal[i + 1, 2] ** 2)):
            landed = i + 1
            break
    # Afterwards it lies flat, on the side it fell on.
    on = position[landed:]
    side = np.sign(normal[landed - 1, 2])
    stay = position[landed - 1] - pan_position[landed - 1] if landed < len(t) else np.zeros(3)
    stay = np.array([*np.clip(stay[:2], -0.04, 0.04), 0.0025])
    on[:] = pan_position[landed:] + np.einsum("tij,j->ti", pan_matrix[landed:], stay)
    matrix[landed:] = pan_matrix[landed:] @ np.diag([1.0, side, side])
    body = rotations.exp(rng.normal(size=3))
    rest = math.atan2(-pan_matrix[k, 0, 2], pan_matrix[k, 2, 2])
    above = position[:, 2] - pan_z - DELTA_H
    apex = k + int(np.argmax(position[k:landed, 2]))
    low = np.flatnonzero(above[apex:] <= 0.0)
    t_f = math.nan
    if len(low) and above[apex] > 0.0:
        j = apex + int(low[0])
        t_f = float(t[j] - STEP * above[j] / (above[j] - above[j - 1]))
    return Toss(
        t, pan, position, matrix @ body, matrix[:, :, 2].copy(), rest + turned, release, t_f
    )


def frames(
    toss: Toss,
    rng: np.random.Generator,
    rate: float = 30.0,
    noise: float = 1.0,
    dropout: float = 0.0,
) -> BodyPath:
    """What motion capture makes of it: random phase, noise, missing frames."""
    t = np.arange(rng.uniform(0.0, 1.0 / rate), END - 0.01, 1.0 / rate)
    t = t[(rng.uniform(size=len(t)) >= dropout) | (t < 0.1)]
    index = np.rint(t / STEP).astype(int)
    position = toss.position[index] + noise * rng.normal(0.0, 0.00025, (len(t), 3))
    jitter = rotations.exp(noise * rng.normal(0.0, 0.0035, (len(t), 3)))
    return BodyPath("t", toss.t[index], position, rotations.quat_xyzw(jitter @ toss.matrix[index]))


def without(path: BodyPath, lost: np.ndarray) -> BodyPath:
    """The path without the frames that `lost` marks."""
    return BodyPath(path.id, path.t[~lost], path.position[~lost], path.quat_xyzw[~lost])


def at(toss: Toss, t: float, values: np.ndarray) -> np.ndarray:
    """A column of the truth between two steps."""
    k = int(t / STEP)
    return values[k] + (t / STEP - k) * (values[k + 1] - values[k])


def between(a: np.ndarray, b: np.ndarray) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def true_angle(toss: Toss) -> float:
    """arccos(v0 . v_tf), unfolded."""
    folded = between(np.array([0.0, 0.0, 1.0]), at(toss, toss.t_f, toss.normal))
    return folded if at(toss, toss.t_f, toss.winding) <= math.pi else 2.0 * math.pi - folded


def errors(toss: Toss, flight: Flight) -> dict[str, tuple[float, float]]:
    """Error and stated standard deviation, quantity by quantity."""
    position = flight.position - at(toss, toss.t_f, toss.position)
    worst = int(np.argmax(np.abs(position) / flight.position_std))
    return {
        "t_f": (flight.t_f - toss.t_f, flight.t_f_std),
        "position": (position[worst], flight.position_std[worst]),
        "normal": (between(flight.normal, at(toss, toss.t_f, toss.normal)), flight.normal_std),
        "angle": (flight.angle - true_angle(toss), flight.angle_std),
    }


def many(
    count: int, seed: int, lose: float = 0.0, air: float = 1.0, rate: float = 30.0
) -> list[tuple[Toss, BodyPath, Flight]]:
    rng = np.random.default_rng(seed)
    result = []
    while len(result) < count:
        truth = toss(rng, air=air, precession=rng.uniform(0.0, 0.2))
        seen = frames(truth, rng, rate=rate, dropout=lose)
        flight = observe_flight(truth.pan, seen)
        if math.isfinite(truth.t_f) and flight.frames >= 2:
            result.append((truth, seen, flight))
    return result


@pytest.mark.parametrize(
    ("lose", "air", "rate"),
    [(0.0, 1.0, 30.0), (0.4, 1.0, 30.0), (0.0, 2.0, 30.0), (0.0, 1.0, 120.0)],
)
def test_errors_stay_within_three_stated_standard_deviations(
    lose: float, air: float, rate: float
) -> None:
    flights = many(40, seed=5, lose=lose, air=air, rate=rate)
    seen = [(truth, flight) for truth, _, flight in flights if flight.seen]
    assert len(seen) >= 0.9 * len(flights)
    ratios = np.array(
        [[abs(e) / s for e, s in errors(truth, flight).values()] for truth, flight in seen]
    )
    assert np.mean(ratios <= 3.0) >= 0.98
    # The stated figures are not merely large.
    assert np.median([flight.t_f_std for _, flight in seen]) < 0.001
    assert np.median([flight.position_std.max() for _, flight in seen]) < 0.0015
    assert np.median([flight.angle_std for _, flight in seen]) < math.radians(0.5)


def test_the_fit_is_many_times_nearer_than_the_nearest_frame() -> None:
    fitted, nearest = [], []
    for truth, path, flight in many(25, seed=8):
        k = int(np.argmin(np.abs(path.t - truth.t_f)))
        where = at(truth, truth.t_f, truth.position)
        nearest.append(np.linalg.norm(path.position[k] - where))
        fitted.append(np.linalg.norm(flight.position - where))
    assert np.mean(nearest) > 0.008
    assert np.mean(fitted) < 0.1 * np.mean(nearest)


def test_drag_biases_the_result_by_less_than_a_millimetre_and_half_a_degree() -> None:
    flights = many(40, seed=3)
    found = [errors(truth, flight) for truth, _, flight in flights]
    assert abs(np.mean([error["t_f"][0] for error in found])) < 0.0005
    assert abs(np.mean([error["angle"][0] for error in found])) < math.radians(0.5)
    along = [f.position - at(truth, truth.t_f, truth.position) for truth, _, f in flights]
    assert np.abs(np.mean(along, axis=0)).max() < 0.001


def test_angles_beyond_half_a_turn_are_unfolded() -> None:
    rng = np.random.default_rng(2)
    for half_turns in (0.3, 0.9, 1.3, 1.6):
        truth = toss(rng, vz=2.4, half_turns=half_turns, air=0.0)
        flight = observe_flight(truth.pan, frames(truth, rng))
        assert flight.angle == pytest.approx(true_angle(truth), abs=0.03)
        assert math.cos(flight.angle) == pytest.approx(flight.normal @ flight.normal_start)


def test_a_spin_of_twenty_radians_a_second_is_not_mistaken_for_a_slower_one() -> None:
    rng = np.random.default_rng(11)
    for _ in range(5):
        truth = toss(rng, vz=3.0, half_turns=20.0 * 2.0 * 3.0 / G / math.pi, air=0.0)
        flight = observe_flight(truth.pan, frames(truth, rng))
        assert flight.spin_rate == pytest.approx(20.0, abs=2.5)


def test_the_bodys_own_axes_do_not_matter() -> None:
    rng = np.random.default_rng(4)
    truth = toss(rng, vz=2.3, half_turns=1.0)
    path = frames(truth, rng)
    turned = rotations.multiply(path.quat_xyzw, rotations.quat_of_vector([0.7, -1.1, 2.0]))
    flight = observe_flight(truth.pan, path)
    other = observe_flight(truth.pan, replace(path, quat_xyzw=turned))
    assert other.angle == pytest.approx(flight.angle, abs=1e-6)
    assert other.normal == pytest.approx(flight.normal, abs=1e-6)


def test_the_same_flight_turned_and_shifted_in_the_base_frame_gives_the_same_terms() -> None:
    rng = np.random.default_rng(9)
    truth = toss(rng, vz=2.3, half_turns=1.0)
    path = frames(truth, rng)
    yaw, shift = np.array([0.0, 0.0, 0.8]), np.array([0.3, -0.2, 0.4])
    matrix, quat = rotations.exp(yaw), rotations.quat_of_vector(yaw)

    def moved(path: BodyPath | EndEffectorPath) -> BodyPath | EndEffectorPath:
        return replace(
            path,
            position=path.position @ matrix.T + shift,
            quat_xyzw=rotations.multiply(np.broadcast_to(quat, (len(path.t), 4)), path.quat_xyzw),
        )

    one, two = observe_flight(truth.pan, path), observe_flight(moved(truth.pan), moved(path))
    assert two.t_f == pytest.approx(one.t_f, abs=1e-9)
    assert two.angle == pytest.approx(one.angle, abs=1e-5)
    assert two.apex == pytest.approx(one.apex, abs=1e-9)
    assert two.landing_error == pytest.approx(matrix @ one.landing_error, abs=1e-6)


def test_a_wild_frame_in_the_flight_changes_little() -> None:
    rng = np.random.default_rng(6)
    for _ in range(5):
        truth = toss(rng, vz=2.4, half_turns=1.0)
        path = frames(truth, rng)
        flight = observe_flight(truth.pan, path)
        k = int(np.argmin(np.abs(path.t - truth.release - 0.2)))
        position = path.position.copy()
        position[k] += [0.05, -0.03, 0.06]
        spoilt = observe_flight(truth.pan, replace(path, position=position))
        assert spoilt.t_f == pytest.approx(flight.t_f, abs=0.002)
        assert np.linalg.norm(spoilt.position - flight.position) < 0.004


def test_a_frame_slightly_off_counts_less() -> None:
    rng = np.random.default_rng(16)
    moved = []
    for _ in range(6):
        truth = toss(rng, vz=2.4, half_turns=1.0)
        path = frames(truth, rng)
        flight = observe_flight(truth.pan, path)
        k = int(np.argmin(np.abs(path.t - 0.5 * (truth.release + truth.t_f))))
        position = path.position.copy()
        position[k] += [0.012, 0.012, -0.012]
        spoilt = observe_flight(truth.pan, replace(path, position=position))
        moved.append(np.linalg.norm(spoilt.position - flight.position))
    assert np.median(moved) < 0.0025


def test_a_bounce_between_two_frames_does_not_spoil_the_flight() -> None:
    rng = np.random.default_rng(13)
    for _ in range(5):
        truth = toss(rng, vz=2.4, half_turns=1.0, air=0.0)
        path = frames(truth, rng)
        flight = observe_flight(truth.pan, path)
        last = np.flatnonzero((path.t > truth.t_f) & (path.position[:, 2] > 1.0))
        start = (last[-1] if len(last) else int(np.argmax(path.t > truth.t_f))) + 1
        s = path.t[start:] - path.t[start] + 0.03
        position = path.position.copy()
        arc = 0.96 + np.maximum(1.6 * s - 0.5 * G * s**2, 0.0)
        position[start:, 2] = np.where(s < 0.3, arc, position[start:, 2])
        bounced = observe_flight(truth.pan, replace(path, position=position))
        assert bounced.t_f == pytest.approx(flight.t_f, abs=0.002)
        assert np.linalg.norm(bounced.position - flight.position) < 0.003


def test_cameras_worse_than_believed_are_noticed() -> None:
    rng = np.random.default_rng(14)
    late, stds = [], []
    for _ in range(40):
        truth = toss(rng, vz=2.4, half_turns=1.0)
        flight = observe_flight(truth.pan, frames(truth, rng, noise=8.0))
        late.append(abs(flight.t_f - truth.t_f) / flight.t_f_std)
        stds.append(flight.position_std[:2].max())
    assert np.mean(np.array(late) <= 3.0) >= 0.9
    assert np.median(stds) > 0.001


def test_a_low_toss_is_no_toss() -> None:
    rng = np.random.default_rng(1)
    truth = toss(rng, vz=1.3, half_turns=0.2)
    assert not math.isfinite(truth.t_f)
    flight = observe_flight(truth.pan, frames(truth, rng))
    assert (flight.tossed, flight.seen, flight.angle) == (False, True, 0.0)
    assert flight.t_f == truth.pan.t[-1]
    assert flight.apex > 0.0
    assert np.array_equal(flight.landing_error, np.zeros(3))


@pytest.mark.parametrize(("half_turns", "flipped"), [(0.1, False), (1.0, True), (1.9, False)])
def test_what_lies_in_the_pan_at_the_end_is_seen(half_turns: float, flipped: bool) -> None:
    rng = np.random.default_rng(7)
    truth = toss(rng, vz=2.2, half_turns=half_turns, air=0.0)
    flight = observe_flight(truth.pan, frames(truth, rng))
    assert (flight.resting, flight.flipped) == (True, flipped)


def test_a_pancake_beside_the_pan_or_on_edge_does_not_rest_in_it() -> None:
    rng = np.random.default_rng(7)
    truth = toss(rng, vz=2.2, half_turns=1.0)
    path = frames(truth, rng)
    end = path.t > END - 0.5
    beside = path.position + np.outer(end, [0.3, 0.0, -0.5])
    assert not observe_flight(truth.pan, replace(path, position=beside)).resting
    tilted = rotations.multiply(
        np.broadcast_to(rotations.quat_of_vector([0.4, 0.0, 0.0]), path.quat_xyzw.shape),
        path.quat_xyzw,
    )
    quat = np.where(end[:, None], tilted, path.quat_xyzw)
    assert not observe_flight(truth.pan, replace(path, quat_xyzw=quat)).resting
    assert not observe_flight(truth.pan, without(path, end)).resting


def test_one_bad_frame_before_the_toss_spoils_nothing() -> None:
    rng = np.random.default_rng(18)
    truth = toss(rng, vz=2.3, half_turns=1.0)
    path = frames(truth, rng)
    flight = observe_flight(truth.pan, path)
    for k in range(4):
        for shift in (0.0, 0.3):
            position, quat = path.position.copy(), path.quat_xyzw.copy()
            position[k, 0] += shift
            quat[k] = [1.0, 0.0, 0.0, 0.0]
            spoilt = observe_flight(truth.pan, replace(path, position=position, quat_xyzw=quat))
            assert spoilt.seen
            assert spoilt.angle == pytest.approx(flight.angle, abs=0.01)


def test_losing_the_view_is_told_and_never_breaks_the_numbers() -> None:
    rng = np.random.default_rng(12)
    for vz in (0.8, 2.3):
        truth = toss(rng, vz=vz, half_turns=1.0)
        path = frames(truth, rng)
        for keep in range(len(path.t) + 1):  # the view is lost for ever after `keep` frames
            _assert_finite(observe_flight(truth.pan, without(path, np.arange(len(path.t)) >= keep)))
            _assert_finite(observe_flight(truth.pan, without(path, np.arange(len(path.t)) < keep)))
        nothing = observe_flight(truth.pan, without(path, path.t > 0.0))
        assert (nothing.tossed, nothing.seen, nothing.resting) == (False, False, False)
        assert np.array_equal(nothing.landing_error, np.zeros(3))
    air = (path.t > truth.release) & (path.t < truth.t_f + 0.1)
    one = np.flatnonzero(air)[len(np.flatnonzero(air)) // 2]
    single = observe_flight(truth.pan, without(path, air & (np.arange(len(path.t)) != one)))
    assert (single.tossed, single.seen) == (True, False)


def _assert_finite(flight: Flight) -> None:
    for name, value in vars(flight).items():
        assert np.all(np.isfinite(value)), name
    assert flight.t_f_std >= 0.0
    assert np.linalg.norm(flight.spin_axis) == pytest.approx(1.0)


def test_two_frames_give_a_wide_but_honest_answer() -> None:
    rng = np.random.default_rng(21)
    inside = []
    for _ in range(15):
        truth = toss(rng, vz=2.4, half_turns=rng.uniform(0.4, 1.2))
        path = frames(truth, rng)
        air = np.flatnonzero((path.t > truth.release + 0.06) & (path.t < truth.t_f))
        lost = np.zeros(len(path.t), dtype=bool)
        lost[air] = True
        lost[rng.choice(air, 2, replace=False)] = False
        flight = observe_flight(truth.pan, without(path, lost))
        if flight.tossed and flight.seen:
            inside += [abs(e) <= 3.0 * s for e, s in errors(truth, flight).values()]
    assert len(inside) >= 40
    assert np.mean(inside) >= 0.95


def test_the_result_is_the_same_every_time() -> None:
    rng = np.random.default_rng(30)
    truth = toss(rng)
    path = frames(truth, rng)
    one, two = observe_flight(truth.pan, path), observe_flight(truth.pan, path)
    for name, value in vars(one).items():
        assert np.array_equal(value, getattr(two, name)), name


def test_paths_of_different_rollouts_and_a_height_that_is_not_positive_are_refused() -> None:
    rng = np.random.default_rng(1)
    truth = toss(rng)
    path = frames(truth, rng)
    with pytest.raises(ValueError, match="one rollout"):
        observe_flight(truth.pan, replace(path, id="other"))
    with pytest.raises(ValueError, match="delta_h"):
        observe_flight(truth.pan, path, delta_h=math.nan)
