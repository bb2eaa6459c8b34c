# SPDX-License-Identifier: Apache-2.0
"""The table of false joint states: well formed, and not what the arm does."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmark.nodes import JOINTS, PERIOD_NS

N, PERIOD = len(JOINTS), PERIOD_NS * 1e-9
FALSIFIED = (1, 3, 5)  # joints 2, 4, 6
SPEEDS = {1: 4.0, 3: 6.0, 5: 6.0}  # [rad/s] of a runaway encoder


class Reading(NamedTuple):
    """One joint state."""

    stamp_ns: int
    q: np.ndarray
    qd: np.ndarray


Falsifier = Callable[[Reading], Reading | None]  # None: nothing is published


def from_past(report: Callable[[list[Reading]], Reading | None]) -> Falsifier:
    """Report what a function makes of all true states so far, of which the last is the present."""
    past: list[Reading] = []

    def falsify(state: Reading) -> Reading | None:
        past.append(state)
        return report(past)

    return falsify


def frozen(*joints: int, still: bool = False) -> Falsifier:
    """Freeze position and velocity of joints, of all if none is given; `still`: velocity zero."""
    at = list(joints) or list(range(N))

    def report(past: list[Reading]) -> Reading:
        q, qd = past[-1].q.copy(), past[-1].qd.copy()
        q[at], qd[at] = past[0].q[at], 0.0 if still else past[0].qd[at]
        return Reading(past[-1].stamp_ns, q, qd)

    return from_past(report)


def stamps(rate: float) -> Falsifier:
    """Let stamps advance at another rate; at rate 0 repeat the first state."""

    def report(past: list[Reading]) -> Reading:
        first, state = past[0], past[-1]
        late = round(rate * (state.stamp_ns - first.stamp_ns))
        return state._replace(stamp_ns=first.stamp_ns + late) if rate else first

    return from_past(report)


def moved(state: Reading, joint: int, offset: float, speed: float = 0.0) -> Reading:
    """State with an offset [rad] and a speed [rad/s] added at a joint."""
    at = np.eye(N)[joint]
    return Reading(state.stamp_ns, state.q + offset * at, state.qd + speed * at)


def added(joint: int, course: Callable[[float], float]) -> Falsifier:
    """Add to a joint a speed [rad/s] over time [s], and its integral to the position."""
    way = [0.0]

    def report(past: list[Reading]) -> Reading:
        speed = course((past[-1].stamp_ns - past[0].stamp_ns) * 1e-9)
        way[0] += PERIOD * speed
        return moved(past[-1], joint, way[0], speed)

    return from_past(report)


def mixed(joint: int, seconds: float) -> Falsifier:
    """Exchange a joint and the next but one, at once or within a time [s]."""
    other = FALSIFIED[(FALSIFIED.index(joint) + 1) % 3]

    def report(past: list[Reading]) -> Reading:
        state = past[-1]
        t = (state.stamp_ns - past[0].stamp_ns) * 1e-9
        s = 1.0 if not seconds else min(t / seconds, 1.0)
        share, rate = s * s * (3.0 - 2.0 * s), 0.0 if s >= 1.0 else 6.0 * s * (1.0 - s) / seconds
        q, qd = state.q.copy(), state.qd.copy()
        for i, k in ((joint, other), (other, joint)):
            gap = state.q[k] - state.q[i]
            q[i] = state.q[i] + share * gap
            qd[i] = state.qd[i] + share * (state.qd[k] - state.qd[i]) + rate * gap
        return Reading(state.stamp_ns, q, qd)

    return from_past(report)


def mirrored(joint: int) -> Falsifier:
    """Let a joint report its motion with the other sign, from where it was."""

    def report(past: list[Reading]) -> Reading:
        away = past[0].q[joint] - past[-1].q[joint]
        return moved(past[-1], joint, 2.0 * away, -2.0 * past[-1].qd[joint])

    return from_past(report)


def quantised(joint: int) -> Falsifier:
    """The resolution of a joint becomes 0.01 rad."""
    at = np.arange(N) == joint
    return lambda state: state._replace(q=np.where(at, np.round(state.q / 0.01) * 0.01, state.q))


# Of one joint, and below of no joint in particular.
OF_JOINT: dict[str, Callable[[int], Falsifier]] = {
    "constant": lambda j: lambda s: moved(s, j, 0.06),
    "runaway step": lambda j: added(j, lambda t: SPEEDS[j] * (t < 0.3)),
    "smooth bump": lambda j: added(
        j, lambda t: SPEEDS[j] * np.sin(np.pi * t / 0.4) ** 2 * (t < 0.4)
    ),
    "smooth runaway": lambda j: added(
        j, lambda t: SPEEDS[j] * np.sin(0.5 * np.pi * min(t / 0.4, 1.0)) ** 2
    ),
    "drift +0.1": lambda j: added(j, lambda t: 0.1),
    "drift -0.1": lambda j: added(j, lambda t: -0.1),
    "drift +0.3": lambda j: added(j, lambda t: 0.3),
    "soft drift +0.3": lambda j: added(j, lambda t: 0.3 * min(t / 0.1, 1.0)),
    "soft drift -0.3": lambda j: added(j, lambda t: -0.3 * min(t / 0.1, 1.0)),
    "freeze": frozen,
    "swap": lambda j: mixed(j, 0.0),
    "gradual swap": lambda j: mixed(j, 0.5),
    "sign": mirrored,
    "spike": lambda j: from_past(lambda past: moved(past[-1], j, 0.05 * (len(past) % 20 == 1))),
    "quantised": quantised,
    # Each state five times, under stamps of its own; states 20 ms old; a second publisher that
    # repeats each state 6 ms later, so that stamps go back again and again.
    "repeated": lambda _: from_past(
        lambda past: past[(len(past) - 1) // 5 * 5]._replace(stamp_ns=past[-1].stamp_ns)
    ),
    "late": lambda _: from_past(lambda past: past[-11:][0]._replace(stamp_ns=past[-1].stamp_ns)),
    "relay": lambda _: from_past(lambda past: past[-1] if len(past) % 2 else past[-4:][0]),
}
NO_JOINT = ("repeated", "late", "relay")
FALSE_STATES: dict[str, Callable[[], Falsifier]] = {
    "silence": lambda: lambda state: None,
    "the same state again and again": lambda: stamps(0.0),
    "stamps at a tenth of the speed": lambda: stamps(0.1),
    "frozen": frozen,
    "frozen, velocities zero": lambda: frozen(still=True),
    "joint 2 frozen": lambda: frozen(1),
    "joint 4 frozen, its velocity zero": lambda: frozen(3, still=True),
    "velocities zero": lambda: lambda state: state._replace(qd=np.zeros(N)),
    "velocities negated": lambda: lambda state: state._replace(qd=-state.qd),
    "velocities doubled": lambda: lambda state: state._replace(qd=2.0 * state.qd),
    "velocities permuted": lambda: lambda state: state._replace(qd=np.roll(state.qd, 1)),
    # Every other state is that of an arm 0.02 rad away.
    "two drivers": lambda: from_past(lambda p: p[-1]._replace(q=p[-1].q + 0.02 * (len(p) % 2))),
}
