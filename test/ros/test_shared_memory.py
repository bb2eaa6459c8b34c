# SPDX-License-Identifier: Apache-2.0
"""Shared memory of killed processes is removed, that of living processes is kept."""

from __future__ import annotations

import fcntl
import signal
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from conftest import Probe, Processes
from std_msgs.msg import String

from wam_power_ros.ros import interface, shared_memory
from wam_power_ros.ros.shared_memory import remove_dead_segments, remove_ports

SEGMENT = "fastrtps_0123456789abcdef"
TALK = """
from rclpy.node import Node
from std_msgs.msg import String
from wam_power_ros.ros import interface, node_runner
def make():
    node = Node("talker")
    node.words = node.create_publisher(String, "/words", interface.LATCHED)
    node.words.publish(String(data="here"))
    return node
node_runner.run(make)
"""


def test_a_segment_is_removed_when_nobody_holds_its_lock(tmp_path: Path) -> None:
    others = {"another_file", "fastrtps_port7411", "0123456789abcdef_el"}
    for name in (SEGMENT, f"{SEGMENT}_el", *others):
        (tmp_path / name).touch()
    with (tmp_path / f"{SEGMENT}_el").open() as owner:
        fcntl.flock(owner, fcntl.LOCK_EX)
        assert remove_dead_segments(tmp_path) == 0
        assert (tmp_path / SEGMENT).exists()
    assert remove_dead_segments(tmp_path) == 1
    assert {path.name for path in tmp_path.iterdir()} == others


def test_the_queue_of_a_port_is_removed_when_nobody_listens_there(tmp_path: Path) -> None:
    for port in (7411, 7413, 9000):
        (tmp_path / f"fastrtps_port{port}").touch()
        (tmp_path / f"sem.fastrtps_port{port}_mutex").touch()
    with (tmp_path / "fastrtps_port7413_el").open("w") as listener:
        fcntl.flock(listener, fcntl.LOCK_EX)
        remove_ports(range(7400, 7650), tmp_path)
    left = {path.name for path in tmp_path.iterdir()}
    kept = {
        f"{before}{port}{after}"
        for port in (7413, 9000)
        for before, after in (("fastrtps_port", ""), ("sem.fastrtps_port", "_mutex"))
    }
    assert left == kept | {"fastrtps_port7413_el"}


@pytest.mark.skipif(not shared_memory.FOLDER.is_dir(), reason="no /dev/shm")
def test_a_killed_node_s_segment_is_gone_when_another_node_starts(
    probe: Probe, processes: Processes
) -> None:
    words = probe.listen(String, "/words", interface.LATCHED)
    killed = processes.start([sys.executable, "-c", TALK])
    probe.until(lambda: words, "the first talker")
    locks = []
    for file in Path(f"/proc/{killed.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed by now
            if shared_memory.SEGMENT_LOCK.fullmatch(file.readlink().name):
                locks.append(file.readlink())
    assert locks
    processes.end(killed, signal.SIGKILL)
    words.clear()
    processes.start([sys.executable, "-c", TALK])
    probe.until(lambda: words, "the second talker")
    assert not any(lock.exists() for lock in locks)
