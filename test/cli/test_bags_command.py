# SPDX-License-Identifier: Apache-2.0
"""`wam-power bags` lists, grades and imports takes, and loses none."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_samples import REACH, START, WAM, demonstration, of_states

from wam_power_ros.bags import reader
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import main
from wam_power_ros.tasks.reach.task import Reach

Said = Callable[..., str]


@pytest.fixture
def take(tmp_path: Path) -> Path:
    """A copy of a shipped reach, in a folder of takes."""
    return Path(shutil.copytree(REACH, tmp_path / "taught" / "bags" / REACH.name))


def test_takes_are_listed_by_what_their_descriptions_say(take: Path, said: Said) -> None:
    BagWriter(take.with_name("demo_cut")).abandon()
    take.rename(take.with_name("reach_\x1b[2J\nx"))
    (file,) = take.with_name("reach_\x1b[2J\nx").glob("*.mcap")
    file.write_bytes(b"")  # it is not read
    folder, cut, odd = said("bags", "list", take.parent.parent).splitlines()
    assert folder == "taught/bags/" and "was never closed" in cut
    assert odd.split() == ["reach_\\x1b[2J\\nx", "reach", "6.1", "s"]  # with the rest at both ends


def test_each_take_that_is_shown_is_graded_with_the_reasons(
    take: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    still = demonstration(take.with_name("demo_still"), np.zeros((300, 7)), WAM)
    BagWriter(take.with_name("demo_cut")).abandon()
    _, once = reader.read_demonstration(REACH, WAM)
    back = once[-1] + 0.5 * (once[::-1] - once[-1])
    back = np.concatenate([once, np.tile(once[-1], (200, 1)), back])
    back = demonstration(take.with_name("reach_back"), back, WAM)
    takes = [str(each) for each in (take.with_name("demo_cut"), still, back)]
    assert main.main(["bags", "show", *takes]) == 2
    out, err = capsys.readouterr()
    assert f"{still}: demo, 0.60 s, poor\n  hardly moves: 0.000 rad" in out
    assert "fair\n  " in out and "s of movement after a pause of" in out
    assert "was never closed" in err
    monkeypatch.setattr("wam_power_ros.learning.policy.DURATION_MAX", 1.5)
    assert main.main(["bags", "show", str(back)]) == 0
    out = capsys.readouterr().out
    assert "poor\n" in out and "a movement of 1.6 s; at most 1.5 s can be learnt" in out

    def refuse(*given: object) -> None:
        raise ValueError("nothing to fit")

    monkeypatch.setattr(Reach, "demonstration_of", refuse)
    assert main.main(["bags", "show", str(back)]) == 0
    out = capsys.readouterr().out
    assert "poor\n" in out and "  nothing to fit\n" in out


def test_takes_are_drawn_into_a_file(tmp_path: Path, said: Said) -> None:
    output = tmp_path / "takes.png"
    assert str(output) in said("bags", "plot", REACH, "--output", output)
    assert output.read_bytes().startswith(b"\x89PNG")


def test_an_imported_bag_is_of_the_task_it_was_imported_for(
    tmp_path: Path, said: Said, capsys: pytest.CaptureFixture[str]
) -> None:
    names = tuple(f"panda_joint{joint}" for joint in range(1, 8))
    _, q = reader.read_demonstration(REACH, WAM)
    theirs = demonstration(tmp_path / "theirs", q, names)
    assert "good" in said("bags", "import", theirs, "--joints", *names, "--task", "reach")
    _, angles = reader.read_demonstration(tmp_path / "reach_theirs", WAM)
    np.testing.assert_array_equal(angles, q)
    assert main.main(["learn", "--bags", "reach_theirs"]) == 2
    assert "is a demonstration of reach, not of flip" in capsys.readouterr().err


def test_bags_are_imported_in_part_or_together(
    take: Path, said: Said, refusal: Callable[..., str]
) -> None:
    stamps, q = reader.read_demonstration(take, WAM)
    imported = ("bags", "import", "--task", "reach")
    for begin, end in ((0.0, 1.0), (1.0005, 9.0)):
        said(*imported, take, "--part", begin, end, "--output", f"p{end}")
    found, _ = reader.read_demonstration("p1.0", WAM)
    assert (found[-1] - found[0]) * 1e-9 == pytest.approx(1.0, abs=0.01)
    said(*imported, "p9.0", "p1.0", "--output", "both")
    found, angles = reader.read_demonstration("both", WAM)
    np.testing.assert_array_equal(angles, q)
    np.testing.assert_array_equal(found, stamps)
    assert "0 <= START < END" in refusal("bags", "import", str(take), "--part", "2", "1")


def broken(tmp_path: Path, kind: str) -> Path:
    """A movement of the arm that no command takes as it is."""
    stamps, q = reader.read_demonstration(REACH, WAM)
    step = np.diff(stamps, prepend=stamps[0])
    step[len(q) // 3] += 86_400 * 10**9 if kind == "gap" else -(10**9)
    theirs = (START + np.cumsum(step)).tolist()
    received = (START + stamps - stamps[0] + 10**6).tolist()
    states = [(*each, WAM, row) for *each, row in zip(received, theirs, q, strict=True)]
    return of_states(tmp_path / "theirs", states)


@pytest.mark.parametrize("kind", ["clock set back", "gap"])
def test_what_a_refusal_advises_imports_the_movement(
    kind: str, tmp_path: Path, said: Said, refusal: Callable[..., str]
) -> None:
    theirs = broken(tmp_path, kind)
    advice = re.compile(r"(--by-reception)|, ([\d.]+) s after")
    shown, advised = (
        advice.search(refusal("bags", command, str(theirs))) for command in ("show", "import")
    )
    assert shown and advised and shown[0] == advised[0]
    part = ["--part", float(advised[2]) + 0.1, "1e9"] if advised[2] else []
    given = [theirs, *filter(None, [advised[1]]), *part]
    said("bags", "show", said("bags", "import", *given).split()[1])
