# SPDX-License-Identifier: Apache-2.0
"""Choice of the demonstration to learn from, by the return of its reproduction."""

from __future__ import annotations

from collections.abc import Sequence

from wam_power_ros.practice.session_log import Record


def choose_demonstration(reproductions: Sequence[Record]) -> tuple[int, str]:
    """Choose the reproduction with the highest return, including ratings.

    The authors selected one good demonstration of a small series ([Kormushev2010], Sec. IV).

    Args:
        reproductions: One record for each candidate; those without a return or with a fault are not
            eligible.

    Returns:
        Index into `reproductions`, the first one on a tie, and a human-readable reason.

    Raises:
        ValueError: No reproduction is eligible.
    """
    eligible = [
        index
        for index, record in enumerate(reproductions)
        if record.rated_return is not None and not record.fault
    ]
    if not eligible:
        reasons = "; ".join(f"{record.demonstration}: {record.why}" for record in reproductions)
        raise ValueError(f"no demonstration could be reproduced ({reasons})")
    best = max(eligible, key=lambda index: float(reproductions[index].rated_return or 0.0))
    count = len(reproductions)
    rank = f"highest return of {count} reproductions" if count > 1 else "the only reproduction"
    return best, f"{rank}, {reproductions[best].rated_return:.3f}"
