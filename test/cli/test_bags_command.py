# SPDX-License-Identifier: Apache-2.0
"""`wam-power bags` grades takes and loses none."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from bag_samples import START, demonstration, of_states

from wam_power_ros.bags import layout, reader
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
        for line in said(capsys, "list", "--quality", take.parent.parent).splitlines()
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
    (line,) = [
        row
        for row in said(capsys, "list", "--quality", tmp_path).splitlines()
        if "reach_back" in row
    ]
    assert " fair " in line and "s of movement after a pause of" in line
    shown = said(capsys, "show", tmp_path / "reach_back")
    assert "fair" in shown.splitlines()[0] and "s of movement after a pause of" in shown
    monkeypatch.setattr("wam_power_ros.learning.policy.DURATION_MAX", 1.5)
    (line,) = [
        row
        for row in said(capsys, "list", "--quality", tmp_path).splitlines()
        if "reach_back" in row
    ]
    assert " poor " in line and "a movement of 1.6 s; at most 1.5 s can be learnt" in line


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


@pytest.mark.parametrize(("suffix", "begin"), [("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_takes_are_drawn_into_a_file(
    suffix: str, begin: bytes, take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / f"takes.{suffix}"
    assert str(output) in said(capsys, "plot", take, "--output", output)
    assert output.read_bytes().startswith(begin)


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


def test_a_name_with_control_characters_is_listed_in_one_line(
    take: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = take.rename(take.with_name("reach_\x1b[2J\nx"))
    for words in (["list"], ["list", "--quality"]):
        text = said(capsys, *words, bag.parent)
        assert "\x1b" not in text and "reach_\\x1b[2J\\nx" in text
        assert len(text.splitlines()) == 3


def test_takes_are_listed_at_once_by_what_their_descriptions_say(
    take: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    BagWriter(take.with_name("demo_cut")).abandon()
    (file,) = take.glob("*.mcap")
    file.write_bytes(b"")  # it is not read
    listed = said(capsys, "list", take.parent.parent)
    rows = {line.split()[0]: line.split(maxsplit=4) for line in listed.splitlines()}
    assert rows[take.name][1:] == ["reach", "6.1", "s"]  # with the rest before and after
    assert "was never closed" in " ".join(rows["demo_cut"])


def test_bags_are_imported_in_part_or_together(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    stamps, q = reader.read_demonstration(take, WAM)
    for begin, end in ((0.0, 1.0), (1.0005, 9.0)):
        said(capsys, "import", take, "--part", begin, end, "--task", "reach", "--output", f"p{end}")
    found, _ = reader.read_demonstration("p1.0", WAM)
    assert (found[-1] - found[0]) * 1e-9 == pytest.approx(1.0, abs=0.01)
    said(capsys, "import", "p9.0", "p1.0", "--task", "reach", "--output", "both")
    found, angles = reader.read_demonstration("both", WAM)
    np.testing.assert_array_equal(angles, q)
    np.testing.assert_array_equal(found, stamps)
    assert main.main(["bags", "import", str(take), "--part", "2", "1"]) == 2
    assert "0 <= START < END" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("scale", "count", "why"),
    [(180 / np.pi, 2000, "degrees?"), (12.0, 2000, "degrees?"), (1.0, 1, "")],
)
def test_what_show_refuses_is_not_imported(
    scale: float,
    count: int,
    why: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, q = reader.read_demonstration(SHIPPED, WAM)
    theirs = demonstration(tmp_path / "theirs", scale * q[:count], WAM)
    monkeypatch.chdir(tmp_path)
    for command in ("show", "import"):
        assert main.main(["bags", command, str(theirs)]) == 2
        assert why in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["theirs"]


def broken(tmp_path: Path, kind: str) -> Path:
    """A movement of the arm that no command takes as it is."""
    stamps, q = reader.read_demonstration(SHIPPED, WAM)
    step = np.diff(stamps, prepend=stamps[0])
    if kind == "table":
        return csv_of(tmp_path / "t.csv", stamps, q)
    if kind == "folder of tables":
        (tmp_path / "data/chunk").mkdir(parents=True)
        csv_of(tmp_path / "data/chunk/episode_0.csv", stamps, q)
        return tmp_path / "data"
    half = len(q) // 3
    if kind == "gap":
        step[half] += 86_400 * 10**9
    elif kind == "clock set back":
        step[half] -= 10**9
    theirs = (START + np.cumsum(step)).tolist()
    received = (START + stamps - stamps[0] + 10**6).tolist()
    states = [(*each, WAM, row) for *each, row in zip(received, theirs, q, strict=True)]
    return of_states(tmp_path / "theirs", states)


def csv_of(file: Path, stamps: np.ndarray, q: np.ndarray) -> Path:
    rows = [
        ",".join(("stamp_ns", *WAM)),
        *(
            f"{t}," + ",".join(map(repr, row))
            for t, row in zip(stamps.tolist(), q.tolist(), strict=True)
        ),
    ]
    file.write_text("\n".join(rows))
    return file


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        ("show", "table"),
        ("show", "folder of tables"),
        ("import", "folder of tables"),
        ("show", "clock set back"),
        ("import", "clock set back"),
        ("show", "gap"),
        ("import", "gap"),
    ],
)
def test_what_a_refusal_advises_imports_the_movement(
    kind: str,
    command: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    theirs = broken(tmp_path, kind)
    monkeypatch.chdir(tmp_path)
    assert main.main(["bags", command, str(theirs)]) == 2
    why = capsys.readouterr().err
    advised = re.search(r"import (\S+\.csv)|(--by-reception)|, ([\d.]+) s after", why)
    assert advised, why
    part = ["--part", str(float(advised[3]) + 0.1), "1e9"] if advised[3] else []
    given = [advised[1] or str(theirs), *filter(None, [advised[2]]), *part]
    assert main.main(["bags", "import", *given]) == 0
    assert main.main(["bags", "show", capsys.readouterr().out.split()[1]]) == 0


def test_a_table_is_imported_bit_for_bit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    stamps, q = reader.read_demonstration(SHIPPED, WAM)
    assert main.main(["bags", "export", str(SHIPPED), "--output", "t.csv"]) == 0
    assert main.main(["bags", "import", "t.csv", "--output", "ours"]) == 0
    assert str(tmp_path) not in capsys.readouterr().err
    back = reader.read_demonstration("ours", WAM)
    np.testing.assert_array_equal(back[0], stamps)
    np.testing.assert_array_equal(back[1], q)
    assert main.main(["bags", "import", "t.csv", "--joints", *"abcdefg", "--output", "no"]) == 2
    assert capsys.readouterr().err.startswith("wam-power: t.csv: /joint_states: no message")
