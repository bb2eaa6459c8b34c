# SPDX-License-Identifier: Apache-2.0
"""Test of the driver's watchdog that cannot move the arm: a torque offset, then no commands.

The test sends the torque that carries the arm: 0.1 s alone, then 0.2 s, or until the driver reports
it (1 s after the start at the latest), with an offset well below Coulomb friction on the joint with
the most friction. Then it sends nothing. A driver with a watchdog returns to its own torque; one
without holds the offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from wam_power_ros.conformance.topic_checks import FAIL, OK, UNCHECKED, WARN, Row
from wam_power_ros.control.arm import Arm

CARRY_NS, OFFSET_NS, SILENCE_NS = 100_000_000, 200_000_000, 500_000_000  # phases, by stamps
HELD_STATES_MIN = 100  # before a torque counts as held: an overloaded driver skips time, not states
OFFSET_END_NS = 1_000_000_000  # from the start, until which the driver must report the offset
FRICTION_SHARE = 0.25  # offset as a share of the joint's Coulomb friction
WATCHDOG_TIMEOUT = 0.05  # [s] in which a driver should return to its own torque
MOTION_MAX = 0.01  # [rad] larger motion of a joint ends the test
GRAVITY_MIN = 3.0  # [N m] gravity torque of a joint that shows whether it is compensated twice

_row = partial(
    Row, "watchdog", f"its own torque within {1e3 * WATCHDOG_TIMEOUT:.0f} ms of the last command"
)


class CommandCheck:
    """Answers each state with one torque or none, and results in a row.

    Attributes:
        carrying_torque: Torque that carries the arm, as far as known [N m], shape (n,).

    Args:
        driver_compensates_gravity: Configured value: if true, a torque of zero carries the arm.
        q: Positions at rest [rad], shape (n,).
        tau: Torques that the driver reports at rest without commands [N m], shape (n,).

    Raises:
        ValueError: The URDF has no friction, so no offset is known to be too small to move the arm.
    """

    def __init__(
        self,
        arm: Arm,
        joint_names: Sequence[str],
        driver_compensates_gravity: bool,
        q: np.ndarray,
        tau: np.ndarray,
    ) -> None:
        self._joint = int(np.argmax(arm.friction))
        self._offset = FRICTION_SHARE * float(arm.friction[self._joint])
        if self._offset <= 0.0:
            raise ValueError("the URDF has no friction: any torque offset could move the arm")
        self._names = tuple(joint_names)
        self._q, self._rest = q.copy(), tau.copy()
        self._gravity = arm.gravity(q)
        self._loaded = int(np.argmax(np.abs(self._gravity)))  # joint with the most gravity torque
        self._driver_adds_gravity = driver_compensates_gravity
        self.carrying_torque = (
            np.zeros(arm.n) if driver_compensates_gravity else self._gravity.copy()
        )
        self.finished = self._silent = self._reported = False
        self._silent_states = 0  # since the last command
        self._start_ns = self._last_ns = 0  # stamps of the first state and of the last command
        self.row = _row("states stopped arriving", UNCHECKED)

    @property
    def warning(self) -> str:
        """Description of the test, for a person's consent."""
        gravity = "zero, to which this driver adds g(q)" if self._driver_adds_gravity else "g(q)"
        return (
            f"sends {gravity} for {(CARRY_NS + OFFSET_NS) * 1e-9:.1f} s, with {self._offset:.2f} "
            f"N m on {self._names[self._joint]}, a quarter of its friction, then nothing"
        )

    def step(self, stamp_ns: int, q: np.ndarray, tau: np.ndarray) -> np.ndarray | None:
        """Torque for a state: stamp [ns], q (n,) [rad], tau (n,) [N m]; None sends nothing."""
        if self.finished:
            return None
        self._start_ns = self._start_ns or stamp_ns
        if (failure := self._failure(q, tau)) is not None:
            return self._end(failure)
        elapsed_ns = stamp_ns - self._start_ns
        offset = tau[self._joint] - self._rest[self._joint]  # as the driver reports it
        if not self._silent:
            self._last_ns = stamp_ns
            if elapsed_ns < CARRY_NS:
                return self.carrying_torque
            wait = not self._reported and elapsed_ns < OFFSET_END_NS
            if elapsed_ns < CARRY_NS + OFFSET_NS or wait:
                self._reported |= offset > 0.5 * self._offset
                torque = self.carrying_torque.copy()
                torque[self._joint] += self._offset
                return torque
            if not self._reported:
                shown = int(np.argmax(tau - self._rest))
                if tau[shown] - self._rest[shown] > 0.5 * self._offset:
                    sent, found = self._names[self._joint], self._names[shown]
                    advice = "wrong order of torques: the order of the driver must be joint_names"
                    return self._end(_row(f"sent to {sent}, reported of {found}", FAIL, advice))
                advice = "is the arm activated, its effort controller running? does it report "
                text = "commands do not show in the reported effort"
                return self._end(_row(text, UNCHECKED, f"{advice}torques?"))
            self._silent = True
        silence = (stamp_ns - self._last_ns) * 1e-9  # [s]
        self._silent_states += 1
        if abs(offset) < 0.5 * self._offset:
            late = silence > WATCHDOG_TIMEOUT
            result = (WARN, "the last torque acts for a long time") if late else (OK,)
            return self._end(_row(f"back at its own torque after {1e3 * silence:.0f} ms", *result))
        if stamp_ns - self._last_ns > SILENCE_NS and self._silent_states > HELD_STATES_MIN:
            text = f"no watchdog: the last torque is still held after {silence:.1f} s"
            advice = "the driver must return to its own torque when commands stop: if the "
            advice += "controller dies, this one holds the last torque until somebody stops it"
            return self._end(_row(text, FAIL, advice))
        return None

    def _failure(self, q: np.ndarray, tau: np.ndarray) -> Row | None:
        """Row that ends the test at once, or None; corrects a wrong `carrying_torque`."""
        name, g = self._names[self._loaded], self._gravity[self._loaded]
        if abs(g) > GRAVITY_MIN:
            share, share_at_rest = tau[self._loaded] / g, self._rest[self._loaded] / g
            if not self._driver_adds_gravity and share > 1.5:
                self.carrying_torque = np.zeros_like(q)
                advice = "the driver adds gravity itself: driver_compensates_gravity: true"
                return _row(f"gravity twice on {name}", FAIL, advice)
            if self._driver_adds_gravity and share_at_rest > 0.5 and share < 0.5:
                self.carrying_torque = self._gravity.copy()
                advice = "the driver does not add gravity: driver_compensates_gravity: false"
                return _row(f"no gravity on {name} while zero was sent", FAIL, advice)
        moved = int(np.argmax(np.abs(q - self._q)))
        distance = abs(q[moved] - self._q[moved])
        if distance > MOTION_MAX:
            advice = "a torque that friction should have held moved it: gravity, signs or order"
            return _row(f"{self._names[moved]} moved by {distance:.3f} rad", FAIL, advice)
        return None

    def _end(self, row: Row) -> np.ndarray:
        """End the test with the torque that carries the arm, as the driver may hold it."""
        self.finished, self.row = True, row
        return self.carrying_torque
