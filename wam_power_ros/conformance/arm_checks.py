# SPDX-License-Identifier: Apache-2.0
"""Checks of the arm's driver: joint names, units, velocities, gravity torques, order and signs.

The rigid-body model gives the torques of an arm at rest: where the driver reports its torques, they
show whether its joints are in order, its signs right and its zero positions those of the model.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from wam_power_ros.conformance.topic_checks import FAIL, OK, UNCHECKED, WARN, Row
from wam_power_ros.control.arm import Arm

STILL = 0.02  # [rad] range of a joint while the arm is at rest
MOVED = 0.1  # [rad] smallest range of a joint that a person has moved
AT_REST = 0.1  # [rad/s] largest velocity at rest
SLOPE_WINDOW = 0.05  # [s] over which positions are differenced
BEYOND = 0.05  # [rad] by which a joint may exceed its limit: zeros are set by hand
GRAVITY_SHARE = 0.15  # relative difference of drivers' own gravity models to ours
GRAVITY_FLOOR = 0.15  # [N m] absolute difference, added to it
GRAVITY_MIN = 3.0  # [N m] largest gravity torque below which the comparison shows nothing
PERMUTED_MAX = 8  # joints, of which every order is tried: 40 320


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
    """States of our joints, in our order.

    Attributes:
        joint_names: Names that the driver gives the joints.
        received_ns: Times of arrival [ns], shape (m,).
        stamp_ns: Stamps [ns], shape (m,).
        q: Positions [rad] if the units are right, shape (m, n).
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
        return len(self.q) > 0 and bool(np.ptp(self.q, axis=0).max() < STILL)


def collect(samples: Sequence[StateSample], joint_names: Sequence[str]) -> tuple[ArmRecord, Row]:
    """Record of our joints from samples in order of arrival, and the row about their names."""
    wanted, whole = set(joint_names), []
    wrong: Counter[str] = Counter()
    others: dict[str, None] = {}
    for sample in samples:
        names = sample.names
        others.update(dict.fromkeys(name for name in names if name not in wanted))
        if not wanted.intersection(names):
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
            whole.append(sample)
    places = {names: list(map(names.index, joint_names)) for names in {s.names for s in whole}}

    def values(field: str) -> np.ndarray | None:
        pairs = [(getattr(item, field), item.names) for item in whole]
        complete = all(len(row) == len(names) for row, names in pairs)
        return np.array([row[places[names]] for row, names in pairs]) if complete else None

    empty = np.empty((0, len(joint_names)))
    q, qd, tau = map(values, ("q", "qd", "tau")) if whole else (empty, None, None)
    times = np.array([item[:2] for item in whole], dtype=np.int64).reshape(-1, 2).T
    record = ArmRecord(tuple(joint_names), *times, empty if q is None else q, qd, tau)
    return record, _names(joint_names, whole, wrong, list(others))


def with_velocity(record: ArmRecord, received_ns: np.ndarray, qd: np.ndarray) -> ArmRecord:
    """Record with velocities (k, n) of a topic of their own, the last before each state.

    Args:
        record: Record of the states.
        received_ns: Times of arrival of the velocities [ns], shape (k,).
        qd: Velocities, shape (k, n).
    """
    if len(received_ns) == 0 or len(record.q) == 0:
        return replace(record, qd=None)
    last = np.searchsorted(received_ns, record.received_ns, side="right") - 1
    return replace(record, qd=qd[np.maximum(last, 0)])


def _names(
    joint_names: Sequence[str], whole: list[StateSample], wrong: Counter[str], others: list[str]
) -> Row:
    row = partial(Row, "joint names", " ".join(joint_names))
    beside = f"; also received: {' '.join(others)}" if others else ""
    if wrong:
        text = ", ".join(f"{count} messages {what}" for what, count in wrong.items())
        advice = "each state must hold every joint of the arm once, with its position"
        return row(text + beside, FAIL, advice)
    if not whole:
        advice = "set joint_names of the configuration to the names that the driver uses"
        return row(" ".join(others) or "no names at all", FAIL, advice)
    order = whole[0].names == tuple(joint_names)
    return row(f"{'as expected' if order else 'in another order, matched by name'}{beside}", OK)


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
    return (q >= arm.q_min - BEYOND) & (q <= arm.q_max + BEYOND)


