# SPDX-License-Identifier: Apache-2.0
"""Stopping rule: the mean must succeed N times in a row."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings
from wam_power_ros.tasks.task import LoggedRollout


class StoppingRule:
    """Counts the successes in a row of one mean.

    Attributes:
        z: Coordinates of the mean being confirmed, None when there is none. Shape (size,).
        count: Number of its successes in a row.
        mean_is_due: Whether the mean is run next because an exploration succeeded.

    Args:
        settings: Settings; `confirm` is the required number of successes, 0 disables the rule.
        confirms: Returns whether a success counts, see `Task.confirms`.
    """

    def __init__(
        self, settings: PracticeSettings, confirms: Callable[[LoggedRollout], bool]
    ) -> None:
        self._settings = settings
        self._confirms = confirms
        self.z: np.ndarray | None = None
        self.count = 0
        self.mean_is_due = False

    @property
    def complete(self) -> bool:
        """Whether the required number of successes is reached."""
        return 0 < self._settings.confirm == self.count

    def add(self, record: Record) -> str:
        """Count a rollout of the practice; returns a remark for the log, may be empty."""
        needed = self._settings.confirm
        if needed == 0:
            return ""
        if record.kind == "mean":
            self.mean_is_due, before = False, self.count
            if record.success and self._confirms(record):
                again = self.z is not None and record.z == self.z.tolist()
                self.z, self.count = np.array(record.z), before + 1 if again else 1
                return f"{self.count} of {needed} successes in a row"
            self.z, self.count = None, 0
            return f"ended after {before} successes in a row" if before else ""
        if record.success and self._settings.mean_every == 0:
            self.mean_is_due = True
            return "a success: the mean is run to confirm it"
        return ""

    def forget(self, record: Record) -> None:
        """Restart the count if a rollout that is no success any more was part of it."""
        if self.z is not None and record.kind == "mean" and record.z == self.z.tolist():
            self.z, self.count = None, 0
