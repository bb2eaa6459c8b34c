# SPDX-License-Identifier: Apache-2.0
"""`wam-power bags` grades takes and loses none."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from bag_samples import demonstration

from wam_power_ros.bags import judgements, layout, reader, series
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import bags_command, main

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = min((ROOT / "bags").glob("reach_*"))
WAM = tuple(f"wam_j{joint}" for joint in range(1, 8))


def said(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    capsys.readouterr()
    assert main.main(["bags", *map(str, words)]) == 0
    return capsys.readouterr().out


@pytest.fixture
def take(tmp_path: Path) -> Path:
    """A copy of a shipped reach, in a folder of takes."""
    return Path(shutil.copytree(SHIPPED, tmp_path / "taught" / "bags" / SHIPPED.name))


def test_each_take_has_a_line_with_its_quality_and_why(
    take: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = np.zeros((300, 7))
    demonstration(take.with_name("demo_still"), still, WAM)
    BagWriter(take.with_name("demo_cut")).abandon()
    rows = {
        line.split()[0]: line.split(maxsplit=5)
        for line in said(capsys, "list", take.parent.parent).splitlines()
    }
    assert rows[take.name][1:] == ["reach", "2.7", "s", "good"]
    assert rows["demo_still"][1:] == ["flip", "0.6", "s", "poor", "hardly moves: 0.000 rad"]
    assert "was never closed" in " ".join(rows["demo_cut"])
    assert "poor" in rows["demo_cut"]


def test_what_the_fit_would_leave_out_or_refuse_is_said_with_the_grade(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, once = reader.read_demonstration(SHIPPED, WAM)
    back = once[-1] + 0.5 * (once[::-1] - once[-1])
    back = np.concatenate([once, np.tile(once[-1], (200, 1)), back])
    demonstration(tmp_path / "reach_back", back, WAM)
    (line,) = [row for row in said(capsys, "list", tmp_path).splitlines() if "reach_back" in row]
    assert " fair " in line and "s of movement after a pause of" in line
    shown = said(capsys, "show", tmp_path / "reach_back")
    assert "fair" in shown.splitlines()[0] and "s of movement after a pause of" in shown
    monkeypatch.setattr("wam_power_ros.learning.policy.DURATION_MAX", 1.5)
    (tmp_path / "reach_back" / judgements.FILE).unlink()  # the code in the files is the same
    (line,) = [row for row in said(capsys, "list", tmp_path).splitlines() if "reach_back" in row]
    assert " poor " in line and "a movement of 1.6 s; at most 1.5 s can be learnt" in line


def test_a_take_is_judged_once_and_again_after_any_change(
    take: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, judged = bags_command._judged, []
    monkeypatch.setattr(
        bags_command, "_judged", lambda path, *rest: judged.append(path) or judge(path, *rest)
    )
    first = said(capsys, "list", take)
    assert said(capsys, "list", take) == first
    assert judged == [take]
    assert "poor" in said(capsys, "list", take, "--config", "franka")  # of another arm
    (file,) = take.glob("*.mcap")
    whole = file.read_bytes()
    file.write_bytes(whole[:5000] + bytes([whole[5000] ^ 1]) + whole[5001:])  # the same size
    assert "is damaged" in said(capsys, "list", take)
    file.write_bytes(whole)
    assert said(capsys, "list", take) == first
    assert len(judged) == 4


def test_sessions_are_listed_one_after_another(
    take: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in "ab":
        shutil.copytree(take, take.parents[1] / name / "bags" / take.name)
    printed = []
    monkeypatch.setattr(
        bags_command, "_outcomes", lambda _: printed.append(capsys.readouterr().out) or {}
    )
    assert main.main(["bags", "list", str(take.parents[1])]) == 0
    assert [text.count(take.name) for text in printed] == [0, 1, 1]


def test_no_take_is_an_error_that_names_the_folders(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["bags", "list", str(tmp_path)]) == 2
    assert f"no bags below {tmp_path}" in capsys.readouterr().err


def test_a_take_is_shown_with_its_topics_and_joints(
    take: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = said(capsys, "show", take)
    assert f"{take}: reach, 2.67 s, good" in text
    assert "/joint_states" in text and "smoothness -1.5" in text
    assert text.count("% of its limit") == 7


def test_a_take_does_not_differ_from_itself(take: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = sorted((ROOT / "bags").glob("reach_*"))[1]
    _, same, different = said(capsys, "compare", take, take, other).splitlines()
    assert "rms 0.000 rad" in same and "tool 0 mm, at most 0 mm" in same
    assert "rms 0.000" not in different


@pytest.mark.parametrize(("suffix", "begin"), [("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_takes_are_drawn_into_a_file(
    suffix: str, begin: bytes, take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / f"takes.{suffix}"
    assert str(output) in said(capsys, "plot", take, "--output", output)
    assert output.read_bytes().startswith(begin)


def test_parts_names_and_the_trash(take: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = take.parent.parent / series.FILE
    series.write(file, [take])
    said(capsys, "rename", take, "reach_slow")
    renamed = take.with_name("reach_slow")
    assert series.read(file) == [renamed]
    said(capsys, "trim", renamed, 0.2, 1.0)
    stamps, _ = reader.read_demonstration(take.with_name("reach_slow_trimmed"), WAM)
    assert (stamps[-1] - stamps[0]) * 1e-9 == pytest.approx(0.8, abs=0.01)
    text = said(capsys, "delete", renamed)
    assert not renamed.exists() and series.read(file) == []
    assert Bag(text.split()[-1]).topics


def test_an_imported_bag_is_of_the_task_it_was_imported_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = tuple(f"panda_joint{joint}" for joint in range(1, 8))
    _, q = reader.read_demonstration(SHIPPED, WAM)
    theirs = demonstration(tmp_path / "theirs", q, names)
    monkeypatch.chdir(tmp_path)
    assert "good" in said(capsys, "import", theirs, "--joints", *names, "--task", "reach")
    _, angles = reader.read_demonstration(tmp_path / "reach_theirs", WAM)
    np.testing.assert_array_equal(angles, q)
    assert main.main(["learn", "--bags", "reach_theirs"]) == 2
    assert "is a demonstration of reach, not of flip" in capsys.readouterr().err


def test_an_imported_bag_from_which_nothing_can_be_learnt_is_graded_poor_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    still = demonstration(tmp_path / "still", np.zeros((200, 7)), WAM)
    monkeypatch.chdir(tmp_path)
    assert "poor  hardly moves" in said(capsys, "import", still)


def test_a_bag_that_was_never_closed_is_recovered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    writer = BagWriter(tmp_path / "cut")
    writer.event("start", "demo", 1)
    writer.flush()
    writer.abandon()
    assert layout.unfinished(tmp_path / "cut").exists()
    assert main.main(["recover", str(tmp_path / "cut")]) == 0
    assert "1 messages" in capsys.readouterr().out


def test_a_name_with_control_characters_is_listed_and_deleted_in_one_line(
    take: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = take.rename(take.with_name("reach_\x1b[2J\nx"))
    listed, deleted = said(capsys, "list", bag.parent), said(capsys, "delete", bag)
    for text in (listed, deleted):
        assert "\x1b" not in text and "reach_\\x1b[2J\\nx" in text
    assert len(deleted.splitlines()) == 1
