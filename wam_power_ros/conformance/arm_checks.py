# SPDX-License-Identifier: Apache-2.0
"""Rows about the arm's driver: joints, units, velocities, gravity, order and signs.

The arm's model says what a still arm must report: a driver that tells its torques tells by them
whether its joints are in order, its signs right and its zero where the model has it.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from wam_power_ros.conformance.topic_checks import Row, Verdict
from wam_power_ros.control.arm import Arm

STILL = 0.02  # [rad] a joint may wander while the arm is still
MOVED = 0.1  # [rad] that a person moves a joint at least
AT_REST = 0.1  # [rad/s] that a velocity may be at rest
BEYOND = 0.05  # [rad] beyond its limit that a joint may be: zeros are set by hand
GRAVITY_SHARE = 0.15  # by which drivers' own models of gravity differ from ours
GRAVITY_FLOOR = 0.15  # [N m] as well
TELLING = 3.0  # [N m] of gravity on some joint, without which nothing can be told
PERMUTED_AT_MOST = 8  # joints, of which every order is tried: 40 320


class StateSample(NamedTuple):
    """One joint state as it came; arrays as long as they were."""

    received_ns: int
    stamp_ns: int
    names: tuple[str, ...]
    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray


@dataclass(frozen=True)
class ArmRecord:
    """What was heard of our joints, in their order.

    Attributes:
        joint_names: Of the driver.
        received_ns: Shape (m,).
        stamp_ns: Shape (m,).
        q: [rad], if units are right. Shape (m, n).
        qd: Shape (m, n); None when a message had none.
        tau: Shape (m, n); None when a message had none.
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
    """Our joints out of all that came on the topic, and the row about their names.

    Args:
        samples: Of the topic, in order of arrival.
        joint_names: Of the driver, base to tip.
    """
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
    row = _names(joint_names, whole, wrong, list(others))
    places = {
        names: [names.index(name) for name in joint_names]
        for names in {item.names for item in whole}
    }

    def values(field: str) -> np.ndarray | None:
        rows = [getattr(item, field)[places[item.names]] for item in whole if _has(item, field)]
        return np.array(rows) if rows and len(rows) == len(whole) else None

    q = values("q")
    record = ArmRecord(
        tuple(joint_names),
        np.array([item.received_ns for item in whole], dtype=np.int64),
        np.array([item.stamp_ns for item in whole], dtype=np.int64),
        np.empty((0, len(joint_names))) if q is None else q,
        values("qd"),
        values("tau"),
    )
    return record, row


def with_velocity(record: ArmRecord, received_ns: np.ndarray, qd: np.ndarray) -> ArmRecord:
    """The record with velocities of a topic of their own, each state with the last before it.

    Args:
        record: Of the states.
        received_ns: When the velocities came. Shape (k,).
        qd: Shape (k, n).
    """
    if len(received_ns) == 0 or len(record.q) == 0:
        return replace(record, qd=None)
    last = np.searchsorted(received_ns, record.received_ns, side="right") - 1
    return replace(record, qd=qd[np.maximum(last, 0)])


def _has(sample: StateSample, field: str) -> bool:
    return len(getattr(sample, field)) == len(sample.names)


def _names(
    joint_names: Sequence[str], whole: list[StateSample], wrong: Counter[str], others: list[str]
) -> Row:
    expected = " ".join(joint_names)
    beside = f"; also heard: {' '.join(others)}" if others else ""
    if wrong:
        text = ", ".join(f"{count} messages {what}" for what, count in wrong.items())
        advice = "each state must hold every joint of the arm once, with its position"
        return Row("joint names", expected, text + beside, Verdict.FAIL, advice)
    if not whole:
        text = " ".join(others) or "no names at all"
        advice = "set joint_names of the configuration to what the driver calls them"
        return Row("joint names", expected, text, Verdict.FAIL, advice)
    order = whole[0].names == tuple(joint_names)
    text = "as expected" if order else "in another order, matched by name"
    return Row("joint names", expected, f"{text}{beside}", Verdict.OK)


def positions(record: ArmRecord, arm: Arm) -> Row:
    """Whether positions are radians within the joints' limits."""
    expected = "rad, within the limits of the URDF"
    q = record.q
    if len(q) == 0:
        return Row("positions", expected, "none", Verdict.UNCHECKED)
    text = f"{_listed(q[-1])} rad" + ("" if record.still else ", moving")
    low, high = arm.q_min - BEYOND, arm.q_max + BEYOND
    inside = ((q >= low) & (q <= high)).all(axis=0)
    if inside.all():
        return Row("positions", expected, text, Verdict.OK)
    radians = np.deg2rad(q)
    if np.abs(q).max() > 7.0 and ((radians >= low) & (radians <= high)).all():
        text = _listed(q[-1])
        return Row("positions", expected, text, Verdict.FAIL, "these are degrees: send radians")
    outside = [record.joint_names[i] for i in np.flatnonzero(~inside)]
    advice = f"{', '.join(outside)} beyond its limit: wrong zero, sign, order or URDF"
    return Row("positions", expected, text, Verdict.FAIL, advice)


