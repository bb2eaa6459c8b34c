# SPDX-License-Identifier: Apache-2.0
"""Watchdog of the control loop: joint states that stay away, and periods that are missed.

It reads no clock: every time is handed in, of a steady clock [ns].
"""

from dataclasses import dataclass

from wam_power_ros.control.state_checks import STATES_LOST_AFTER
from wam_power_ros.learning.rollout import Fault, FaultKind

IDLE_AFTER = 0.1  # [s] without a joint state: the driver is asked to idle
MISSED_WARNING, MISSED_FAULT = 0.01, 0.05  # share of the periods of a second
MISSED_IN_ROW = 3  # periods
STAMP_WINDOW_NS = 200_000_000  # [ns] over which stamps are compared with real time
_FAULT_NS, _IDLE_NS = round(STATES_LOST_AFTER * 1e9), round(IDLE_AFTER * 1e9)
_CHECK_PERIOD = 0.01  # [s] at most between two checks while active


@dataclass(frozen=True)
class Silence:
    """A torque is due although no joint state has come.

    Attributes:
        fault: Fault to latch, None while the silence is short.
        idle: Whether the driver is to be asked to idle; once a silence.
    """

    fault: Fault | None
    idle: bool


class Watchdog:
    """Finds out when a torque is due although no joint state has come.

    Attributes:
        arrived_ns: When the last joint state came.
        sent_ns: When the last torque was sent.

    Args:
        timeout: Time without a joint state after which a torque is due [s]; 0 for never, as in
            lockstep.
        period: Sampling period of the joint states [s].
    """

    def __init__(self, timeout: float, period: float) -> None:
        self.arrived_ns = self.sent_ns = 0
        self._timeout_ns, self._period_ns = round(timeout * 1e9), round(period * 1e9)
        self._checked_ns = self._excused_ns = 0
        self._idle_asked = False

    @property
    def enabled(self) -> bool:
        """Whether it watches at all."""
        return self._timeout_ns > 0

    def arrived(self, now_ns: int) -> None:
        """A joint state has come."""
        self.arrived_ns, self._idle_asked = now_ns, False

    def silent(self, now_ns: int) -> bool:
        """Whether no new joint state has come for the timeout; an old one again does not count."""
        return self.enabled and now_ns - self.arrived_ns > self._timeout_ns

    def activated(self) -> None:
        """The arm is held from now on; the driver may be asked to idle again."""
        self._idle_asked = False

    def patience(self, now_ns: int) -> float:
        """Time for which `check` need not be called if no state comes [s]."""
        wait_ns = max(self._due_ns(), self._excused_ns) - now_ns
        return min(max(wait_ns * 1e-9, 0.0), _CHECK_PERIOD)

    def check(self, now_ns: int) -> Silence | None:
        """What to do about the joint states' silence; None when nothing is due."""
        if now_ns - self._checked_ns > _FAULT_NS:  # it was us who stood still: states wait for us
            self._excused_ns = now_ns + _FAULT_NS
        self._checked_ns = now_ns
        if now_ns < self._due_ns() or now_ns < self._excused_ns:
            return None
        age_ns, fault = now_ns - self.arrived_ns, None
        if age_ns > _FAULT_NS:
            fault = Fault(FaultKind.STATES_LOST, f"no joint state for {age_ns // 1_000_000} ms")
        idle = age_ns > _IDLE_NS and not self._idle_asked
        self._idle_asked |= idle
        return Silence(fault, idle)

    def _due_ns(self) -> int:
        """When the next torque is due without a state."""
        return max(self.arrived_ns + self._timeout_ns, self.sent_ns + self._period_ns)


class StampClock:
    """Compares the stamps of the joint states with real time."""

    def __init__(self) -> None:
        self._began: tuple[int, int] | None = None

    def check(self, stamp_ns: int, now_ns: int) -> Fault | None:
        """Fault when the stamps have not advanced as real time has; for every new state.

        Args:
            stamp_ns: Stamp of the state [ns].
            now_ns: Time at which it came, on a steady clock [ns].
        """
        stamp0_ns, began_ns = self._began or (stamp_ns, now_ns)
        real_ns = now_ns - began_ns
        if self._began is None or real_ns >= STAMP_WINDOW_NS:
            self._began = stamp_ns, now_ns
        if real_ns < STAMP_WINDOW_NS or 0.5 < (stamp_ns - stamp0_ns) / real_ns < 1.5:
            return None
        advanced, real = (stamp_ns - stamp0_ns) * 1e-9, real_ns * 1e-9
        return Fault(FaultKind.STAMPS, f"stamps advanced by {advanced:.3f} s in {real:.3f} s")


def overload(share_missed: float, missed_in_row: int) -> tuple[str, Fault | None]:
    """Warning about the missed periods of a second, and the fault when they are too many.

    Args:
        share_missed: Share of the periods that were missed.
        missed_in_row: Largest number of periods missed in a row.

    Returns:
        Text, empty when few were missed, and the fault, None without.
    """
    if share_missed <= MISSED_WARNING and missed_in_row < MISSED_IN_ROW:
        return "", None
    text = (
        f"{100.0 * share_missed:.1f} % of the periods of a second missed, {missed_in_row} in a row"
    )
    return text, Fault(FaultKind.OVERLOAD, text) if share_missed > MISSED_FAULT else None
