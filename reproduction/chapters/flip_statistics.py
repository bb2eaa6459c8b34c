# SPDX-License-Identifier: Apache-2.0
"""Statistics of pancake sessions under one condition, and cells of their tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reproduction import figures as study_figures
from wam_power_ros.reporting.terminal import counted

Row = Mapping[str, Any]  # a rollout in a result of the study
RELIABLE = 0.9  # share of the re-tests of a final policy


@dataclass(frozen=True)
class Sessions:
    """Sessions under one condition: results of `flip_sessions.session` and their statistics."""

    runs: Sequence[Mapping[str, Any]]

    def __len__(self) -> int:
        return len(self.runs)

    @property
    def retests(self) -> list[Row]:
        """Re-tests of all sessions."""
        return [row for run in self.runs for row in run["retests"]]

    @property
    def used(self) -> np.ndarray:
        """Number of rollouts used by each session. Shape (n,)."""
        return np.array([run["used"] for run in self.runs])

    @property
    def landed(self) -> np.ndarray:
        """Share of each session's re-tests that landed. Shape (n,)."""
        return np.array([share(run["retests"], "landed") for run in self.runs])

    @property
    def true_flips(self) -> np.ndarray:
        """Share of each session's re-tests that were true flips. Shape (n,)."""
        return np.array([share(run["retests"], "true_flip") for run in self.runs])

    @property
    def reproduced(self) -> int:
        """Number of sessions in which the chosen reproduction was a true flip.

        A session learns from the reproduction of highest return.
        """
        count = 0
        for run in self.runs:
            first = [trial for trial in run["trials"] if trial["kind"] == "reproduction"]
            best = max(first, key=lambda trial: trial["ret"] or 0.0, default=None)
            count += best is not None and bool(best["true_flip"])
        return count

    @property
    def curves(self) -> list[list[float]]:
        """Returns of the rollouts of each session, without those that have none."""
        return [[ret for ret in run["curve"] if ret is not None] for run in self.runs]

    @property
    def gain(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean return of the first and of the last five rollouts of each session. Shapes (n,)."""
        return study_figures.first_and_last_five(self.curves)

    def means(self, name: str, form: str) -> list[str]:
        """Cells: quantiles over sessions of the mean of a quantity over the re-tests, if any."""
        tested = [run["retests"] for run in self.runs if run["retests"]]
        return quantile_cells(np.array([values(rows, name).mean() for rows in tested]), form)

    def stiffness(self, which: str) -> np.ndarray:
        """K33 profile of each policy, "learnt" or "demonstrated". Shape (<= n, T)."""
        return np.array([run["k33"][which] for run in self.runs if run["k33"]])

    def reliable(self, shares: np.ndarray) -> str:
        """Number of sessions whose share of the re-tests is at least RELIABLE."""
        return f"{int((shares >= RELIABLE).sum())} of {counted(len(self), 'session')}"


def values(rows: Iterable[Row], name: str) -> np.ndarray:
    """Values of a quantity in all rows. Shape (n,)."""
    return np.array([row[name] for row in rows], dtype=float)


def share(rows: Sequence[Row], name: str) -> float:
    """Share of the rows in which a flag is set; 0 without rows."""
    return float(values(rows, name).mean()) if rows else 0.0


def share_cell(rows: Sequence[Row], name: str) -> str:
    """Cell: share of the rows in which a flag is set; empty without rows."""
    return f"{share(rows, name):.0%}" if rows else ""


def outcome_cells(rows: Sequence[Row]) -> list[str]:
    """Cells: landed, true flips, median angle, number beyond the motors' no-load speed."""
    angle = f"{np.median(values(rows, 'angle_deg')):.0f}°" if rows else ""
    beyond = f"{sum(row['beyond_no_load'] for row in rows)}"
    return [share_cell(rows, "landed"), share_cell(rows, "true_flip"), angle, beyond]


def quantile_cells(sample: np.ndarray, form: str) -> list[str]:
    """Cells: minimum, lower quartile, median, upper quartile and maximum of a sample."""
    return [f"{value:{form}}" for value in np.quantile(sample, (0.0, 0.25, 0.5, 0.75, 1.0))]
