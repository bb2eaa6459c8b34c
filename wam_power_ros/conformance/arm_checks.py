# SPDX-License-Identifier: Apache-2.0
"""Checks of the arm's driver: joint names, units, velocities, gravity torques, order and signs.

The rigid-body model predicts the torques of an arm at rest. Where the driver reports torques, the
comparison shows whether joint order, signs and zero positions agree with the model.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from wam_power_ros.conformance.topic_checks import FAIL, OK, UNCHECKED, WARN, Row
from wam_power_ros.control.arm import Arm

STILL_RANGE = 0.02  # [rad] largest range of a joint while the arm is at rest
MOVED_RANGE = 0.1  # [rad] smallest range of a joint that a person has moved
REST_SPEED = 0.1  # [rad/s] largest velocity at rest
VELOCITY_LAG_MAX = 0.016  # [s] that the plausibility checks were shown to bear in a flip
SLOPE_WINDOW = 0.05  # [s] over which positions are differentiated
LIMIT_TOLERANCE = 0.05  # [rad] beyond a position limit: zeros are set by hand
GRAVITY_SHARE = 0.15  # relative tolerance for gravity torques: models of drivers differ
GRAVITY_FLOOR = 0.15  # [N m] absolute tolerance, added to it
GRAVITY_MIN = 3.0  # [N m] without a larger gravity torque the comparison shows nothing
CURRENT_MIN = 0.05  # [A] below which motors carry nothing
PERMUTED_MAX = 8  # joints; of at most as many, every order is tried: 40 320


class StateSample(NamedTuple):
    """One joint state as received; the arrays may have any length."""

    received_ns: int
    stamp_ns: int
    names: tuple[str, ...]
    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray


@dataclass(frozen=True)
class ArmRecord:
    """States of the configured joints, in the configured order.

    Attributes:
        joint_names: Names of the joints in the driver's messages.
        received_ns: Times of arrival [ns], shape (m,).
        stamp_ns: Stamps [ns], shape (m,).
        q: Positions [rad] if the units are correct, shape (m, n).
        qd: Velocities, shape (m, n); None when a message had none.
        tau: Torques, shape (m, n); None when a message had none.
    """

    joint_names: tuple[str, ...]
    received_ns: np.ndarray
    stamp_ns: np.ndarray
    q: np.ndarray
    qd: np.ndarray | None
    tau: np.ndarray | None

    @property
    def still(self) -> bool:
        """Whether no joint moved."""
        return len(self.q) > 0 and bool(np.ptp(self.q, axis=0).max() < STILL_RANGE)


def collect(samples: Sequence[StateSample], joint_names: Sequence[str]) -> tuple[ArmRecord, Row]:
    """Record of the configured joints from samples in order of arrival, and the row about names."""
    configured, complete = set(joint_names), []
    wrong: Counter[str] = Counter()
    others: dict[str, None] = {}
    for sample in samples:
        names = sample.names
        others.update(dict.fromkeys(name for name in names if name not in configured))
        if not configured.intersection(names):
            continue
        if missing := [name for name in joint_names if name not in names]:
            wrong[f"without {', '.join(missing)}"] += 1
        elif len(set(names)) != len(names):
            wrong["a name twice"] += 1
        elif len(sample.q) != len(names):
            wrong[f"{len(sample.q)} positions for {len(names)} names"] += 1
        elif not np.isfinite(sample.q).all():
            wrong["a position that is not finite"] += 1
        else:
            complete.append(sample)
    indices = {names: list(map(names.index, joint_names)) for names in {s.names for s in complete}}

    def values(field: str) -> np.ndarray | None:
        pairs = [(getattr(sample, field), sample.names) for sample in complete]
        if any(len(row) != len(names) for row, names in pairs):
            return None
        return np.array([row[indices[names]] for row, names in pairs])

    empty = np.empty((0, len(joint_names)))
    q, qd, tau = map(values, ("q", "qd", "tau")) if complete else (empty, None, None)
    received_ns, stamp_ns = (
        np.array([sample[:2] for sample in complete], dtype=np.int64).reshape(-1, 2).T
    )
    q = empty if q is None else q
    record = ArmRecord(tuple(joint_names), received_ns, stamp_ns, q, qd, tau)
    return record, _names(joint_names, complete, wrong, list(others))


def with_velocity(record: ArmRecord, received_ns: np.ndarray, qd: np.ndarray) -> ArmRecord:
    """Add velocities from a separate topic: the last received [ns] before each state."""
    if len(received_ns) == 0 or len(record.q) == 0:
        return replace(record, qd=None)
    last = np.searchsorted(received_ns, record.received_ns, side="right") - 1
    return replace(record, qd=qd[np.maximum(last, 0)])


def _names(
    joint_names: Sequence[str], complete: list[StateSample], wrong: Counter[str], others: list[str]
) -> Row:
    row = partial(Row, "joint names", " ".join(joint_names))
    also = f"; also received: {' '.join(others)}" if others else ""
    if wrong:
        text = ", ".join(f"{count} messages {defect}" for defect, count in wrong.items())
        advice = "each state must contain every joint of the arm once, with its position"
        return row(text + also, FAIL, advice)
    if not complete:
        advice = "set joint_names of the set-up to the names that the driver uses"
        return row(" ".join(others) or "no names at all", FAIL, advice)
    order = complete[0].names == tuple(joint_names)
    return row(f"{'as expected' if order else 'in another order, matched by name'}{also}", OK)


def one_publisher(topic: str, second: str) -> Row:
    """Whether one publisher sends the states of the arm; `second` is a sentence on several."""
    row = partial(Row, "state publisher", f"one sends the states of the arm on {topic}")
    if second:
        return row(second, FAIL, "end the other, or give it a topic or joint names of its own")
    return row("one", OK)


def positions(record: ArmRecord, arm: Arm) -> Row:
    """Whether positions are radians within the joints' limits."""
    row, q = partial(Row, "positions", "rad, within the limits of the URDF"), record.q
    if len(q) == 0:
        return row("none", UNCHECKED)
    text = f"{_listed(q[-1])} rad" + ("" if record.still else ", moving")
    inside = _within(q, arm).all(axis=0)
    if inside.all():
        return row(text, OK)
    if np.abs(q).max() > 7.0 and _within(np.deg2rad(q), arm).all():
        return row(_listed(q[-1]), FAIL, "these are degrees: send radians")
    outside = ", ".join(record.joint_names[i] for i in np.flatnonzero(~inside))
    return row(text, FAIL, f"{outside} beyond its limit: wrong zero, sign, order or URDF")


