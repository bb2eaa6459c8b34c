# SPDX-License-Identifier: Apache-2.0
"""`wam-power bags export` gives other programs what was recorded, bit for bit, or nothing."""

from __future__ import annotations

import csv
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_samples import DEMO, NAMES, QOS, START, WAM
from rclpy.serialization import serialize_message
from toss_task import practice_in, session_of

from wam_power_ros import rotations
from wam_power_ros.bags import layout, reader, table
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import main
from wam_power_ros.params import overlay
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros.joint_messages import JointStateWriter

Rows = list[dict[str, str]]


def exported(recorded: Path, file: Path) -> Rows:
    assert main.main(["bags", "export", str(recorded), "--output", str(file)]) == 0
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    """Table of a shipped toss."""
    return exported(DEMO, tmp_path_factory.mktemp("table") / "take.csv")


def numbers(rows: Rows, *names: str) -> np.ndarray:
    return np.array([[float(row[name]) for name in names] for row in rows])


def test_the_file_restores_the_angles_of_a_bag_bit_for_bit(rows: Rows) -> None:
    states = reader.read_states(Bag(DEMO), WAM)
    q = numbers(rows, *(f"q.{name}" for name in WAM))
    assert q.tobytes() == np.ascontiguousarray(states.q).tobytes()  # the sign of zero, too
    assert [int(row["stamp_ns"]) for row in rows] == states.stamps.tolist()
    t = (states.stamps - states.stamps[0]) * 1e-9
    np.testing.assert_allclose(numbers(rows, "t")[:, 0], t, atol=1e-12)


def test_the_tool_is_where_the_model_of_the_arm_has_it(rows: Rows) -> None:
    row, arm = rows[400], overlay.setup().arm()
    position, rotation = arm.tool_pose(numbers([row], *(f"q.{name}" for name in WAM))[0])
    np.testing.assert_array_equal(numbers([row], "tool.x", "tool.y", "tool.z")[0], position)
    quat = numbers([row], "tool.qx", "tool.qy", "tool.qz", "tool.qw")[0]
    np.testing.assert_allclose(rotations.matrix(quat), rotation, atol=1e-12)


def test_a_row_has_the_last_pose_of_the_body(rows: Rows) -> None:
    poses = {}
    for _, _, cdr in Bag(DEMO).messages(["/pancake/state"]):
        message = layout.decoded(cdr, "nav_msgs/msg/Odometry")
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        poses[stamp] = message.pose.pose
    assert len({row["body.pancake.stamp_ns"] for row in rows}) == 49
    for row in rows:
        last = max(stamp for stamp in poses if stamp <= int(row["stamp_ns"]))
        assert int(row["body.pancake.stamp_ns"]) == last
        assert float(row["body.pancake.z"]) == poses[last].position.z
        assert float(row["body.pancake.qw"]) == poses[last].orientation.w


def test_before_the_first_pose_of_a_body_its_cells_are_empty_and_poses_in_no_row_are_counted() -> (
    None
):
    columns, (remark,) = table.body_columns(Bag(DEMO), np.array([0, 10**18]))
    assert columns["body.pancake.stamp_ns"][0] is columns["body.pancake.x"][0] is None
    assert None not in (columns["body.pancake.stamp_ns"][1], columns["body.pancake.x"][1])
    assert "49 of 50 poses of pancake are in no row" in remark.text


def test_speeds_and_efforts_are_those_of_the_same_messages_by_name(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "take")
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    arm, hand = JointStateWriter(NAMES[::-1]), JointStateWriter(("hand",))
    q = 1e-3 * np.arange(30.0).reshape(10, 3)
    for index, row in enumerate(q):
        stamp_ns = START + 2_000_000 * index
        for message in (hand(stamp_ns, [9.0], [9.0], [9.0]), arm(stamp_ns, row, row + 1, row + 2)):
            writer.write("/joint_states", stamp_ns, serialize_message(message))
    bag = Bag(writer.close({}))
    columns = table.joint_columns(bag, reader.read_states(bag, NAMES))
    for name, values in zip(NAMES[::-1], q.T, strict=True):
        assert columns[f"q.{name}"] == values.tolist()
        assert columns[f"qd.{name}"] == (values + 1).tolist()
        assert columns[f"effort.{name}"] == (values + 2).tolist()


def test_a_session_has_a_row_for_each_rollout_with_its_terms(tmp_path: Path) -> None:
    folder = session_of(tmp_path / "session", preset("flip", budget=24), 5)
    with Session.open(folder) as session:
        session.append(practice_in(folder).rate(-0.25))
    rows, records = exported(folder, tmp_path / "rollouts.csv"), read(folder).records
    for row, record in zip(rows, records, strict=True):
        assert (int(row["number"]), row["kind"]) == (record.number, record.kind)
        for name in ("demonstration", "bag", "fault", "why"):
            assert row[name] == getattr(record, name)
        assert row["success"] == str(record.success)
        given = {"ret": record.ret, "rated_return": record.rated_return}
        given |= {f"term.{name}": value for name, value in record.terms.items()}
        assert {name: row[name] for name in given} == {
            name: "" if value is None else repr(value) for name, value in given.items()
        }
        for name, values in (("z", record.z), ("theta", record.theta)):
            found = numbers([row], *(f"{name}.{i}" for i in range(len(values))))
            assert found[0].tolist() == values
    assert any(record.terms for record in records)
    assert rows[-1]["ret"] != rows[-1]["rated_return"]


def test_a_set_has_an_episode_for_each_recorded_rollout_of_a_session(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    folder = session_of(tmp_path / "session", preset("flip", budget=24), 3)
    made = tmp_path / "set"
    for record in read(folder).records[:2]:
        shutil.copytree(DEMO, folder / "bags" / record.bag)
    words = ["bags", "export", folder, "--format", "lerobot", "--fps", 100, "--output", made]
    assert main.main([*map(str, words)]) == 0
    assert "is not a bag" in capsys.readouterr().out  # the third one is left out
    found = parquet.read_table(made / "data").to_pydict()
    assert set(found["episode_index"]) == {0, 1}
    assert found["timestamp"][1] == pytest.approx(0.01)


def test_what_cannot_be_exported_is_refused_by_name(
    tmp_path: Path, refusal: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there.csv").write_text("precious")
    (tmp_path / "neither").mkdir()
    session_of(tmp_path / "empty", preset("flip"), 0)
    monkeypatch.setitem(sys.modules, "pyarrow", None)  # as if it were not installed
    for recorded, name, reason in (
        (DEMO, "take.xlsx", "take.xlsx must end in .csv or .parquet"),
        (DEMO, "there.csv", "there.csv exists already"),
        (DEMO, "take.parquet", 'Parquet needs pyarrow: pip install "wam_power_ros[export]"'),
        ("neither", "take.csv", "neither is not a bag"),
        ("empty", "take.csv", "empty has no rollout yet"),
    ):
        assert reason in refusal("bags", "export", str(recorded), "--output", name)
    assert (tmp_path / "there.csv").read_text() == "precious"
