# SPDX-License-Identifier: Apache-2.0
"""`wam-power bags export` gives other programs what was recorded, bit for bit, or nothing."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from bag_samples import NAMES, QOS, START, demonstration
from rclpy.serialization import serialize_message
from toss_task import ANY_ARM, demonstrated_policy, toss

from wam_power_ros import rotations
from wam_power_ros.arm_identity import to_json
from wam_power_ros.bags import layout, reader, table
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import main
from wam_power_ros.params import overlay
from wam_power_ros.practice.session import Session, read
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros.joint_messages import JointStateWriter

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = min((ROOT / "bags").glob("demo_*"))
WAM = tuple(f"wam_j{joint}" for joint in range(1, 8))


def export(recorded: Path, output: Path) -> int:
    return main.main(["bags", "export", str(recorded), "--output", str(output)])


def rows_of(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


def numbers(rows: list[dict[str, str]], *names: str) -> np.ndarray:
    return np.array([[float(row[name]) for name in names] for row in rows])


def session(folder: Path, rollouts: int) -> Path:
    """A session of some rollouts, the second of which was punished."""
    candidates = [demonstrated_policy("flick-1", seed=1)]
    settings = preset("flip", budget=24, retests=3)
    with Session.begin(folder, settings, 5, candidates, context={"home": [0.0, 20.0]}) as session:
        practice = session.practice(ANY_ARM)
        for number in range(rollouts):
            trial = practice.next_trial()
            assert trial is not None
            outcome = toss(trial, practice.task.settings)
            fault = 'said "no",\r\nand stopped' if number == 2 else ""
            bag = f"rollout_{trial.id}"
            session.append(practice.learn_assessed(trial, outcome, fault=fault, bag=bag))
            if number == 1:
                session.append(practice.rate(-0.25))
    return folder


def test_the_file_restores_the_angles_of_a_bag_bit_for_bit(tmp_path: Path) -> None:
    file = tmp_path / "take.csv"
    assert export(SHIPPED, file) == 0
    rows, states = rows_of(file), reader.read_states(Bag(SHIPPED), WAM)
    q = numbers(rows, *(f"q.{name}" for name in WAM))
    assert q.tobytes() == np.ascontiguousarray(states.q).tobytes()  # the sign of zero, too
    assert [int(row["stamp_ns"]) for row in rows] == states.stamps.tolist()
    np.testing.assert_allclose(
        numbers(rows, "t")[:, 0], (states.stamps - states.stamps[0]) * 1e-9, atol=1e-12
    )


def test_the_tool_is_where_the_model_of_the_arm_has_it(tmp_path: Path) -> None:
    file = tmp_path / "take.csv"
    assert export(SHIPPED, file) == 0
    row, arm = rows_of(file)[400], overlay.setup().arm()
    assert arm is not None
    position, rotation = arm.tool_pose(numbers([row], *(f"q.{name}" for name in WAM))[0])
    np.testing.assert_array_equal(numbers([row], "tool.x", "tool.y", "tool.z")[0], position)
    quat = numbers([row], "tool.qx", "tool.qy", "tool.qz", "tool.qw")[0]
    np.testing.assert_allclose(rotations.matrix(quat), rotation, atol=1e-12)


def test_a_row_has_the_last_pose_of_the_body_and_poses_in_no_row_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "take.csv"
    assert export(SHIPPED, file) == 0
    assert "1 of 50 poses of pancake are in no row" in capsys.readouterr().out
    poses = {}
    for _, _, cdr in Bag(SHIPPED).messages(["/pancake/state"]):
        message = layout.decoded(cdr, "nav_msgs/msg/Odometry")
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        poses[stamp] = message.pose.pose
    rows = rows_of(file)
    assert len({row["body.pancake.stamp_ns"] for row in rows}) == 49
    for row in rows:
        last = max(stamp for stamp in poses if stamp <= int(row["stamp_ns"]))
        assert int(row["body.pancake.stamp_ns"]) == last
        assert float(row["body.pancake.z"]) == poses[last].position.z
        assert float(row["body.pancake.qw"]) == poses[last].orientation.w


def test_before_the_first_pose_of_a_body_its_cells_are_empty() -> None:
    stamps = np.array([0, 10**18])
    columns, _ = table.body_columns(Bag(SHIPPED), stamps)
    assert columns["body.pancake.stamp_ns"][0] is columns["body.pancake.x"][0] is None
    assert None not in (columns["body.pancake.stamp_ns"][1], columns["body.pancake.x"][1])


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


def test_a_driver_without_speeds_leaves_their_cells_empty(tmp_path: Path) -> None:
    taken = demonstration(tmp_path / "take", np.zeros((20, 7)), WAM)
    file = tmp_path / "take.csv"
    assert export(taken, file) == 0
    assert {row["qd.wam_j1"] + row["effort.wam_j7"] for row in rows_of(file)} == {""}


def test_a_bag_of_another_arm_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = overlay.setup(["cobot"]).arm()
    assert arm is not None
    writer = BagWriter(tmp_path / "theirs")
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    message = JointStateWriter(WAM)(START, np.zeros(7), (), ())
    writer.write("/joint_states", START, serialize_message(message))
    theirs = writer.close({"arm": to_json(arm.identity())})
    assert export(theirs, tmp_path / "take.csv") == 2
    assert "belongs to another arm" in capsys.readouterr().err
    assert not (tmp_path / "take.csv").exists()


def test_a_session_has_a_row_for_each_rollout_with_its_terms(tmp_path: Path) -> None:
    folder, file = session(tmp_path / "session", 5), tmp_path / "rollouts.csv"
    assert export(folder, file) == 0
    rows, records = rows_of(file), read(folder).records
    assert len(rows) == len(records) == 5
    for row, record in zip(rows, records, strict=True):
        assert (int(row["number"]), row["kind"]) == (record.number, record.kind)
        assert (row["demonstration"], row["bag"]) == (record.demonstration, record.bag)
        assert (row["fault"], row["why"]) == (record.fault, record.why)
        assert row["success"] == str(record.success)
        assert row["ret"] == ("" if record.ret is None else repr(record.ret))
        rated = record.rated_return
        assert row["rated_return"] == ("" if rated is None else repr(rated))
        terms = {name: "" if value is None else repr(value) for name, value in record.terms.items()}
        assert terms == {name: row[f"term.{name}"] for name in terms}
        for name, values in (("z", record.z), ("theta", record.theta)):
            assert (
                numbers([row], *(f"{name}.{i}" for i in range(len(values))))[0].tolist() == values
            )
    assert any(record.terms for record in records)
    assert rows[1]["ret"] != rows[1]["rated_return"]


def test_what_cannot_be_exported_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / "there.csv"
    there.write_text("precious")
    neither, empty = tmp_path / "neither", session(tmp_path / "empty", 0)
    neither.mkdir()
    for recorded, name, reason in (
        (SHIPPED, "take.xlsx", "take.xlsx must end in .csv"),
        (SHIPPED, "there.csv", "there.csv exists already"),
        (neither, "take.csv", f"{neither} is neither a session"),
        (empty, "take.csv", f"{empty} has no rollout yet"),
    ):
        assert export(recorded, tmp_path / name) == 2
        assert reason in capsys.readouterr().err
    assert there.read_text() == "precious"
    assert {path.name for path in tmp_path.iterdir()} == {"there.csv", "neither", "empty"}


def test_a_table_that_cannot_be_read_back_whole_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table.csv, "reader", lambda file: [["t"], ["0.0"]])
    with pytest.raises(OSError, match=r"take\.csv: 1 of 2 rows could be read back"):
        table.write({"t": [0.0, 1.0]}, tmp_path / "take.csv")
    assert list(tmp_path.iterdir()) == []
