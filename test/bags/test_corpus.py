# SPDX-License-Identifier: Apache-2.0
"""A recording that is spoilt is refused, or imported as one that can be shown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_samples import START, of_states

from wam_power_ros.bags import reader
from wam_power_ros.cli import main

SHIPPED = min((Path(__file__).resolve().parents[2] / "bags").glob("reach_*"))
WAM = tuple(f"wam_j{joint}" for joint in range(1, 8))
STAMPS, Q = reader.read_demonstration(SHIPPED, WAM)
STAMPS, Q = START + STAMPS[:1200] - STAMPS[0], Q[:1200]
MIDST = slice(600, None)
Spoil = Callable[[np.ndarray, np.ndarray, np.ndarray], object]  # receptions, stamps, angles


def changed(array: np.ndarray, place: object, value: object) -> None:
    array[place] = value  # type: ignore[index]


SPOILT: dict[str, Spoil] = {
    "degrees": lambda r, t, q: np.multiply(q, 57.3, out=q),
    "clock set back an hour": lambda r, t, q: changed(t, MIDST, t[600:] - 3600 * 10**9),
    "a state of yesterday": lambda r, t, q: changed(t, 0, t[0] - 86400 * 10**9),
    "states lost": lambda r, t, q: changed(t, MIDST, t[600:] + 60_000_000),
    "states NaN": lambda r, t, q: changed(q, slice(600, 620), np.nan),
    "a joint turns": lambda r, t, q: changed(q, (MIDST, 3), q[600:, 3] + 6.2832),
    "reception at the end of time": lambda r, t, q: changed(r, slice(600, 603), 2**63 - 5),
    "no stamps": lambda r, t, q: changed(t, slice(None), 0),
    "standstill": lambda r, t, q: changed(q, slice(None), q[0]),
}


@pytest.mark.parametrize("what", SPOILT)
def test_what_is_imported_can_be_shown(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    received, stamps, q = (STAMPS + 300_000).copy(), STAMPS.copy(), Q.copy()
    SPOILT[what](received, stamps, q)
    order = np.argsort(received, kind="stable")
    rows = zip(received[order].tolist(), stamps[order].tolist(), q[order], strict=True)
    theirs = of_states(tmp_path / "theirs", [(r, t, WAM, row) for r, t, row in rows])
    ours = tmp_path / "ours"
    status = main.main(["bags", "import", str(theirs), "--task", "reach", "--output", str(ours)])
    assert status in (0, 2)
    assert ours.exists() == (status == 0)
    assert capsys.readouterr().err.startswith("wam-power: " * (status == 2))
    if status == 0:
        assert main.main(["bags", "show", str(ours)]) == 0
