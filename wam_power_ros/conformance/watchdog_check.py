# SPDX-License-Identifier: Apache-2.0
"""The test of a command path that cannot move the arm: a mark on the torque, then silence.

For a third of a second it is sent what carries it anyway, with a mark on the joint that has the
most friction, well below what friction holds. Then nothing is sent. A driver with a watchdog goes
back to its own torque, one without holds the mark for ever.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wam_power_ros.conformance.topic_checks import Row, Verdict
from wam_power_ros.control.arm import Arm

CARRY, MARK, SILENCE = 100_000_000, 200_000_000, 500_000_000  # [ns] of the arm's clock
LONGEST = 1_000_000_000  # [ns] that the mark is sent until it shows
MARK_SHARE = 0.25  # of the joint's Coulomb friction
PROMPT = 0.05  # [s] in which a driver should be back at its own torque
GIVE = 0.01  # [rad] that a joint may move before the test ends
TELLING = 3.0  # [N m] of gravity on a joint, by which one sees whether it is there once or twice


class CommandCheck:
    """One torque, or none, per state; then a row.

    Attributes:
        over: Nothing more is to be sent.
        carrier: The torque that carries the arm, as far as is known [N m]. Shape (n,).

    Args:
        arm: The model, with the joints' friction.
        joint_names: Of the driver.
        driver_compensates_gravity: As configured: then zero is what carries the arm.
        q: At rest [rad]. Shape (n,).
        tau: That the driver tells at rest, while nobody commands [N m]. Shape (n,).

    Raises:
        ValueError: The URDF tells no friction, so that no torque is known to be held by it.
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
        self._mark = MARK_SHARE * float(arm.friction[self._joint])
        if self._mark <= 0.0:
            raise ValueError("the URDF tells no friction: no torque is known not to move the arm")
        self._names = tuple(joint_names)
        self._q, self._rest = q.copy(), tau.copy()
        self._gravity = arm.gravity(q)
        self._heaviest = int(np.argmax(np.abs(self._gravity)))
        self._adds = driver_compensates_gravity
        self.carrier = np.zeros(arm.n) if self._adds else self._gravity.copy()
        self.over = self._silent = False
        self._since_ns = self._last_ns = 0
        self._shown = False
        self._row: Row | None = None

    @property
    def warning(self) -> str:
        """What a person consents to."""
        gravity = "zero, on which this driver adds g(q)" if self._adds else "g(q)"
        return (
            f"sends {gravity} for {(CARRY + MARK) * 1e-9:.1f} s, with {self._mark:.2f} N m on "
            f"{self._names[self._joint]}, a quarter of its friction, then nothing"
        )

    def step(self, stamp_ns: int, q: np.ndarray, tau: np.ndarray) -> np.ndarray | None:
        """Answer one state: stamp [ns], q (n,) [rad], tau (n,) [N m]; None sends nothing."""
        if self.over:
            return None
        self._since_ns = self._since_ns or stamp_ns
        if (trouble := self._trouble(q, tau)) is not None:
            self._row = self._say(*trouble)
            return self._leave()
        elapsed = stamp_ns - self._since_ns
        if self._silent:
            return self._listen(stamp_ns, tau)
        self._last_ns = stamp_ns
        if elapsed < CARRY:
            return self.carrier
        if elapsed < CARRY + MARK or (not self._shown and elapsed < LONGEST):
            self._shown |= tau[self._joint] - self._rest[self._joint] > 0.5 * self._mark
            torque = self.carrier.copy()
            torque[self._joint] += self._mark
            return torque
        if not self._shown:
            self._row = self._say(
                "commands do not show in the effort it tells",
                Verdict.UNCHECKED,
                "is the arm activated, its effort controller running? does it tell torques?",
            )
            return self._leave()
        self._silent = True
        return self._listen(stamp_ns, tau)

    def _listen(self, stamp_ns: int, tau: np.ndarray) -> np.ndarray | None:
        silent = (stamp_ns - self._last_ns) * 1e-9
        if abs(tau[self._joint] - self._rest[self._joint]) < 0.5 * self._mark:
            prompt = silent <= PROMPT
            self._row = self._say(
                f"back at its own torque after {1e3 * silent:.0f} ms",
                Verdict.OK if prompt else Verdict.WARN,
                "" if prompt else "a long time to be carried by an old torque",
            )
            return self._leave()
        if stamp_ns - self._last_ns > SILENCE:
            self._row = self._say(
                f"no watchdog: the last torque is still held after {silent:.1f} s",
                Verdict.FAIL,
                "the driver must go to a torque of its own when commands stay away: with a dead "
                "controller this one holds the last torque until somebody ends it",
            )
            return self._leave()
        return None

    def _trouble(self, q: np.ndarray, tau: np.ndarray) -> tuple[str, Verdict, str] | None:
        """Why the test must end now: found, verdict, advice."""
        heaviest, g = self._heaviest, self._gravity[self._heaviest]
        moved = int(np.argmax(np.abs(q - self._q)))
        if abs(g) > TELLING:
            times, rest = tau[heaviest] / g, self._rest[heaviest] / g
            if not self._adds and times > 1.5:
                self.carrier = np.zeros_like(q)
                return (
                    f"gravity twice on {self._names[heaviest]}",
                    Verdict.FAIL,
                    "the driver adds gravity itself: driver_compensates_gravity: true",
                )
            if self._adds and rest > 0.5 and times < 0.5:
                self.carrier = self._gravity.copy()
                return (
                    f"no gravity on {self._names[heaviest]} while zero was sent",
                    Verdict.FAIL,
                    "the driver does not add gravity: driver_compensates_gravity: false",
                )
        if abs(q[moved] - self._q[moved]) > GIVE:
            return (
                f"{self._names[moved]} moved by {abs(q[moved] - self._q[moved]):.3f} rad",
                Verdict.FAIL,
                "a torque that friction should have held moved it: gravity, signs or order",
            )
        return None

    def _leave(self) -> np.ndarray:
        """The last torque of the test: a driver without a watchdog may hold it."""
        self.over = True
        return self.carrier

    def _say(self, found: str, result: Verdict, advice: str = "") -> Row:
        expected = f"its own torque within {1e3 * PROMPT:.0f} ms of the last command"
        return Row("watchdog", expected, found, result, advice)

    def row(self) -> Row:
        """What came out."""
        if self._row is None:
            return self._say("states stopped coming", Verdict.UNCHECKED)
        return self._row
