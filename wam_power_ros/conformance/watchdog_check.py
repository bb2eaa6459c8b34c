# SPDX-License-Identifier: Apache-2.0
"""Test of the driver's watchdog that cannot move the arm: a torque offset, then no commands.

For a third of a second it sends the torque that carries the arm, with an offset well below Coulomb
friction on the joint that has most of it. Then it sends nothing. A driver with a watchdog returns
to its own torque, one without holds the offset for ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from wam_power_ros.conformance.topic_checks import FAIL, OK, UNCHECKED, WARN, Row
from wam_power_ros.control.arm import Arm

CARRY, OFFSET, SILENCE = 100_000_000, 200_000_000, 500_000_000  # [ns] phases, by the arm's clock
OFFSET_MAX = 1_000_000_000  # [ns] from the start, until which the offset must show
FRICTION_SHARE = 0.25  # offset as a share of the joint's Coulomb friction
PROMPT = 0.05  # [s] in which a driver should be back at its own torque
GIVE = 0.01  # [rad] of movement of a joint that ends the test
GRAVITY_MIN = 3.0  # [N m] gravity torque of a joint that shows whether it is compensated twice

_row = partial(Row, "watchdog", f"its own torque within {1e3 * PROMPT:.0f} ms of the last command")


class CommandCheck:
    """Test that answers each state with one torque, or none, and results in a row.

    Attributes:
        over: Whether nothing more is to be sent.
        carrier: Torque that carries the arm, as far as known [N m], shape (n,).
        row: Result.

    Args:
        arm: Model of the arm, with the friction of its joints.
        joint_names: Names that the driver gives the joints.
        driver_compensates_gravity: Configured value: if true, zero carries the arm.
        q: Positions at rest [rad], shape (n,).
        tau: Torques that the driver reports at rest without commands [N m], shape (n,).

    Raises:
        ValueError: When the URDF has no friction, so that no offset is known to be held by it.
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
            raise ValueError("the URDF has no friction: no torque is known not to move the arm")
        self._names = tuple(joint_names)
        self._q, self._rest = q.copy(), tau.copy()
        self._gravity = arm.gravity(q)
        self._heaviest = int(np.argmax(np.abs(self._gravity)))
        self._adds = driver_compensates_gravity
        self.carrier = np.zeros(arm.n) if self._adds else self._gravity.copy()
        self.over = self._silent = self._shown = False
        self._since_ns = self._last_ns = 0
        self.row = _row("states stopped coming", UNCHECKED)

    @property
    def warning(self) -> str:
        """Description of the test, for the consent of a person."""
        gravity = "zero, on which this driver adds g(q)" if self._adds else "g(q)"
        return (
            f"sends {gravity} for {(CARRY + OFFSET) * 1e-9:.1f} s, with {self._offset:.2f} N m on "
            f"{self._names[self._joint]}, a quarter of its friction, then nothing"
        )

    def step(self, stamp_ns: int, q: np.ndarray, tau: np.ndarray) -> np.ndarray | None:
        """Answer one state: stamp [ns], q (n,) [rad], tau (n,) [N m]; None sends nothing."""
        if self.over:
            return None
        self._since_ns = self._since_ns or stamp_ns
        if (failure := self._failure(q, tau)) is not None:
            return self._end(failure)
        elapsed = stamp_ns - self._since_ns
        shown = tau[self._joint] - self._rest[self._joint]
        if not self._silent:
            self._last_ns = stamp_ns
            if elapsed < CARRY:
                return self.carrier
            if elapsed < CARRY + OFFSET or (not self._shown and elapsed < OFFSET_MAX):
                self._shown |= shown > 0.5 * self._offset
                torque = self.carrier.copy()
                torque[self._joint] += self._offset
                return torque
            if not self._shown:
                advice = "is the arm activated, its effort controller running? does it report "
                text = "commands do not show in the reported effort"
                return self._end(_row(text, UNCHECKED, f"{advice}torques?"))
            self._silent = True
        silent = (stamp_ns - self._last_ns) * 1e-9  # [s]
        if abs(shown) < 0.5 * self._offset:
            late = silent > PROMPT
            result = (WARN, "a long time to be carried by an old torque") if late else (OK,)
            return self._end(_row(f"back at its own torque after {1e3 * silent:.0f} ms", *result))
        if stamp_ns - self._last_ns > SILENCE:
            text = f"no watchdog: the last torque is still held after {silent:.1f} s"
            advice = "the driver must return to its own torque when commands stay away: with a "
            advice += "dead controller this one holds the last torque until somebody ends it"
            return self._end(_row(text, FAIL, advice))
        return None

    def _failure(self, q: np.ndarray, tau: np.ndarray) -> Row | None:
        """Row that ends the test at once; sets the carrier that this state shows to be right."""
        name, g = self._names[self._heaviest], self._gravity[self._heaviest]
        if abs(g) > GRAVITY_MIN:
            times, rest = tau[self._heaviest] / g, self._rest[self._heaviest] / g
            if not self._adds and times > 1.5:
                self.carrier = np.zeros_like(q)
                advice = "the driver adds gravity itself: driver_compensates_gravity: true"
                return _row(f"gravity twice on {name}", FAIL, advice)
            if self._adds and rest > 0.5 and times < 0.5:
                self.carrier = self._gravity.copy()
                advice = "the driver does not add gravity: driver_compensates_gravity: false"
                return _row(f"no gravity on {name} while zero was sent", FAIL, advice)
        moved = int(np.argmax(np.abs(q - self._q)))
        distance = abs(q[moved] - self._q[moved])
        if distance > GIVE:
            advice = "a torque that friction should have held moved it: gravity, signs or order"
            return _row(f"{self._names[moved]} moved by {distance:.3f} rad", FAIL, advice)
        return None

    def _end(self, row: Row) -> np.ndarray:
        """End with the torque that carries the arm: a driver without a watchdog may hold it."""
        self.over, self.row = True, row
        return self.carrier