def _within(q: np.ndarray, arm: Arm) -> np.ndarray:
    """Whether each position is within its limits, with a tolerance. Shape as `q`."""
    return (q >= arm.q_min - LIMIT_TOLERANCE) & (q <= arm.q_max + LIMIT_TOLERANCE)


def velocity(record: ArmRecord, topic: str = "") -> Row:
    """Whether velocities, of a topic or the states, agree with the positions' derivative."""
    row = partial(Row, "velocity", f"rad/s on {topic}" if topic else "rad/s in every state")
    qd = record.qd
    advice = "set velocity_topic if the driver has one; else the controller differentiates"
    if qd is None or not len(record.q):
        return row("no velocity", FAIL, advice)
    if np.isnan(qd).any():
        return row("NaN: no velocity", FAIL, advice)
    if not np.isfinite(qd).all():
        return row("not finite", FAIL, "a driver must not send infinite velocities")
    worst = float(np.abs(qd).max())
    if record.still and worst < REST_SPEED:
        return row(f"at most {worst:.3f} rad/s, at rest; not compared in motion", OK)
    if record.still:
        advice = "the arm is at rest: other units, other joints or another quantity"
        return row(f"up to {worst:.2f} at rest", FAIL, advice)
    slopes = _slopes(record, qd)
    text = ", ".join(f"{record.joint_names[i]} x {slope:.2f}" for i, slope in slopes.items())
    wrong = [slope for slope in slopes.values() if abs(slope - 1.0) > 0.3]
    if not wrong:
        return row(f"against positions: {text}", OK)
    advice = "they are not the derivative of the positions: other joints, units or signs"
    if all(abs(slope * math.pi / 180.0 - 1.0) < 0.3 for slope in slopes.values()):
        advice = "these are degrees a second: send rad/s"
    elif all(abs(slope + 1.0) < 0.3 for slope in wrong):
        advice = "their sign is reversed"
    return row(f"against positions: {text}", FAIL, advice)


