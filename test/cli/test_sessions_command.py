# SPDX-License-Identifier: Apache-2.0
"""Sessions have a line each, and two stand side by side with what differs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from toss_task import ANY_ARM, demonstrated_policy, toss

from wam_power_ros.cli import main
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset


def learnt(folder: Path, rollouts: int, seed: int = 5, **changes: Any) -> Path:  # noqa: ANN401
    settings = preset("flip", "hindsight", **{"budget": 24, "retests": 0, **changes})
    begun = Session.begin(folder, settings, seed, [demonstrated_policy(seed=1)], context={})
    with begun as session:
        practice = session.practice(ANY_ARM)
        for _ in range(rollouts):
            trial = practice.next_trial()
            assert trial is not None
            record = practice.learn_assessed(trial, toss(trial, practice.task.settings), bag="")
            session.append(record)
    return folder


def said(capsys: pytest.CaptureFixture[str], *words: object) -> list[str]:
    assert main.main([*map(str, words)]) == 0
    return capsys.readouterr().out.splitlines()


def test_each_session_has_a_line_and_one_that_cannot_be_read_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = learnt(Path("sessions/one"), 4)
    learnt(Path("sessions/two"), 0, retests=3)
    broken = Path("sessions/three")
    broken.mkdir()
    (broken / "session.yaml").write_text("seed: many\n")
    head, one, three, two = said(capsys, "sessions")
    assert head.split()[:4] == ["session", "task", "preset", "learner"]
    records = read(folder).records
    best = max(record.ret or 0.0 for record in records)
    won = sum(record.succeeded for record in records)
    assert one.split()[:6] == ["sessions/one", "flip", "hindsight", "power", "4", f"{best:.3f}"]
    assert f"  {won} of 4 rollouts succeeded  " in one
    assert "0 of 0 rollouts succeeded, not ended" in two and " – " in two
    assert three.startswith("sessions/three") and "cannot be read" in three
    assert one.index("  20") == two.index("  20") < 120  # a long reason moves no column
    assert said(capsys, "list", "sessions") == [head, one, three, two]
    (_, alone) = said(capsys, "sessions", "sessions/one")
    assert alone.split() == one.split()


def test_two_sessions_stand_side_by_side_with_the_settings_that_differ(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    learnt(Path("a"), 6)
    learnt(Path("b"), 3, seed=7, budget=30, gain=0.5)
    lines = said(capsys, "sessions", "a", "b")
    rows = {line[: line.index("  ")]: line.split("  ", 1)[1].split() for line in lines}
    assert rows["session"] == ["a", "b"]
    assert rows["preset"] == ["hindsight", "changed"]
    assert (rows["seed"], rows["rollouts"]) == (["5", "7"], ["6", "3"])
    assert rows["practice.budget"] == ["24", "30"]
    assert rows["task_settings.gain"][1] == "0.5"
    assert not [name for name in rows if "sigma" in name or "confirm" in name]  # are equal
    first = next(record.ret for record in read("a").records)
    assert rows["first return"][0] == f"{first:.3f}"


def test_no_session_is_an_error_that_names_the_folders(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["sessions", str(tmp_path)]) == 2
    assert f"no session in {tmp_path}" in capsys.readouterr().err
