# SPDX-License-Identifier: Apache-2.0
"""Watchdogs of the control loop: missing joint states, their clock, and missed periods.

They read no clock: every time is an argument, from a steady clock [ns].
"""

from dataclasses import dataclass

from wam_power_ros.control.state_checks import STATE_LOSS_TIMEOUT
from wam_power_ros.faults import Fault, FaultKind

IDLE_TIMEOUT = 0.1  # [s] without a joint state after which the driver is asked to idle
MISSED_SHARE_WARNING, MISSED_SHARE_FAULT = 0.01, 0.05  # shares of the periods of a second
MISSED_IN_ROW_WARNING = 3  # consecutive missed periods that are a warning
STAMP_WINDOW_NS = 200_000_000  # [ns] over which stamps are compared with real time
_FAULT_NS, _IDLE_NS = round(STATE_LOSS_TIMEOUT * 1e9), round(IDLE_TIMEOUT * 1e9)
_CHECK_PERIOD = 0.01  # [s] longest time between two checks while active


@dataclass(frozen=True)
class StateTimeout:
    """A torque is due although no joint state has arrived.

    Attributes:
        fault: Fault to latch, None within `STATE_LOSS_TIMEOUT`.
        idle: Whether to ask the driver to idle; True once per loss of states.
    """

    fault: Fault | None
    idle: bool


class Watchdog:
    """Detects that a torque is due although no joint state has arrived.

    Attributes:
        arrived_ns: Time at which the last joint state arrived [ns].
        sent_ns: Time at which the last torque was sent [ns].

    Args:
        timeout: Time without a joint state after which a torque is due [s]; 0 disables the
            watchdog, as in lockstep.
        period: Sampling period of the joint states [s].
    """

    def __init__(self, timeout: float, period: float) -> None:
        self.arrived_ns = self.sent_ns = 0
        self._timeout_ns, self._period_ns = round(timeout * 1e9), round(period * 1e9)
        self._checked_ns = self._grace_ns = 0  # last check; end of the grace time after a pause
        self._idle_asked = False

    @property
    def enabled(self) -> bool:
        """Whether the watchdog has a timeout."""
        return self._timeout_ns > 0

    def arrived(self, now_ns: int) -> None:
        """Register the arrival of a new joint state."""
        self.arrived_ns, self._idle_asked = now_ns, False

    def silent(self, now_ns: int) -> bool:
        """Whether no new joint state has arrived within the timeout; repeated ones do not count."""
        return self.enabled and now_ns - self.arrived_ns > self._timeout_ns

    def activated(self) -> None:
        """Register the activation of the controller; the driver may be asked to idle again."""
        self._idle_asked = False

    def time_to_check(self, now_ns: int) -> float:
        """Time until `check` must be called if no state arrives [s]."""
        wait_ns = max(self._due_ns(), self._grace_ns) - now_ns
        return min(max(wait_ns * 1e-9, 0.0), _CHECK_PERIOD)

    def check(self, now_ns: int) -> StateTimeout | None:
        """Return what is due without a joint state, None when nothing is."""
        if now_ns - self._checked_ns > _FAULT_NS:  # this process was stopped: states are queued
            self._grace_ns = now_ns + _FAULT_NS
        self._checked_ns = now_ns
        if now_ns < self._due_ns() or now_ns < self._grace_ns:
            return None
        age_ns, fault = now_ns - self.arrived_ns, None
        if age_ns > _FAULT_NS:
            fault = Fault(FaultKind.STATES_LOST, f"no joint state for {age_ns // 1_000_000} ms")
        idle = age_ns > _IDLE_NS and not self._idle_asked
        self._idle_asked |= idle
        return StateTimeout(fault, idle)

    def _due_ns(self) -> int:
        """Time at which the next torque is due without a state [ns]."""
        return max(self.arrived_ns + self._timeout_ns, self.sent_ns + self._period_ns)


class StampClock:
    """Compares the stamps of the joint states with real time."""

    def __init__(self) -> None:
        self._began: tuple[int, int] | None = None

    def check(self, stamp_ns: int, now_ns: int) -> Fault | None:
        """Check every new state: fault when the stamps do not advance like real time, else None.

        Args:
            stamp_ns: Stamp of the state [ns].
            now_ns: Time of its arrival, on a steady clock [ns].
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
    """Warning about missed periods in a second, and the fault when there are too many.

    Returns:
        Text of the warning, empty without one, and the fault, None without one.
    """
    if share_missed <= MISSED_SHARE_WARNING and missed_in_row < MISSED_IN_ROW_WARNING:
        return "", None
    text = (
        f"{100.0 * share_missed:.1f} % of the periods of a second missed, {missed_in_row} in a row"
    )
    return text, Fault(FaultKind.OVERLOAD, text) if share_missed > MISSED_SHARE_FAULT else None