def _slopes(record: ArmRecord, qd: np.ndarray) -> dict[int, float]:
    """Ratio of velocity to derivative of position, by index of the joints that moved; ideally 1."""
    t = (record.stamp_ns - record.stamp_ns[0]) * 1e-9
    step = max(1, int(np.searchsorted(t, SLOPE_WINDOW)))
    dq = record.q[step:] - record.q[:-step]  # (k, n)
    dt = np.maximum(t[step:] - t[:-step], 1e-9)
    sums = np.cumsum(np.vstack([np.zeros(qd.shape[1]), qd]), axis=0)
    mean = (sums[step + 1 :] - sums[1:-step]) / step  # (k, n) over the same intervals
    rate = dq / dt[:, None]
    moved = np.flatnonzero(np.ptp(record.q, axis=0) >= STILL_RANGE)
    return {int(i): float((rate[:, i] @ mean[:, i]) / (rate[:, i] @ rate[:, i])) for i in moved}


def velocity_lag(record: ArmRecord, joint: int) -> Row:
    """How late the velocity of a moved joint is, against the derivative of its position."""
    name = f"velocity lag, {record.joint_names[joint]}"
    row = partial(Row, name, f"at most {VELOCITY_LAG_MAX * 1e3:.0f} ms")
    t = (record.stamp_ns - record.stamp_ns[0]) * 1e-9 if len(record.q) else np.empty(0)
    if record.qd is None or len(t) < 50 or np.ptp(record.q[:, joint]) < MOVED_RANGE:
        return row("not moved, or no velocity", UNCHECKED)
    q, qd = record.q[:, joint], record.qd[:, joint]
    # The integral of the velocity is the position at an earlier time, plus a constant.
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (qd[1:] + qd[:-1]) * np.diff(t))])
    inside = (t > 2.0 * VELOCITY_LAG_MAX) & (t < t[-1] - 2.0 * VELOCITY_LAG_MAX)
    lags = np.arange(-VELOCITY_LAG_MAX, 2.0 * VELOCITY_LAG_MAX, 0.001)
    errors = [np.std(integral[inside] - np.interp(t[inside] - lag, t, q)) for lag in lags]
    lag = float(lags[int(np.argmin(errors))])
    text = f"{max(lag, 0.0) * 1e3:.0f} ms"
    if lag <= VELOCITY_LAG_MAX:
        return row(text, OK)
    advice = "a fast movement such as a flip may be stopped: filter less, or let the controller"
    return row(text, WARN, f"{advice} differentiate (no velocity in the states)")


def effort(record: ArmRecord, quantity: str = "torque") -> Row:
    """Whether the driver reports the effort that the set-up says; see `gravity`."""
    units = {"torque": "N m", "external": "N m without gravity", "current": "A of the motors"}
    unit = units.get(quantity)
    row = partial(Row, "effort", f"{unit} in every state" if unit else "none")
    if record.tau is None or not np.isfinite(record.tau).all():
        advice = "without it gravity, joint order and watchdog cannot be checked at rest"
        return row("no effort", WARN if unit else OK, advice if unit else "")
    found = _listed(record.tau.mean(axis=0))
    if not unit:
        advice = "the driver reports one: set effort to torque, external or current"
        return row(found, WARN, advice)
    return row(f"{found} {unit}", OK)


