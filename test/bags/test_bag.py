# SPDX-License-Identifier: Apache-2.0
"""A bag is verified once, whatever is read of it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from bag_samples import WAM, demonstration

from wam_power_ros.bags import files
from wam_power_ros.cli import main


def test_listing_verifies_no_bag_and_grading_each_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    verified: Counter[str] = Counter()
    verify = files.opened

    def counting(file: Path) -> files.McapFile | files.SqliteFile:
        verified[file.name] += 1
        return verify(file)

    monkeypatch.setattr(files, "opened", counting)
    bags = [
        demonstration(tmp_path / name, np.zeros((100, 7)), WAM) for name in ("demo_a", "demo_b")
    ]
    assert main.main(["bags", "list", str(tmp_path)]) == 0
    assert not verified
    assert main.main(["bags", "show", *map(str, bags)]) == 0
    assert verified == {"demo_a.mcap": 1, "demo_b.mcap": 1}
