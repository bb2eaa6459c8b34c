# SPDX-License-Identifier: Apache-2.0
"""A bag played as topics, without those that move an arm."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import pytest
from bag_samples import NAMES, QOS, START, joint_state, random_q
from conftest import ROOT, Probe, Process, Processes
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from wam_power_ros.bags import layout
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import main
from wam_power_ros.console.play_bag import select_topics
from wam_power_ros.ros import interface

DEMONSTRATION = min((ROOT / "bags").glob("demo_*"))
REACH = min((ROOT / "bags").glob("reach_*"))
RECORDER = "wam_power_ros.nodes.demonstration_recorder"


def playing(processes: Processes, *arguments: object) -> Process:
    command = [sys.executable, "-m", "wam_power_ros.cli", "play", *map(str, arguments)]
    return processes.start(command)


def messages(path: Path, *topics: str) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = {topic: [] for topic in topics}
    for topic, _, cdr in Bag(path).messages(topics):
        found[topic].append(bytes(cdr))
    return found


def span(path: Path) -> int:
    """Time from the receipt of the first to that of the last joint state [ns]."""
    stamps = [stamp_ns for _, stamp_ns, _ in Bag(path).messages([layout.STATES])]
    return stamps[-1] - stamps[0]


def offered(path: Path) -> dict[str, set[tuple[str, str]]]:
    return {
        name: {(qos.reliability.name, qos.durability.name) for qos in topic.offered}
        for name, topic in Bag(path).topics.items()
    }


def test_a_played_demonstration_is_recorded_again_message_by_message(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    topics = [layout.STATES, "/pancake/pose", "/pancake/state", "/robot_description"]
    wanted = messages(DEMONSTRATION, *topics)
    assert min(len(found) for found in wanted.values()) >= 1
    processes.node(RECORDER, "demonstration_recorder.yaml", directory=tmp_path / "bags")
    said = probe.listen(DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS)
    answer = probe.call(SetBool, interface.RECORD, SetBool.Request(data=True))
    assert answer.success, answer.message
    player = playing(processes, DEMONSTRATION, "--rate", 0.5, "--wait", 60, "--topics", *topics)
    probe.until(lambda: player.poll() is not None, "the end of the bag", 120.0)
    assert player.returncode == 0, processes.output(player)
    count = len(wanted[layout.STATES])
    probe.until(
        lambda: f"{layout.STATES}', value='{count}'" in str(said[-1:]), "every state written"
    )
    answer = probe.call(SetBool, interface.RECORD, SetBool.Request(data=False))
    assert answer.success, answer.message
    again = Path(answer.message)
    assert messages(again, *topics) == wanted
    before = offered(DEMONSTRATION)
    assert offered(again) == {name: before[name] for name in (*topics, layout.EVENT)}
    assert span(again) > 1.3 * span(DEMONSTRATION)  # 2 without delays of a busy machine


def test_topics_that_command_or_enable_an_arm_are_never_played(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag")
    states = {"/a/joint_states": "heard", "/b/torques": "not", "/c/joint_commands": "not"}
    for topic in states:
        writer.add(topic, layout.JOINT_STATE, QOS)
    writer.add("/d/array", "std_msgs/msg/Float64MultiArray", QOS)
    writer.add("/e/trajectory", "trajectory_msgs/msg/JointTrajectory", QOS)
    writer.add(interface.ENABLE, "std_msgs/msg/Bool", QOS)
    state = joint_state(START, NAMES, random_q(1)[0])
    for topic in ("/a/joint_states", "/c/joint_commands"):
        writer.write(topic, START, state)
    torques = JointState(name=list(NAMES), effort=[1.0, 2.0, 3.0])
    writer.write("/b/torques", START, serialize_message(torques))
    path = writer.close({})
    topics, left_out = select_topics(Bag(path))
    assert list(topics) == ["/a/joint_states"]
    assert Counter(left_out.values()) == {"it commands an arm": 4, "it enables an arm": 1}
    with pytest.raises(ValueError, match="/b/torques: it commands an arm, which is never played"):
        select_topics(Bag(path), ["/a/joint_states", "/b/torques"])


def test_no_torque_is_played_and_no_topic_with_another_publisher(
    probe: Probe, processes: Processes
) -> None:
    probe.publisher(JointState, interface.JOINT_STATES, interface.STATE_OUT, readers=0)
    player = playing(processes, DEMONSTRATION, "--rate", 0.1)
    assert player.wait(120.0) == 2
    said = processes.output(player)
    assert f"not played: /{interface.EFFORT_COMMANDS}" in said
    assert "/joint_states is published by probe too" in said


def test_ctrl_c_ends_playback(probe: Probe, processes: Processes) -> None:
    heard = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_IN)
    player = playing(processes, REACH, "--rate", 0.01, "--topics", layout.STATES)
    probe.until(lambda: heard, "a state")
    assert processes.end(player) == 130
    assert "Traceback" not in processes.output(player)


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["none"], "is not a bag"),
        ([REACH, "--topics", "/no"], "no topic /no; it has /joint_states"),
        ([REACH, "--rate", "0"], "rate 0.0 must be positive"),
    ],
)
def test_an_invalid_request_is_refused_with_the_reason(
    capsys: pytest.CaptureFixture[str], arguments: list[object], why: str
) -> None:
    assert main.main(["play", *map(str, arguments)]) == 2
    assert why in capsys.readouterr().err


def test_a_type_that_is_not_installed_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        known = {"msgdef": "float64 x\n", "rihs01": f"RIHS01_{'0' * 64}"}
        connection = writer.add_connection("/thing", "lab_msgs/msg/Thing", **known)
        writer.write(connection, START, b"\0\1\0\0" + bytes(8))
    assert main.main(["play", str(tmp_path / "bag")]) == 2
    assert "/thing: type lab_msgs/msg/Thing is not installed" in capsys.readouterr().err