def gravity(record: ArmRecord, arm: Arm, quantity: str = "torque") -> Row:
    """Whether the reported effort at rest is that of g(q); if not, which mistake explains it.

    Drivers of torque-controlled arms report the command, gravity included, or a measured torque.
    Of motor currents only the signs can be compared, so that no such row is OK.

    Args:
        quantity: Quantity in the field `effort`: "torque" [N m], "external" without gravity [N m],
            "current" of the motors [A], or "none".
    """
    by_hand = "move each joint when asked instead"
    expected = "effort at rest is g(q): order, signs, zero and payload as in the URDF"
    if quantity == "external":
        expected = "effort at rest is zero: gravity is left out of it"
    if quantity == "current":
        expected = "current at rest has the signs of g(q)"
    row = partial(Row, "gravity", expected)
    if quantity == "none":
        return row("no effort, as the set-up says", UNCHECKED, by_hand)
    if record.tau is None or not np.isfinite(record.tau).all() or not len(record.q):
        return row("no effort", UNCHECKED, by_hand)
    if not record.still:
        return row("the arm moves", UNCHECKED, "keep the arm at rest")
    if quantity == "current":
        return _current(row, record, arm)
    if quantity == "external":
        return _external(row, record, arm)
    q, tau = record.q.mean(axis=0), record.tau.mean(axis=0)
    g = arm.gravity(q)
    text = f"{_listed(tau)} N m, g(q) {_listed(g)} N m"
    mistake = _mistake(q, tau, arm, record.joint_names)
    if mistake is None and np.abs(g).max() < GRAVITY_MIN:
        return row(text, UNCHECKED, "stretch the arm out, so that gravity loads its joints")
    if mistake is None:
        alike = ", ".join(_indistinguishable(q, tau, arm, record.joint_names))
        advice = f"cannot distinguish {alike} from each other: move each by hand" if alike else ""
        return row(text, OK, advice)
    if np.abs(tau).max() < GRAVITY_FLOOR:
        advice = "the driver is idle or reports torques without gravity; move each joint when asked"
        return row(text, UNCHECKED, advice)
    return row(text, FAIL, mistake)


def _external(row: partial[Row], record: ArmRecord, arm: Arm) -> Row:
    """Row about torques without gravity: small ones, which tell of friction or of a payload."""
    assert record.tau is not None
    q, tau = record.q.mean(axis=0), record.tau.mean(axis=0)
    g, known = arm.gravity(q), 2.0 * arm.friction + GRAVITY_FLOOR
    text = f"{_listed(tau)} N m without gravity, g(q) {_listed(g)} N m"
    if (np.abs(tau) <= known + GRAVITY_SHARE * np.abs(g)).all():
        advice = "order, signs and zero do not show at rest: move each joint when asked"
        return row(text, UNCHECKED, advice)
    if np.abs(tau - g).max() < np.abs(tau).max():
        return row(text, FAIL, "it contains gravity: set effort to torque")
    return row(text, FAIL, "something pushes the arm, or its payload is not set in the robot")


def _current(row: partial[Row], record: ArmRecord, arm: Arm) -> Row:
    """Row about motor currents: their signs, at the joints that friction alone cannot hold."""
    assert record.tau is not None
    current, g = record.tau.mean(axis=0), arm.gravity(record.q.mean(axis=0))
    text = f"{_listed(current)} A, g(q) {_listed(g)} N m"
    loaded = np.flatnonzero(np.abs(g) > np.maximum(GRAVITY_MIN, 2.0 * arm.friction))
    names = ", ".join(record.joint_names[i] for i in loaded)
    if not len(loaded):
        return row(text, UNCHECKED, "stretch the arm out, so that gravity loads its joints")
    if np.abs(current).max() < CURRENT_MIN:
        advice = "no current: are the brakes released? move each joint when asked instead"
        return row(text, UNCHECKED, advice)
    if wrong := [record.joint_names[i] for i in loaded if current[i] * g[i] < 0.0]:
        advice = f"reversed at {', '.join(wrong)}: wrong sign, order, zero, mounting or URDF"
        return row(text, FAIL, advice)
    advice = "currents have no scale here, so that order, zero and payload do not show: move each "
    return row(f"{text}; signs agree at {names}", UNCHECKED, f"{advice}joint when asked")