def velocity(record: ArmRecord, topic: str = "") -> Row:
    """Whether velocities come, and agree with how the positions change.

    Args:
        record: With the velocities of the topic, if they have one of their own.
        topic: Of the velocities, "" when the states are to have them.
    """
    expected = f"rad/s on {topic}" if topic else "rad/s in every state"
    qd, q = record.qd, record.q
    advice = "set velocity_topic if the driver has one; the controller can differentiate by itself"
    if qd is None or not len(q):
        return Row("velocity", expected, "no velocity", Verdict.FAIL, advice)
    if np.isnan(qd).any():
        return Row("velocity", expected, "NaN: no velocity", Verdict.FAIL, advice)
    if not np.isfinite(qd).all():
        return Row("velocity", expected, "not finite", Verdict.FAIL, "a driver must not send that")
    worst = float(np.abs(qd).max())
    if record.still:
        if worst < AT_REST:
            text = f"at most {worst:.3f} rad/s, at rest; not compared in motion"
            return Row("velocity", expected, text, Verdict.OK)
        advice = "the arm is still: other units, other joints or another quantity"
        return Row("velocity", expected, f"up to {worst:.2f} at rest", Verdict.FAIL, advice)
    slopes = _slopes(record)
    text = "against positions: " + ", ".join(
        f"{record.joint_names[i]} x {slope:.2f}" for i, slope in slopes.items()
    )
    wrong = [slope for slope in slopes.values() if abs(slope - 1.0) > 0.3]
    if not wrong:
        return Row("velocity", expected, text, Verdict.OK)
    advice = "they are not the derivative of the positions: other joints, units or signs"
    if all(abs(slope * math.pi / 180.0 - 1.0) < 0.3 for slope in slopes.values()):
        advice = "these are degrees a second: send rad/s"
    elif all(abs(slope + 1.0) < 0.3 for slope in wrong):
        advice = "their sign is reversed"
    return Row("velocity", expected, text, Verdict.FAIL, advice)


def _slopes(record: ArmRecord, window: float = 0.05) -> dict[int, float]:
    """Velocity over derivative of the position, for joints that moved; 1 where they agree."""
    t = (record.stamp_ns - record.stamp_ns[0]) * 1e-9
    step = max(1, int(np.searchsorted(t, window)))
    dq = record.q[step:] - record.q[:-step]  # (k, n)
    dt = np.maximum(t[step:] - t[:-step], 1e-9)
    sums = np.cumsum(np.vstack([np.zeros(record.q.shape[1]), record.qd]), axis=0)
    mean = (sums[step + 1 :] - sums[1:-step]) / step  # (k, n) over the same spans
    rate = dq / dt[:, None]
    moved = np.flatnonzero(np.ptp(record.q, axis=0) >= STILL)
    return {int(i): float((rate[:, i] @ mean[:, i]) / (rate[:, i] @ rate[:, i])) for i in moved}


def effort(record: ArmRecord) -> Row:
    """Whether torques come."""
    expected = "N m in every state"
    if record.tau is None or not np.isfinite(record.tau).all():
        advice = "without it neither gravity, order nor watchdog can be checked at rest"
        return Row("effort", expected, "no effort", Verdict.WARN, advice)
    return Row("effort", expected, f"{_listed(record.tau.mean(axis=0))} N m", Verdict.OK)


def gravity(record: ArmRecord, arm: Arm) -> Row:
    """Whether a still arm reports the torques that carry it; if not, which mistake fits.

    Drivers of torque-controlled arms report what they command, gravity included, or measure it.
    """
    expected = "effort of a still arm is g(q): order, signs, zero and payload as in the URDF"

    def row(found: str, result: Verdict, advice: str = "") -> Row:
        return Row("gravity", expected, found, result, advice)

    if record.tau is None or not np.isfinite(record.tau).all() or not len(record.q):
        return row("no effort", Verdict.UNCHECKED, "move each joint when asked instead")
    if not record.still:
        return row("the arm moves", Verdict.UNCHECKED, "let it rest")
    q, tau = record.q.mean(axis=0), record.tau.mean(axis=0)
    g = arm.gravity(q)
    text = f"{_listed(tau)} N m, g(q) {_listed(g)} N m"
    mistake = _mistake(q, tau, arm, record.joint_names)
    if mistake is None and np.abs(g).max() < TELLING:
        return row(text, Verdict.UNCHECKED, "lean the arm out, so that gravity pulls at it")
    if mistake is None:
        alike = _alike(q, tau, arm, record.joint_names)
        advice = f"cannot tell {', '.join(alike)} from each other: move each by hand"
        return row(text, Verdict.OK, advice if alike else "")
    if np.abs(tau).max() < GRAVITY_FLOOR:
        advice = "the driver is idle or tells torques without gravity; move each joint when asked"
        return row(text, Verdict.UNCHECKED, advice)
    return row(text, Verdict.FAIL, mistake)


