# SPDX-License-Identifier: Apache-2.0
"""Between two rollouts: the body is put back by itself, by a movement of the arm, or by a person.

`Task.ready` says whether a rollout may begin, `Task.reset` what is to be done otherwise. A
`Resetting` follows the states of the body until it is ready, and knows who was needed for that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol

import numpy as np

READY_STATES = 3  # number of successive states in which the body must be ready
SETTLE_TIME = 3.0  # [s] for which a body may still come to rest before a person is asked for
MOVES_MAX = 20  # movements of one reset; then a person is asked for
By = Literal["none", "arm", "person"]  # who puts the body back; from the least to the most


class Move(NamedTuple):
    """Movement of the arm, from rest to rest, from the start of the policy and back to it."""

    t: np.ndarray  # (N,) [s]
    q: np.ndarray  # (N, n) [rad]


Action = Move | Literal["wait", "person"]


class BodyState(Protocol):
    """State of the tracked body in the base frame, as the tracker estimates it."""

    @property
    def stamp_ns(self) -> int:
        """Time of the state [ns]."""

    @property
    def position(self) -> np.ndarray:
        """Position of the centre [m]. Shape (3,)."""

    @property
    def velocity(self) -> np.ndarray:
        """Linear velocity [m/s]. Shape (3,)."""

    @property
    def angular_velocity(self) -> np.ndarray:
        """Angular velocity [rad/s]. Shape (3,)."""


@dataclass
class Resetting:
    """One reset, from the end of a rollout until the body is ready for the next."""

    ready: Callable[[BodyState | None], str]  # what is missing for a rollout, see `Task.ready`
    reset: Callable[[BodyState | None], Action]  # what is to be done then, see `Task.reset`
    rest_time: float = 0.0  # for which the body must have been ready [s]
    since_ns: int = 0  # time from which on states count [ns]
    missing: str = "no state of the body received"  # in the last state
    by: By = "none"  # who has been needed so far
    waits: bool = False  # whether it is expected to become ready without a person
    move: Move | None = None  # that the arm is to do now; set it to None once it is done
    _count: int = field(default=0, init=False)  # of successive states in which it was ready
    _rested_ns: int = field(default=0, init=False)  # time from the first of them to the last
    _since_ns: int = field(default=0, init=False)  # time of the first
    _asked_ns: int | None = field(default=None, init=False)  # since when a person is asked for
    _moves: int = field(default=0, init=False)

    @property
    def done(self) -> bool:
        """Whether a rollout may begin."""
        return self._count >= READY_STATES and self._rested_ns >= self.rest_time * 1e9

    def add(self, state: BodyState | None, now_ns: int) -> None:
        """Judge the next state of the body, None if it is not seen, at a time [ns]."""
        if self.move is not None or now_ns <= self.since_ns:  # a movement is under way
            return
        self.missing = self.ready(state)
        if not self.missing:
            self._since_ns = now_ns if self._count == 0 else self._since_ns
            self._rested_ns = now_ns - self._since_ns
            self._count, self._asked_ns = self._count + 1, None
            return
        self._count = 0
        action = self.reset(state) if self._moves < MOVES_MAX else "person"
        if not (isinstance(action, Move) or action in ("wait", "person")):
            raise ValueError(f"reset told {action!r}, must be a Move, 'wait' or 'person'")
        self.waits = action != "person"
        if self.waits:
            self._asked_ns = None
        elif self._asked_ns is None:
            self._asked_ns = now_ns
        elif now_ns - self._asked_ns > SETTLE_TIME * 1e9:
            self.by = "person"
        if isinstance(action, Move):
            self.move, self._moves = action, self._moves + 1
            self.by = "arm" if self.by == "none" else self.by
