# SPDX-License-Identifier: Apache-2.0
"""The NatNet client over real DDS, against a stand-in for Motive on the loopback.

Its packets are built here by the fields of NatNetTypes.h of the SDK, not by the client's library.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import Probe, Processes
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry

from wam_power_ros import rotations
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, pose_messages

pytest.importorskip("natnet")

TICKS = 10_000_000  # per second, of the server's clock
LATENCY, RATE = 0.05, 100.0  # [s], [Hz]
NAMES = {7: "spatula", 3_000_000: "pancake"}
CONNECT, SERVER, DESCRIBE, DESCRIPTION, FRAME, KEEP_ALIVE = 0, 1, 4, 5, 7, 10


def truth(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] and quaternion xyzw of the pancake at a time [s]."""
    place = np.array([0.6 + 0.1 * np.sin(3.0 * t), 0.1 * np.cos(1.3 * t), 0.5])
    return place, rotations.quat_of_vector(np.array([0.0, 0.8 * np.sin(2.0 * t), 0.3]))


class Motive(threading.Thread):
    """A server that streams to whom keeps it alive, as Motive in the mode Unicast."""

    def __init__(self, version: tuple[int, int], port: int = 0) -> None:
        super().__init__(daemon=True)
        self.version, self.valid, self.names, self.latency = version, True, dict(NAMES), LATENCY
        self.exposed: dict[bytes, float] = {}  # wall time by position
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self.port = self._socket.getsockname()[1]
        self._end = threading.Event()
        self.start()

    def run(self) -> None:
        """Serve until the end."""
        clients: dict[tuple[str, int], float] = {}
        number = 0
        begun = time.monotonic()
        while not self._end.is_set():
            number += 1
            while (left := begun + number / RATE - time.monotonic()) > 0.0:
                self._socket.settimeout(left)
                try:
                    request, client = self._socket.recvfrom(1024)
                except OSError:
                    break
                clients[client] = time.monotonic()
                kind = struct.unpack_from("<H", request)[0]
                if kind == CONNECT:
                    self._send(SERVER, self._server(), client)
                elif kind == DESCRIBE:
                    self._send(DESCRIPTION, self._descriptions(), client)
            frame = self._frame(number)
            for client, last in clients.items():
                if time.monotonic() - last < 5.0:
                    self._send(FRAME, frame, client)
        self._socket.close()

    def end(self) -> None:
        """Stop serving, and free the port."""
        self._end.set()
        self.join()

    def _send(self, kind: int, payload: bytes, to: tuple[str, int]) -> None:
        self._socket.sendto(struct.pack("<HH", kind, len(payload)) + payload, to)

    def _server(self) -> bytes:
        name = b"Motive".ljust(256, b"\0")
        info = name + bytes([*self.version, 0, 0]) * 2
        return info + struct.pack("<QH?4s", TICKS, 1511, False, bytes(4))

    def _sized(self, payload: bytes) -> bytes:
        """With its size in front, as since 4.1."""
        return struct.pack("<I", len(payload)) + payload if self.version >= (4, 1) else payload

    def _descriptions(self) -> bytes:
        found = struct.pack("<I", len(self.names))
        for number, name in self.names.items():
            body = name.encode() + b"\0" + struct.pack("<Ii3f", number, -1, 0.0, 0.0, 0.0)
            body += struct.pack("<4f", 0.0, 0.0, 0.0, 1.0) * (self.version >= (4, 2))
            body += struct.pack("<I", 0)  # markers
            found += struct.pack("<I", 1) + self._sized(body)
        return found

    def _frame(self, number: int) -> bytes:
        sent = time.monotonic()
        exposed = sent - self.latency
        bodies = b""
        for id, name in self.names.items():
            at = time.time() - self.latency
            place, quat = truth(at)
            self.exposed[place.astype(np.float32).tobytes()] = at
            place = place if name == "pancake" else -place
            pose = (*place, *quat) if self.valid else (0.0,) * 7
            bodies += struct.pack("<I7ffH", id, *pose, 0.0002, int(self.valid))
        none = struct.pack("<I", 0) + self._sized(b"")
        frame = struct.pack("<I", number) + none * 2  # marker sets, markers
        frame += struct.pack("<I", len(self.names)) + self._sized(bodies)
        after = 5 if self.version >= (4, 1) else 4  # skeletons, assets, markers, plates, devices
        frame += none * after
        stamps = (int(at * TICKS) for at in (exposed, exposed + 0.001, sent))
        frame += struct.pack("<IId3Q", 0, 0, number / RATE, *stamps)
        frame += struct.pack("<II", 0, 0) * (self.version >= (4, 1))  # stamps of PTP
        return frame + struct.pack("<HI", 0, 0)