def velocity(record: ArmRecord, topic: str = "") -> Row:
    """Whether velocities arrive, and agree with the derivative of the positions.

    Args:
        record: Record with the velocities.
        topic: Topic of the velocities, empty when the states are to hold them.
    """
    row = partial(Row, "velocity", f"rad/s on {topic}" if topic else "rad/s in every state")
    qd = record.qd
    advice = "set velocity_topic if the driver has one; the controller can differentiate by itself"
    if qd is None or not len(record.q):
        return row("no velocity", FAIL, advice)
    if np.isnan(qd).any():
        return row("NaN: no velocity", FAIL, advice)
    if not np.isfinite(qd).all():
        return row("not finite", FAIL, "a driver must not send that")
    worst = float(np.abs(qd).max())
    if record.still and worst < AT_REST:
        return row(f"at most {worst:.3f} rad/s, at rest; not compared in motion", OK)
    if record.still:
        advice = "the arm is still: other units, other joints or another quantity"
        return row(f"up to {worst:.2f} at rest", FAIL, advice)
    slopes = _slopes(record)
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


def _slopes(record: ArmRecord) -> dict[int, float]:
    """Velocity over derivative of the position, for joints that moved; 1 where they agree."""
    t = (record.stamp_ns - record.stamp_ns[0]) * 1e-9
    step = max(1, int(np.searchsorted(t, SLOPE_WINDOW)))
    dq = record.q[step:] - record.q[:-step]  # (k, n)
    dt = np.maximum(t[step:] - t[:-step], 1e-9)
    sums = np.cumsum(np.vstack([np.zeros(record.q.shape[1]), record.qd]), axis=0)
    mean = (sums[step + 1 :] - sums[1:-step]) / step  # (k, n) over the same spans
    rate = dq / dt[:, None]
    moved = np.flatnonzero(np.ptp(record.q, axis=0) >= STILL)
    return {int(i): float((rate[:, i] @ mean[:, i]) / (rate[:, i] @ rate[:, i])) for i in moved}


def effort(record: ArmRecord) -> Row:
    """Whether the driver reports torques."""
    row = partial(Row, "effort", "N m in every state")
    if record.tau is None or not np.isfinite(record.tau).all():
        advice = "without it neither gravity, order nor watchdog can be checked at rest"
        return row("no effort", WARN, advice)
    return row(f"{_listed(record.tau.mean(axis=0))} N m", OK)


def gravity(record: ArmRecord, arm: Arm) -> Row:
    """Whether an arm at rest reports the torques that carry it; if not, which mistake fits.

    Drivers of torque-controlled arms report the command, gravity included, or measure the torque.
    """
    expected = "effort of a still arm is g(q): order, signs, zero and payload as in the URDF"
    row = partial(Row, "gravity", expected)
    if record.tau is None or not np.isfinite(record.tau).all() or not len(record.q):
        return row("no effort", UNCHECKED, "move each joint when asked instead")
    if not record.still:
        return row("the arm moves", UNCHECKED, "let it rest")
    q, tau = record.q.mean(axis=0), record.tau.mean(axis=0)
    g = arm.gravity(q)
    text = f"{_listed(tau)} N m, g(q) {_listed(g)} N m"
    mistake = _mistake(q, tau, arm, record.joint_names)
    if mistake is None and np.abs(g).max() < GRAVITY_MIN:
        return row(text, UNCHECKED, "lean the arm out, so that gravity pulls at it")
    if mistake is None:
        alike = ", ".join(_alike(q, tau, arm, record.joint_names))
        advice = f"cannot distinguish {alike} from each other: move each by hand" if alike else ""
        return row(text, OK, advice)
    if np.abs(tau).max() < GRAVITY_FLOOR:
        advice = "the driver is idle or reports torques without gravity; move each joint when asked"
        return row(text, UNCHECKED, advice)
    return row(text, FAIL, mistake)