def _mistake(q: np.ndarray, tau: np.ndarray, arm: Arm, names: Sequence[str]) -> str | None:
    """Mistake of a driver that explains these positions and torques, None if they are correct."""
    fits = _Fit(q, tau, arm)
    if fits(q, tau):
        return None
    if fits(q, -tau):
        return "torques have the sign reversed"
    for order in _orders(arm.n):
        if fits(q[order], tau[order], sharp=True):
            moved = [i for i in range(arm.n) if order[i] != i]
            wrong, found = (", ".join(names[j] for j in js) for js in (moved, order[moved]))
            return f"wrong order of joints: {wrong} fit the values received as {found}"
    subsets = (itertools.combinations(range(arm.n), size) for size in range(1, arm.n + 1))
    for joints in itertools.chain.from_iterable(subsets):
        signs = np.ones(arm.n)
        signs[list(joints)] = -1.0
        if fits(signs * q, signs * tau, sharp=True):
            return f"sign reversed: {', '.join(names[i] for i in joints)}"
    joint = names[int(np.argmax(fits.errors(q, tau)))]
    return f"wrong zero, payload, mounting or URDF; {joint} has the largest error"


def _indistinguishable(q: np.ndarray, tau: np.ndarray, arm: Arm, names: Sequence[str]) -> list[str]:
    """Names of joints whose exchange with another one would not show at this posture."""
    fits = _Fit(q, tau, arm)
    alike = set()
    for i, j in itertools.combinations(range(arm.n), 2):
        order = np.arange(arm.n)
        order[[i, j]] = j, i
        if fits(q[order], tau[order]):
            alike |= {i, j}
    return [names[i] for i in sorted(alike)]


class _Fit:
    """Decides whether torques agree with g(q); a mistake must fit far better than the values."""

    def __init__(self, q: np.ndarray, tau: np.ndarray, arm: Arm) -> None:
        self._arm = arm
        self._sharp = 0.3 * float(self.errors(q, tau).max())  # a mistake must fit far better

    def errors(self, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Error of each joint as a multiple of its tolerance. Shape (n,)."""
        g = self._arm.gravity(q)
        return np.abs(tau - g) / (GRAVITY_FLOOR + GRAVITY_SHARE * np.abs(g))

    def __call__(self, q: np.ndarray, tau: np.ndarray, sharp: bool = False) -> bool:
        if sharp and not _within(q, self._arm).all():
            return False
        return bool(self.errors(q, tau).max() <= (min(1.0, self._sharp) if sharp else 1.0))


def _orders(n: int) -> list[np.ndarray]:
    """Every wrong order of n joints, those with the fewest exchanged joints first."""
    if n > PERMUTED_MAX:
        return []
    orders = itertools.permutations(range(n))
    ranked = sorted(orders, key=lambda order: sum(i != joint for i, joint in enumerate(order)))
    return [np.array(order) for order in ranked[1:]]


def hand_movement(record: ArmRecord, joint: int) -> Row:
    """Whether a movement by hand moved the joint with this index, in positive direction."""
    names = record.joint_names
    row = partial(Row, f"{names[joint]} by hand", f"{names[joint]} alone, increasing")
    if len(record.q) == 0:
        return row("no states of these joints", FAIL, "the driver stopped sending during the check")
    changes = record.q[-1] - record.q[0]  # (n,)
    moved = int(np.argmax(np.ptp(record.q, axis=0)))
    found = f"{names[moved]} by {changes[moved]:+.2f} rad"
    if np.ptp(record.q[:, moved]) < MOVED_RANGE:
        return row("no joint moved", UNCHECKED, f"move it by {MOVED_RANGE} rad at least")
    if moved != joint:
        return row(found, FAIL, f"wrong order of joints: {names[moved]} is the name of this one")
    if changes[joint] < 0.5 * MOVED_RANGE:
        return row(found, FAIL, "its sign is reversed")
    return row(found, OK)


def tool_direction(arm: Arm, q: np.ndarray, joint: int) -> str:
    """Direction in which the tool moves when a joint increases, for a person facing the arm."""
    column = arm.jacobian(q)[:, joint]
    words = (("forward", "back"), ("to its left", "to its right"), ("up", "down"))
    axis = int(np.argmax(np.abs(column[:3])))
    if abs(column[axis]) > 0.1:
        return f"the tool moves {words[axis][int(column[axis] < 0.0)]}"
    axis = int(np.argmax(np.abs(column[3:])))
    direction = words[axis][int(column[3 + axis] < 0.0)]
    return f"the tool turns clockwise for a person looking {direction}"


def _listed(values: np.ndarray) -> str:
    return " ".join(f"{value:.2f}" for value in values)