@pytest.fixture(params=[(3, 1), (4, 2)], ids=lambda v: f"NatNet {v[0]}.{v[1]}")
def motive(request: pytest.FixtureRequest) -> Iterator[Motive]:
    made = Motive(request.param)
    yield made
    made.end()


def parameters(folder: Path, port: int) -> Path:
    file = folder / "lab.yaml"
    file.write_text(
        "pancake_tracker: {ros__parameters: {rate: 100.0, latency_offset: 0.0}}\n"
        f"natnet_client: {{ros__parameters: {{multicast: false, command_port: {port}}}}}\n"
    )
    given = folder / "parameters.yaml"
    given.write_text(overlay.text(overlay.setup([str(file)])))
    return given


def test_frames_become_poses_and_states_stamped_at_the_exposure(
    motive: Motive, probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    given = parameters(tmp_path, motive.port)
    poses = probe.listen(PoseStamped, "pancake/pose", interface.DEEP)
    states = probe.listen(Odometry, "pancake/state", interface.DEEP)
    reports = probe.diagnostics()
    processes.node("wam_power_ros.nodes.natnet_client", given)
    processes.node("wam_power_ros.nodes.body_tracker", given)
    probe.until(lambda: len(states) > 200, "states")
    late = []
    for message in poses:
        reading = pose_messages.pose(message)
        assert message.header.frame_id == "world"
        exposed = motive.exposed[reading.position.astype(np.float32).tobytes()]
        turn = rotations.matrix(reading.quat_xyzw) - rotations.matrix(truth(exposed)[1])
        assert np.linalg.norm(turn) < 1e-5
        late.append(reading.stamp_ns * 1e-9 - exposed)
    assert min(late) > -1e-3  # two clocks
    assert min(late) < 0.5 * LATENCY  # the rest is this machine's
    for state in map(pose_messages.odometry, states[100:]):
        assert np.linalg.norm(state.position - truth(state.stamp_ns * 1e-9)[0]) < 0.05

    def said(words: str) -> bool:
        return any(words in str(r.status) for r in reports if "NatNet" in str(r.status))

    probe.until(lambda: said("value='0.0500'"), "the latency")
    probe.until(lambda: said("spatula, pancake"), "the rigid bodies")


def test_what_is_not_seen_or_not_known_is_not_published_but_said(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    motive = Motive((4, 0))
    poses = probe.listen(PoseStamped, "pancake/pose", interface.DEEP)
    reports = probe.diagnostics()
    processes.node("wam_power_ros.nodes.natnet_client", parameters(tmp_path, motive.port))

    def said(words: str) -> bool:
        probe.spin(0.1)
        found = [status for report in reports for status in report.status]
        reports.clear()
        return any("NatNet" in status.name and words in str(status) for status in found)

    def silent() -> bool:
        probe.spin(0.3)
        poses.clear()
        probe.spin(0.5)
        return not poses

    probe.until(lambda: poses, "poses")
    motive.valid = False
    assert silent()
    assert probe.until(lambda: said("message='0 of "), "no pose")
    motive.valid, motive.latency = True, 2.0
    assert silent()
    assert probe.until(lambda: said("a latency of 2.0"), "the latency")
    motive.latency, motive.names = LATENCY, {3_000_000: "flounder"}
    assert probe.until(lambda: said("value='flounder'"), "the new name")
    assert silent()
    motive.names = dict(NAMES)
    port = motive.port
    motive.end()
    assert silent()
    assert probe.until(lambda: said("127.0.0.1: timed out"), "no answer")
    again = Motive((4, 0), port)  # Motive was started again
    poses.clear()
    probe.until(lambda: poses, "poses again")
    again.end()
