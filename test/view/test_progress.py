# SPDX-License-Identifier: Apache-2.0
"""Progress of a session as columns and text."""

from __future__ import annotations

import fcntl
from pathlib import Path

import numpy as np
import pytest
from toss_task import some_records

pytest.importorskip("viser", reason="no viser")

from wam_power_ros.params import overlay
from wam_power_ros.practice.settings import preset
from wam_power_ros.view import session_page
from wam_power_ros.view.session_page import KINDS, NEWEST_COUNT, curve, label, newest

RECORDS = some_records(8)


def test_each_return_is_in_the_column_of_its_kind_and_the_best_never_falls() -> None:
    lost = RECORDS[3].model_copy(update={"ret": None, "learnt": False, "z_corrected": None})
    records = [*RECORDS[:3], lost, *RECORDS[4:]]
    numbers, *columns, best = curve(records)
    assert numbers.tolist() == [float(record.number) for record in records]
    for i, record in enumerate(records):
        given = {kind: columns[k][i] for k, kind in enumerate(KINDS) if np.isfinite(columns[k][i])}
        assert given == ({} if record.ret is None else {record.kind: record.ret})
    rated = RECORDS[0].model_copy(update={"adjustment": 0.3})
    assert curve([rated])[-1][0] == RECORDS[0].ret and label(rated).endswith("+0.3")
    assert np.all(np.diff(best) >= 0.0) and best[-1] == max(r.ret or 0.0 for r in records)


def test_the_newest_rollouts_come_first_with_the_terms_of_their_returns() -> None:
    task = preset("flip").make_task({})
    text = newest(RECORDS, task)
    shown = RECORDS[: -NEWEST_COUNT - 1 : -1]
    assert [line[2:].split()[0] for line in text.splitlines() if line.startswith("**")] == [
        str(record.number) for record in shown
    ]
    for term, value in RECORDS[-1].terms.items():
        assert f"| {term} | {value:.3f} |" in text
    assert newest([], task).strip() == "|  |\n| --- |"


def test_a_session_runs_while_a_learner_or_a_launcher_holds_its_folder(tmp_path: Path) -> None:
    assert not session_page.running(tmp_path)
    (tmp_path / "logs").mkdir()
    for name in (".lock", "logs/.lock"):
        with (tmp_path / name).open("a") as file:
            assert not session_page.running(tmp_path)
            fcntl.flock(file, fcntl.LOCK_EX)
            assert session_page.running(tmp_path)
        assert not session_page.running(tmp_path)


def test_the_parameters_are_those_that_the_session_was_launched_with(tmp_path: Path) -> None:
    assert session_page.parameters(tmp_path) == overlay.setup()
    (tmp_path / "logs").mkdir()
    cobot = overlay.setup(["cobot"], simulated=True)
    (tmp_path / "logs/parameters.yaml").write_text(overlay.text(cobot))
    assert session_page.parameters(tmp_path)["torque_controller"] == cobot["torque_controller"]
