# SPDX-License-Identifier: Apache-2.0
"""Sessions have a line each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from toss_task import session_of

from wam_power_ros.practice.session import read
from wam_power_ros.practice.settings import preset


def test_each_session_has_a_line_and_one_that_cannot_be_read_its_reason(
    said: Callable[..., str], refusal: Callable[..., str]
) -> None:
    assert "no session in sessions" in refusal("sessions")
    settings = preset("flip", "hindsight", budget=24, retests=0)
    folder = session_of(Path("sessions/one"), settings, 4)
    session_of(Path("sessions/two"), preset("flip", "hindsight", budget=24, retests=3), 0)
    broken = Path("sessions/three")
    broken.mkdir()
    (broken / "session.yaml").write_text("seed: many\n")
    head, one, three, two = said("sessions").splitlines()
    assert head.split()[:3] == ["session", "task", "learner"]
    records = read(folder).records
    best = max(record.ret or 0.0 for record in records)
    won = sum(record.succeeded for record in records)
    assert one.split()[:5] == ["sessions/one", "flip", "power", "4", f"{best:.3f}"]
    assert f"  {won} of 4 rollouts succeeded  " in one
    assert "0 of 0 rollouts succeeded, not ended" in two and " – " in two
    assert three.startswith("sessions/three") and "cannot be read" in three
    assert one.index("  20") == two.index("  20") < 120  # a long reason moves no column
    (_, alone) = said("sessions", "sessions/one").splitlines()
    assert alone.split() == one.split()
