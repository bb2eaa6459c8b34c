# SPDX-License-Identifier: Apache-2.0
"""Sets of LeRobot say the movement of a bag, and give it back; lerobot itself reads them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wam_power_ros import rotations
from wam_power_ros.bags import lerobot
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.reader import read_states
from wam_power_ros.cli import main
from wam_power_ros.learning.demonstration import smooth_joints
from wam_power_ros.params import overlay

ROOT = Path(__file__).resolve().parents[2]
TOSSES = sorted((ROOT / "bags").glob("demo_*"))
REACHES = sorted((ROOT / "bags").glob("reach_*"))
WAM = tuple(f"wam_j{joint}" for joint in range(1, 8))
FPS = 50
NAMES = ("a", "b")


def bags(*arguments: object) -> int:
    return main.main(["bags", *map(str, arguments)])


def export(to: Path, *recorded: Path) -> Path:
    pytest.importorskip("pyarrow")
    assert bags("export", *recorded, "--format", "lerobot", "--output", to) == 0
    return to


def frames(of: Path) -> dict[str, np.ndarray]:
    parquet = pytest.importorskip("pyarrow.parquet")
    read = parquet.read_table(of / "data" / lerobot.FIRST)
    return {name: np.array(read[name].to_pylist()) for name in read.column_names}


def described(of: Path, name: str = lerobot.INFO) -> Any:  # noqa: ANN401 - JSON
    return json.loads((of / name).read_text())


def set_of(
    folder: Path, q: np.ndarray, names: object, numbers: np.ndarray, fps: float = 30.0
) -> Path:
    """A set as of format 2.1, with a file for each episode."""
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    feature = {"dtype": "float32", "shape": [q.shape[1]], "names": names}
    info = {
        "codebase_version": "v2.1",
        "total_episodes": int(numbers[-1]) + 1,
        "features": {"observation.state": feature},
    }
    (folder / lerobot.INFO).write_text(json.dumps(info))
    for number in range(int(numbers[-1]) + 1):
        rows = np.flatnonzero(numbers == number)
        columns = {
            "observation.state": q[rows].tolist(),
            "action": q[rows].tolist(),
            "timestamp": pyarrow.array(np.arange(len(rows)) / fps, pyarrow.float32()),
            "episode_index": numbers[rows],
        }
        file = folder / "data" / "chunk-000" / f"episode_{number:06d}.parquet"
        parquet.write_table(pyarrow.table(columns), file)
    return folder


def movement(count: int = 90) -> np.ndarray:
    s = np.linspace(0.0, 1.0, count)
    return np.column_stack([0.8 * np.sin(2.0 * s), 0.5 * s**2])


def test_a_frame_has_angles_speeds_and_tool_of_the_smoothed_movement_at_even_times(
    tmp_path: Path,
) -> None:
    found = frames(export(tmp_path / "set", TOSSES[0]))
    states = read_states(Bag(TOSSES[0]), WAM)
    t, q = smooth_joints(states.stamps, states.q)
    at = np.arange(len(found["timestamp"])) / FPS
    np.testing.assert_allclose(found["timestamp"], at, atol=1e-6)
    assert at[-1] <= t[-1] < at[-1] + 1 / FPS
    state, arm = found["observation.state"], overlay.setup().arm()
    for joint in range(7):
        np.testing.assert_allclose(state[:, joint], np.interp(at, t, q[:, joint]), atol=1e-6)
    speeds = np.gradient(state[:, :7], at, axis=0)
    assert np.abs(state[:, 7:14] - speeds).max() < 0.1 * np.abs(speeds).max()
    assert arm is not None
    position, rotation = arm.tool_pose(state[40, :7])
    np.testing.assert_allclose(state[40, 14:17], position, atol=1e-6)
    np.testing.assert_allclose(rotations.matrix(state[40, 17:]), rotation, atol=1e-6)


def test_an_action_is_the_angles_of_the_next_frame_and_the_last_one_holds(tmp_path: Path) -> None:
    found = frames(export(tmp_path / "set", TOSSES[0], REACHES[0]))
    for number in (0, 1):
        of = found["episode_index"] == number
        angles, action = found["observation.state"][of, :7], found["action"][of]
        np.testing.assert_array_equal(action[:-1], angles[1:])
        np.testing.assert_array_equal(action[-1], angles[-1])
        assert found["frame_index"][of].tolist() == [*range(of.sum())]
    assert found["index"].tolist() == [*range(len(found["action"]))]


def test_the_sign_of_the_orientation_does_not_jump() -> None:
    t = np.arange(0.0, 2.0, 0.002)
    q = np.column_stack([2.0 * np.pi * t / t[-1]])

    def turned(q: np.ndarray) -> list[float]:
        half = 0.5 * q[0]
        quat = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
        return [0.0, 0.0, 0.0, *(quat if quat[3] >= 0.0 else -quat)]

    quat = lerobot.episode("a turn", t, q, FPS, turned).state[:, -4:]
    assert np.abs(np.diff(quat, axis=0)).max() < 0.1
    np.testing.assert_allclose(quat[-1], [0.0, 0.0, 0.0, -1.0], atol=0.05)


def test_the_descriptions_agree_with_the_frames(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    made = export(tmp_path / "set", *TOSSES, REACHES[0])
    found, info = frames(made), described(made)
    assert info["total_frames"] == len(found["index"])
    assert info["total_episodes"] == 4 and info["splits"] == {"train": "0:4"}
    assert set(info["features"]) == set(found)
    for key, feature in info["features"].items():
        assert feature["shape"] == [*found[key].shape[1:]] or feature["shape"] == [1]
        assert feature["names"] is None or len(feature["names"]) == feature["shape"][0]
    stats = described(made, "meta/stats.json")
    action = found["action"]
    np.testing.assert_allclose(stats["action"]["mean"], action.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(stats["action"]["q99"], np.quantile(action, 0.99, axis=0), atol=1e-6)
    assert stats["timestamp"]["count"] == [len(action)]
    rows = parquet.read_table(made / "meta/episodes" / lerobot.FIRST).to_pylist()
    for number, row in enumerate(rows):
        part = slice(row["dataset_from_index"], row["dataset_to_index"])
        assert set(found["episode_index"][part]) == {number}
        assert row["length"] == len(found["index"][part])
        maximum = found["action"][part].max(axis=0)
        np.testing.assert_allclose(row["stats/action/max"], maximum, atol=1e-6)
    assert rows[-1]["dataset_to_index"] == info["total_frames"]
    tasks = parquet.read_table(made / "meta/tasks.parquet").to_pydict()
    assert tasks["task"] == [*dict.fromkeys(row["tasks"][0] for row in rows)]
    assert "A pancake is tossed" in tasks["task"][0]


def test_an_exported_movement_comes_back_as_a_demonstration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    made = export(tmp_path / "set", *TOSSES[:2])
    assert bags("import", made) == 2
    assert "has 2 episodes; name one: --episode 0 to 1" in capsys.readouterr().err
    assert bags("import", made, "--episode", 1, "--output", "back") == 0
    back, there = read_states(Bag("back"), WAM), read_states(Bag(TOSSES[1]), WAM)
    t, q = smooth_joints(there.stamps, there.q)
    at = (back.stamps - back.stamps[0]) * 1e-9
    expected = np.column_stack([np.interp(at, t, of) for of in q.T])
    np.testing.assert_allclose(back.q, expected, atol=1e-5)
    assert Bag("back").kind == Bag(TOSSES[1]).kind


@pytest.mark.parametrize(
    ("names", "asked"),
    [
        (["a.pos", "b.pos"], NAMES),
        ({"motors": ["a", "b"]}, NAMES),
        (None, ("observation.state.0", "observation.state.1")),  # by their place
    ],
)
def test_the_names_of_other_sets_are_those_of_the_joints(
    names: object, asked: tuple[str, str], tmp_path: Path
) -> None:
    q = movement()
    made = set_of(tmp_path / "set", np.vstack([q, 2 * q]), names, np.repeat([0, 1], len(q)))
    states = read_states(Bag(lerobot.as_bag(made, tmp_path / "bags", 1)), asked)
    np.testing.assert_allclose(states.q, 2 * q, atol=1e-12)
    np.testing.assert_allclose(np.diff(states.stamps) * 1e-9, 1 / 30, atol=1e-6)


def test_a_person_says_that_the_angles_are_in_degrees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    q = movement() @ np.array([np.linspace(0.2, 1.0, 7), np.linspace(-1.0, -0.3, 7)])
    made = set_of(tmp_path / "set", np.degrees(q), [*WAM], np.zeros(90, dtype=int))
    assert bags("import", made) == 2
    assert "degrees" in capsys.readouterr().err
    assert bags("import", made, "--degrees", "--output", "demonstration") == 0
    np.testing.assert_allclose(read_states(Bag("demonstration"), WAM).q, q, atol=1e-9)
    assert bags("import", TOSSES[0], "--degrees", "--output", "another") == 2
    assert "is a bag, whose angles are in rad" in capsys.readouterr().err
    assert bags("import", TOSSES[0], "--episode", 3, "--output", "another") == 2
    assert f"--episode 3: {TOSSES[0]} is no set of LeRobot" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"features": {"action": {}}}, "has no observation.state; its features: action"),
        ({"total_episodes": 0}, "has 0 episodes"),
        ({"total_episodes": "many"}, "cannot be read as a set of LeRobot: TypeError"),
        ({"features": {"observation.state": {"names": ["a"]}}}, r"shape \(90, 2\) for \['a'\]"),
    ],
)
def test_a_set_that_is_damaged_is_refused(
    change: dict[str, object], reason: str, tmp_path: Path
) -> None:
    made = set_of(tmp_path / "set", movement(), [*NAMES], np.zeros(90, dtype=int))
    (made / lerobot.INFO).write_text(json.dumps(described(made) | change))
    with pytest.raises(ValueError, match=reason):
        lerobot.as_bag(made, tmp_path / "bags", None)


def test_frames_that_are_cut_off_are_refused(tmp_path: Path) -> None:
    made = set_of(tmp_path / "set", movement(), [*NAMES], np.zeros(90, dtype=int))
    (file,) = (made / "data").rglob("*.parquet")
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(ValueError, match="has no readable data"):
        lerobot.as_bag(made, tmp_path / "bags", None)


def test_what_cannot_be_written_is_refused_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow")
    there = tmp_path / "there"
    there.mkdir()
    arguments = ("--format", "lerobot", "--output")
    assert bags("export", TOSSES[0], *arguments, there) == 2
    assert "exists already; name another folder" in capsys.readouterr().err
    assert bags("export", there, *arguments, tmp_path / "set") == 2
    assert "there is no movement to write" in capsys.readouterr().err
    assert bags("export", *TOSSES, "--output", tmp_path / "table.csv") == 2
    assert "a table is of one bag or session, not of 3" in capsys.readouterr().err
    full = OSError(28, "No space left on device")
    monkeypatch.setattr(lerobot.durable_files, "sync", lambda path: (_ for _ in ()).throw(full))
    assert bags("export", TOSSES[0], *arguments, tmp_path / "set") == 2
    assert "No space left" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pyarrow", None)  # as if it were not installed
    assert bags("export", TOSSES[0], *arguments, tmp_path / "set") == 2
    assert "wam_power_ros[export]" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_lerobot_itself_reads_a_set(tmp_path: Path) -> None:
    """Not part of `make test`: lerobot is large. See docs/command_line.md."""
    pytest.importorskip("lerobot")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    made = export(tmp_path / "set", *TOSSES, *REACHES)
    found, info = frames(made), described(made)
    window = {"action": [0.0, 1 / FPS, 2 / FPS]}
    of = LeRobotDataset("local/set", root=made, delta_timestamps=window)
    assert (len(of), of.fps, of.num_episodes) == (info["total_frames"], FPS, 7)
    for index in (0, 100, len(of) - 1):
        item = of[index]
        np.testing.assert_array_equal(item["observation.state"], found["observation.state"][index])
        np.testing.assert_array_equal(item["action"][0], found["action"][index])
        assert item["timestamp"] == pytest.approx(found["frame_index"][index] / FPS)
        assert item["task"].startswith("A pancake" if index < 200 else "The tool")
    assert of[len(of) - 1]["action_is_pad"].tolist() == [False, True, True]
    one = LeRobotDataset("local/set", root=made, episodes=[3])
    assert len(one) == (found["episode_index"] == 3).sum()
    np.testing.assert_allclose(of.meta.stats["action"]["mean"], found["action"].mean(0), atol=1e-6)
