# SPDX-License-Identifier: Apache-2.0
"""Jumps in recorded joint angles: unwrapped, left out, or refused, before anything uses them.

No arm moves along a jump, but a replay that is slow enough would: joint angles that a driver
reports within [-pi, pi) would take a joint through a whole turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wam_power_ros.bags.quality import ANGLE_USUAL, Grade, Remark

# A change between two states is a jump beyond JUMP plus SPEED_MAX times the interval: beyond
# 70 rad/s at 500 Hz, 45 at 250 Hz, 23 at 30 Hz. The fastest joint of a toss reaches 10 rad/s.
JUMP = 0.1  # covers the jitter of stamps [rad]
SPEED_MAX = 20.0  # of a joint [rad/s]
TURN = 2.0 * np.pi  # [rad]
LEFT_OUT_MAX = 0.01  # share of single bad states; with more of them the driver is broken [1]


@dataclass(frozen=True)
class Checked:
    """Joint angles without a jump."""

    kept: np.ndarray  # indices of the states that remain (K,)
    q: np.ndarray  # their joint angles, unwrapped [rad] (K, n)
    remarks: tuple[Remark, ...]  # what was unwrapped or left out


def checked(stamps_ns: np.ndarray, q: np.ndarray, names: Sequence[str]) -> Checked:
    """Joint angles without a jump, and without states that are not finite.

    * A step of about a whole turn is the driver's way of reporting an angle: it is unwrapped.
    * States that are not finite at the start or end are left out: the driver was not active.
    * A single state elsewhere that is not finite, or away from both its neighbours while these
      agree, is left out, and so is a first or last state away from its neighbour; of at most
      `LEFT_OUT_MAX` of the states.
    * Every other jump is refused.

    Args:
        stamps_ns: Stamps of the states, strictly increasing [ns]. Shape (M,).
        q: Joint angles [rad]. Shape (M, n).

    Raises:
        ValueError: A jump remains, more states are not finite, or too many are bad. Times in the
            message are those since the first state, as `bags import --part` counts them.
    """
    t = (stamps_ns - stamps_ns[0]) * 1e-9
    kept, remarks = _finite(t, q)
    bad = _single(t[kept], q[kept])
    singles = len(bad) + int(kept[-1] - kept[0]) + 1 - len(kept)
    if singles > max(1, LEFT_OUT_MAX * len(q)):
        raise ValueError(
            f"{singles} of {len(q)} states are not finite or away from their neighbours; at most "
            f"{LEFT_OUT_MAX:.0%} may be left out"
        )
    if len(bad):
        remarks.append(_left_out(t[kept[bad]], "away from the neighbours"))
        kept = np.delete(kept, bad)
    t, q = t[kept], q[kept]
    step, most = np.diff(q, axis=0), _most(np.diff(t))
    short = _without_turns(step, most)
    if (jumps := np.argwhere(np.abs(short) > most)).size:
        at, joint = jumps[0]
        degrees = " Are these degrees?" if np.abs(q).max() > ANGLE_USUAL else ""
        raise ValueError(
            f"{names[joint]} jumps from {q[at, joint]:.3f} to {q[at + 1, joint]:.3f} rad within "
            f"{1e3 * (t[at + 1] - t[at]):.1f} ms, {t[at + 1]:.3f} s after the first state; if a "
            f"part without the jump is enough: wam-power bags import BAG --part START END.{degrees}"
        )
    turns = np.rint((step - short) / TURN)  # (K - 1, n)
    for joint in np.flatnonzero(turns.any(axis=0)):
        when = _times(t[1:][turns[:, joint] != 0.0])
        text = f"{names[joint]} was unwrapped: reported a turn away at {when}"
        remarks.append(Remark(Grade.FAIR, text))
    unwrapped = q.copy()
    unwrapped[1:] -= TURN * np.cumsum(turns, axis=0)
    return Checked(kept, unwrapped, tuple(remarks))


def _finite(t: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, list[Remark]]:
    """Indices of the finite states, with a remark on others."""
    finite = np.isfinite(q).all(axis=1)
    kept = np.flatnonzero(finite)
    if not len(kept):
        raise ValueError(f"all {len(q)} positions are not finite; the first is {q[0].tolist()}")
    steps = np.diff(kept)
    if len(steps) and steps.max() > 2:
        at = kept[steps.argmax()] + 1
        raise ValueError(
            f"position {q[at].tolist()} is not finite, {t[at]:.3f} s after the first state, nor "
            f"are {steps.max() - 2} that follow it; if a part without them is enough: "
            "wam-power bags import BAG --part START END"
        )
    return kept, [] if finite.all() else [_left_out(t[~finite], "not finite")]


def _single(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Indices of states with a jump before and after, and none beside these. Shape (B,).

    If their neighbours disagree, a jump remains when they are left out.
    """
    step, most = np.diff(q, axis=0), _most(np.diff(t))
    jumps = (np.abs(_without_turns(step, most)) > most).any(axis=1)  # to the next state
    if len(q) < 4 or not jumps.any():
        return np.zeros(0, dtype=np.intp)
    away = np.r_[True, jumps] & np.r_[jumps, True]
    calm = ~(np.r_[False, False, jumps[:-1]] | np.r_[jumps[1:], False, False])
    return np.flatnonzero(away & calm)


def _most(dt: np.ndarray) -> np.ndarray:
    """Largest change within times [s] that is no jump [rad]. Shape (K, 1)."""
    return JUMP + SPEED_MAX * dt[:, None]


def _without_turns(step: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Steps [rad] without whole turns, where they are jumps. Shape (K, n)."""
    return np.where(np.abs(step) > most, step - TURN * np.rint(step / TURN), step)


def _left_out(t: np.ndarray, why: str) -> Remark:
    states = "1 state" if len(t) == 1 else f"{len(t)} states"
    return Remark(Grade.FAIR, f"{states} left out, {why}: at {_times(t)}")


def _times(t: np.ndarray) -> str:
    """The first of some times [s], and the number of the others."""
    more = f" and {len(t) - 3} more" if len(t) > 3 else ""
    return ", ".join(f"{when:.3f}" for when in t[:3]) + f" s{more}"
