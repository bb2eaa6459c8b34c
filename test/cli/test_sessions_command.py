# SPDX-License-Identifier: Apache-2.0
"""Sessions have a line each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from toss_task import ANY_ARM, demonstrated_policy, toss

from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset


def learnt(folder: Path, rollouts: int, retests: int = 0) -> Path:
    settings = preset("flip", "hindsight", budget=24, retests=retests)
    with Session.begin(folder, settings, 5, [demonstrated_policy(seed=1)], context={}) as session:
        practice = session.practice(ANY_ARM)
        for _ in range(rollouts):
            trial = practice.next_trial()
            record = practice.learn_assessed(trial, toss(trial, practice.task.settings), bag="")
            session.append(record)
    return folder


def test_each_session_has_a_line_and_one_that_cannot_be_read_its_reason(
    tmp_path: Path, said: Callable[..., str], refusal: Callable[..., str]
) -> None:
    assert "no session in sessions" in refusal("sessions")
    folder = learnt(Path("sessions/one"), 4)
    learnt(Path("sessions/two"), 0, retests=3)
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