def _mistake(q: np.ndarray, tau: np.ndarray, arm: Arm, names: Sequence[str]) -> str | None:
    """What a driver has wrong that says these positions and torques, None when nothing."""
    fits = _Fit(q, tau, arm)
    if fits(q, tau):
        return None
    if fits(q, -tau):
        return "torques have the sign reversed"
    for order in _orders(arm.n):
        if fits(q[order], tau[order], sharp=True):
            wrong = [names[i] for i in range(arm.n) if order[i] != i]
            heard = [names[order[i]] for i in range(arm.n) if order[i] != i]
            return f"wrong order of joints: {', '.join(wrong)} fit what comes as {', '.join(heard)}"
    for joints in _subsets(arm.n):
        signs = np.ones(arm.n)
        signs[list(joints)] = -1.0
        if fits(signs * q, signs * tau, sharp=True):
            return f"sign reversed: {', '.join(names[i] for i in joints)}"
    joint = names[int(np.argmax(fits.errors(q, tau)))]
    return f"wrong zero, payload, mounting or URDF; {joint} is the farthest off"


def _alike(q: np.ndarray, tau: np.ndarray, arm: Arm, names: Sequence[str]) -> list[str]:
    """Joints that could be exchanged with another one at this posture, and nobody would notice."""
    fits = _Fit(q, tau, arm)
    alike = set()
    for i, j in itertools.combinations(range(arm.n), 2):
        order = list(range(arm.n))
        order[i], order[j] = j, i
        if fits(q[order], tau[order]):
            alike |= {i, j}
    return [names[i] for i in sorted(alike)]


class _Fit:
    """Whether positions and torques can be those of the still arm."""

    def __init__(self, q: np.ndarray, tau: np.ndarray, arm: Arm) -> None:
        self._arm = arm
        self._sharp = 0.3 * float(self.errors(q, tau).max())  # another reading must be far better

    def errors(self, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Of each joint, in what is tolerated (n,)."""
        g = self._arm.gravity(q)
        return np.abs(tau - g) / (GRAVITY_FLOOR + GRAVITY_SHARE * np.abs(g))

    def __call__(self, q: np.ndarray, tau: np.ndarray, sharp: bool = False) -> bool:
        if sharp and not ((q >= self._arm.q_min - BEYOND) & (q <= self._arm.q_max + BEYOND)).all():
            return False
        return bool(self.errors(q, tau).max() <= (min(1.0, self._sharp) if sharp else 1.0))


def _orders(n: int) -> Iterable[list[int]]:
    """Every order of n joints but the right one, the fewest exchanged first."""
    if n > PERMUTED_AT_MOST:
        return []
    others = (list(order) for order in itertools.permutations(range(n)))
    ranked = sorted(others, key=lambda order: sum(i != place for i, place in enumerate(order)))
    return ranked[1:]


def _subsets(n: int) -> Iterable[tuple[int, ...]]:
    for size in range(1, n + 1):
        yield from itertools.combinations(range(n), size)


def led(record: ArmRecord, joint: int) -> Row:
    """Whether the joint that a person was asked to move is the one that moved, the way asked.

    Args:
        record: While it was moved.
        joint: Its index.
    """
    name = f"{record.joint_names[joint]} by hand"
    expected = f"{record.joint_names[joint]} alone, increasing"
    if len(record.q) == 0:
        return Row(name, expected, "nothing was heard", Verdict.UNCHECKED)
    moves = record.q[-1] - record.q[0]  # (n,)
    most = int(np.argmax(np.ptp(record.q, axis=0)))
    found = f"{record.joint_names[most]} by {moves[most]:+.2f} rad"
    if np.ptp(record.q[:, most]) < MOVED:
        advice = f"move it by {MOVED} rad at least"
        return Row(name, expected, "no joint moved", Verdict.UNCHECKED, advice)
    if most != joint:
        advice = f"wrong order of joints: what comes as {record.joint_names[most]} is this one"
        return Row(name, expected, found, Verdict.FAIL, advice)
    if moves[joint] < 0.5 * MOVED:
        return Row(name, expected, found, Verdict.FAIL, "its sign is reversed")
    return Row(name, expected, found, Verdict.OK)


def heading(arm: Arm, q: np.ndarray, joint: int) -> str:
    """Which way the tool goes when a joint increases, in words for whoever stands before the arm.

    Args:
        arm: The model.
        q: Where it is [rad]. Shape (n,).
        joint: Its index.
    """
    column = arm.jacobian(q)[:, joint]
    words = (("forward", "back"), ("to its left", "to its right"), ("up", "down"))
    axis = int(np.argmax(np.abs(column[:3])))
    if abs(column[axis]) > 0.1:
        return f"the tool goes {words[axis][int(column[axis] < 0.0)]}"
    turn = column[3:]
    axis = int(np.argmax(np.abs(turn)))
    way = words[axis][int(turn[axis] < 0.0)]
    return f"the tool turns clockwise for one who looks {way}"


def _listed(values: np.ndarray) -> str:
    return " ".join(f"{value:.2f}" for value in values)
