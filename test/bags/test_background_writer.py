# SPDX-License-Identifier: Apache-2.0
"""Recording in a thread: the disk never delays the subscriber."""

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from bag_samples import NAMES, QOS, START, joint_state, random_q

from wam_power_ros.bags import background_writer, layout, reader, writer
from wam_power_ros.bags.background_writer import Recording
from wam_power_ros.bags.recovery import recover


class Disk:
    """Replacement of fsync that a test can block or let fail."""

    def __init__(self) -> None:
        self.free, self.asked = threading.Event(), threading.Event()
        self.error: OSError | None = None
        self._fsync = os.fsync

    def __call__(self, handle: int) -> None:
        """Wait for the release, then flush or raise; `asked` is set while it waits."""
        if not self.free.is_set():
            self.asked.set()
            assert self.free.wait(60.0)
        if self.error is not None:
            raise self.error
        self._fsync(handle)

    def hang(self) -> None:
        """Block from now on; returns when the writer waits."""
        self.asked.clear()
        self.free.clear()
        assert self.asked.wait(60.0)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    """Disk that hangs until it is released."""
    disk = Disk()
    monkeypatch.setattr(writer.os, "fsync", disk)
    monkeypatch.setattr(background_writer, "WRITE_PERIOD", 0.01)
    yield disk
    disk.free.set()


def begun(folder: Path) -> Recording:
    recorded = Recording(folder / "demo", "demo", {"joint_names": "[]"})
    recorded.add("/joint_states", layout.JOINT_STATE, QOS)
    return recorded


def feed(recorded: Recording, q: np.ndarray, first: int = 0) -> None:
    for index, row in enumerate(q, first):
        recorded.write("/joint_states", joint_state(START + 2_000_000 * index, NAMES, row))


def feed_and_write(recorded: Recording, disk: Disk, q: np.ndarray) -> None:
    """Feed states and wait until they are written."""
    disk.free.set()
    feed(recorded, q)
    deadline = time.monotonic() + 60.0
    while recorded.counts.get("/joint_states") != len(q):
        assert time.monotonic() < deadline, recorded.counts
        time.sleep(0.01)


def test_a_disk_that_hangs_holds_nobody_up_and_costs_nothing(tmp_path: Path, disk: Disk) -> None:
    recorded, q = begun(tmp_path), random_q(3000)
    feed(recorded, q[:100])
    assert disk.asked.wait(60.0)
    feed(recorded, q[100:], 100)  # if this waited for the disk, it would wait for good
    assert recorded.waiting >= 2900
    disk.free.set()
    recorded.close("asked to", {})
    np.testing.assert_array_equal(reader.read_demonstration(recorded.path, NAMES)[1], q)


def test_a_disk_that_hangs_for_too_long_is_given_up(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(background_writer, "WAITING_MAX", 500)
    recorded, q = begun(tmp_path), random_q(1000)
    feed_and_write(recorded, disk, q[:100])
    disk.hang()
    feed(recorded, q[100:], 100)
    assert "too slow" in str(recorded.error)
    assert recorded.waiting <= 500
    disk.free.set()
    with pytest.raises(OSError, match="too slow"):
        recorded.close("asked to", {})
    back = reader.read_demonstration(recover(recorded.path).path, NAMES)[1]
    assert len(back) >= 100
    np.testing.assert_array_equal(back, q[: len(back)])


def test_a_disk_that_refuses_ends_the_recording_and_what_it_took_is_kept(
    tmp_path: Path, disk: Disk
) -> None:
    recorded, q = begun(tmp_path), random_q(200)
    feed_and_write(recorded, disk, q[:100])
    disk.error = OSError(28, "No space left on device")
    feed(recorded, q[100:], 100)
    with pytest.raises(OSError, match="No space left"):
        recorded.close("asked to", {})
    assert not recorded.path.exists()
    disk.error = None
    back = reader.read_demonstration(recover(recorded.path).path, NAMES)[1]
    assert len(back) >= 100
    np.testing.assert_array_equal(back, q[: len(back)])