def _mistake(q: np.ndarray, tau: np.ndarray, arm: Arm, names: Sequence[str]) -> str | None:
    """Mistake of a driver that would explain these positions and torques, None without one."""
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
    for joints in _subsets(arm.n):
        signs = np.ones(arm.n)
        signs[list(joints)] = -1.0
        if fits(signs * q, signs * tau, sharp=True):
            return f"sign reversed: {', '.join(names[i] for i in joints)}"
    joint = names[int(np.argmax(fits.errors(q, tau)))]
    return f"wrong zero, payload, mounting or URDF; {joint} is the farthest off"


def _alike(q: np.ndarray, tau: np.ndarray, arm: Arm, names: Sequence[str]) -> list[str]:
    """Joints whose exchange with another one would not show at this posture."""
    fits = _Fit(q, tau, arm)
    alike = set()
    for i, j in itertools.combinations(range(arm.n), 2):
        order = np.arange(arm.n)
        order[[i, j]] = j, i
        if fits(q[order], tau[order]):
            alike |= {i, j}
    return [names[i] for i in sorted(alike)]


class _Fit:
    """Whether positions and torques can be those of the still arm."""

    def __init__(self, q: np.ndarray, tau: np.ndarray, arm: Arm) -> None:
        self._arm = arm
        self._sharp = 0.3 * float(self.errors(q, tau).max())  # another order must fit far better

    def errors(self, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Error of each joint as a multiple of its tolerance (n,)."""
        g = self._arm.gravity(q)
        return np.abs(tau - g) / (GRAVITY_FLOOR + GRAVITY_SHARE * np.abs(g))

    def __call__(self, q: np.ndarray, tau: np.ndarray, sharp: bool = False) -> bool:
        if sharp and not _within(q, self._arm).all():
            return False
        return bool(self.errors(q, tau).max() <= (min(1.0, self._sharp) if sharp else 1.0))


def _orders(n: int) -> list[np.ndarray]:
    """Every order of n joints but the right one, the fewest exchanged first."""
    if n > PERMUTED_MAX:
        return []
    every = itertools.permutations(range(n))
    ranked = sorted(every, key=lambda order: sum(i != place for i, place in enumerate(order)))
    return [np.array(order) for order in ranked[1:]]


def _subsets(n: int) -> Iterator[tuple[int, ...]]:
    for size in range(1, n + 1):
        yield from itertools.combinations(range(n), size)


def led(record: ArmRecord, joint: int) -> Row:
    """Whether a movement by hand was that of the joint with this index, in positive direction."""
    names = record.joint_names
    row = partial(Row, f"{names[joint]} by hand", f"{names[joint]} alone, increasing")
    if len(record.q) == 0:
        return row("no states of these joints", FAIL, "the driver fell silent during the check")
    moves = record.q[-1] - record.q[0]  # (n,)
    most = int(np.argmax(np.ptp(record.q, axis=0)))
    found = f"{names[most]} by {moves[most]:+.2f} rad"
    if np.ptp(record.q[:, most]) < MOVED:
        return row("no joint moved", UNCHECKED, f"move it by {MOVED} rad at least")
    if most != joint:
        return row(found, FAIL, f"wrong order of joints: {names[most]} is the name of this one")
    if moves[joint] < 0.5 * MOVED:
        return row(found, FAIL, "its sign is reversed")
    return row(found, OK)


def heading(arm: Arm, q: np.ndarray, joint: int) -> str:
    """Direction of the tool when a joint increases at q (n,) [rad], for who stands before the arm.

    Args:
        arm: Model of the arm.
        q: Joint positions [rad], shape (n,).
        joint: Index of the joint.
    """
    column = arm.jacobian(q)[:, joint]
    words = (("forward", "back"), ("to its left", "to its right"), ("up", "down"))
    axis = int(np.argmax(np.abs(column[:3])))
    if abs(column[axis]) > 0.1:
        return f"the tool goes {words[axis][int(column[axis] < 0.0)]}"
    axis = int(np.argmax(np.abs(column[3:])))
    way = words[axis][int(column[3 + axis] < 0.0)]
    return f"the tool turns clockwise for one who looks {way}"


def _listed(values: np.ndarray) -> str:
    return " ".join(f"{value:.2f}" for value in values)
