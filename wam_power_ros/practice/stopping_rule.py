# SPDX-License-Identifier: Apache-2.0
"""Telling skill from luck: a mean that has succeeded is run again, unchanged."""

from __future__ import annotations

import numpy as np

from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import PracticeSettings


class Confirmation:
    """Successes in a row of one mean.

    Attributes:
        z: coordinates of the mean that is run again, None without. Shape (size,)
        count: its successes in a row.
        wanted: whether the mean is to be run next because an exploring rollout has succeeded.

    Args:
        settings: how many successes are asked for; 0 asks for none.
    """

    def __init__(self, settings: PracticeSettings) -> None:
        self._settings = settings
        self.z: np.ndarray | None = None
        self.count = 0
        self.wanted = False

    @property
    def complete(self) -> bool:
        """Whether there were as many as are asked for."""
        return 0 < self._settings.confirm == self.count

    def follow(self, record: Record) -> str:
        """Count a rollout of the practice; says what it means, if anything."""
        wanted = self._settings.confirm
        if wanted == 0:
            return ""
        if record.kind == "mean":
            self.wanted, before = False, self.count
            if record.success and self._has_margin(record):
                self.z, self.count = np.array(record.z), before + 1
                return f"{self.count} of {wanted} successes in a row"
            self.z, self.count = None, 0
            return f"ended after {before} successes in a row" if before else ""
        if record.success and self._settings.mean_every == 0:
            self.wanted = True
            return "a success: the mean is run to confirm it"
        return ""

    def forget(self, record: Record) -> None:
        """Begin anew if a rollout that is no success any more was one of these."""
        if self.z is not None and record.kind == "mean" and record.z == self.z.tolist():
            self.z, self.count = None, 0

    def _has_margin(self, record: Record) -> bool:
        settings = self._settings
        if settings.success_angle == 0.0 or settings.confirm_margin == 0.0:
            return True
        turned = abs((record.flight or {}).get("angle", 0.0))
        return turned >= settings.success_angle + settings.confirm_margin
