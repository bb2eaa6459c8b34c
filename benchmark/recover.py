# SPDX-License-Identifier: Apache-2.0
"""Recovery of bags that were cut at random places, and data lost when a recorder is killed.

    python -m benchmark.recover [--cuts 200] [--kills 20] [--seed 0]

Cuts: a bag of 3 s, once unclosed and once closed, is cut at random places and recovered each time.
The recovered messages must be the first ones of the original, include every message of the complete
chunks (determined by an independent reader, `mcap`) and be readable by that reader.

Kills: a recorder receives 500 states a second and is killed (-9) at a random moment, or its disk is
full (simulated by a limit of the file size). The loss is the time from the last state in the
recovered bag to the last one sent; no earlier state may be missing.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from benchmark.nodes import JOINTS, environment, node_command
from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.layout import unfinished
from wam_power_ros.bags.recovery import recover
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli.processes import Processes, Running
from wam_power_ros.client.link import Link
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.domain import private_domain

START = 1_700_000_000_000_000_000  # [ns]
FLUSH_STATES = 250  # states in a chunk, as the recorder has at 500 Hz
LOSS_MAX = 1.0  # [s] allowed loss by a kill


def write(path: Path, states: int, close: bool) -> Path:
    """Write a bag as the recorder does; return its MCAP file."""
    state = joint_messages.JointStateWriter(JOINTS)
    rng = np.random.default_rng(0)
    writer = BagWriter(path)
    writer.event("start", "demo", START, {"joint_names": str(JOINTS).replace("'", '"')})
    writer.add(layout.STATES, layout.JOINT_STATE, [layout.qos(reliable=True, latched=False)])
    for index in range(states):
        stamp_ns = START + 2_000_000 * index
        writer.write(
            layout.STATES, stamp_ns, serialize_message(state(stamp_ns, *rng.normal(size=(3, 7))))
        )
        if index % FLUSH_STATES == FLUSH_STATES - 1:
            writer.flush()
    if close:
        return writer.close({"joint_names": "[]"}) / f"{path.name}.mcap"
    writer.abandon()
    return unfinished(path) / path.name / f"{path.name}.mcap"


def in_whole_chunks(file: Path) -> int:
    """Number of messages in the complete chunks of a file, by an independent reader."""
    count = 0
    with file.open("rb") as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True).records:
                if isinstance(record, Chunk):
                    count += sum(isinstance(inner, Message) for inner in breakup_chunk(record))
        except (EndOfFile, ValueError, struct.error):  # whichever the reader raises first
            pass
    return count


def cut_everywhere(folder: Path, cuts: int, close: bool, rng: np.random.Generator) -> list[str]:
    """Cut a bag at `cuts` places and recover each; return a line for every error."""
    file = write(folder / "demo", 6 * FLUSH_STATES, close)
    whole = file.read_bytes()
    reference = None
    wrong = []
    places = [len(whole), 0, 8, *rng.integers(0, len(whole), max(cuts - 3, 0)).tolist()]
    for place in places:
        file.write_bytes(whole[:place])
        must = in_whole_chunks(file) if place > 8 else 0
        try:
            path = recover(folder / "demo").path
            with (path / f"{path.name}.mcap").open("rb") as stream:
                reader = make_reader(stream)
                back = [message.data for _, _, message in reader.iter_messages()]
        except Exception as error:
            wrong.append(f"cut at {place}: {error!r}")
            shutil.rmtree(folder / "demo_recovered", ignore_errors=True)
            continue
        reference = back if reference is None else reference
        if back != reference[: len(back)]:
            wrong.append(f"cut at {place}: other messages were recovered")
        if len(back) < must:
            wrong.append(f"cut at {place}: {len(back)} messages of {must} in complete chunks")
        shutil.rmtree(path)
    return wrong


class Source(Node):
    """Publishes 500 states a second on the wall clock and calls the recorder."""

    def __init__(self, context: rclpy.Context) -> None:
        super().__init__("source", context=context)
        self._states = self.create_publisher(
            JointState, interface.JOINT_STATES, interface.STATE_OUT
        )
        self._write = joint_messages.JointStateWriter(JOINTS)
        self.link = Link(self)
        self.sent = 0
        self.unfinished = False
        qos = interface.DIAGNOSTICS_QOS
        self.link.listen(DiagnosticArray, interface.DIAGNOSTICS, self._on_diagnostics, qos)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.unfinished |= "left unfinished" in str(message)

    def begin(self) -> Path:
        """Start a recording; return its bag."""
        self.link.until(self._states.get_subscription_count)
        return Path(self.link.insist(interface.RECORD, True).text)

    def send(self, seconds: float, enough: Callable[[], bool] = lambda: False) -> None:
        """Publish for some time [s], or until `enough()` is true."""
        due = time.monotonic()
        end = due + seconds
        zero = np.zeros(7)
        while due < end and not enough():
            self._states.publish(self._write(START + 2_000_000 * self.sent, zero, zero, zero))
            self.sent += 1
            due += 0.002
            time.sleep(max(0.0, due - time.monotonic()))


def lost(folder: Path, rng: np.random.Generator, full: bool) -> tuple[float, int]:
    """Time lost by a killed recorder or a full disk [s], and number of earlier missing states."""
    with private_domain() as domain:
        os.environ.update(environment(domain))
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        command = node_command("demonstration_recorder", directory=str(folder))
        source = Source(context)
        try:
            with Processes(folder / "logs", environment(domain)) as processes, source.link:
                recorder = processes.start("demonstration_recorder", command)
                path = source.begin()
                source.send(1.0 + 2.0 * rng.random())
                if full:
                    _refuse_more(recorder, unfinished(path) / path.name / f"{path.name}.mcap")
                    source.send(30.0, lambda: source.unfinished)
                else:
                    os.kill(recorder.process.pid, signal.SIGKILL)
                    recorder.process.wait()
        finally:
            source.destroy_node()
            rclpy.shutdown(context=context)
            os.environ.pop("ROS_DOMAIN_ID")
    stamps_ns, _ = reader.read_demonstration(recover(path).path, JOINTS)
    missing = int((stamps_ns[-1] - stamps_ns[0]) // 2_000_000 + 1) - len(stamps_ns)
    return (START + 2_000_000 * (source.sent - 1) - int(stamps_ns[-1])) * 1e-9, missing


def _refuse_more(recorder: Running, file: Path) -> None:
    """Limit the recorder's file to slightly more than its present size."""
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    limit = file.stat().st_size + 1000
    resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (limit, hard))


def main() -> int:
    """Cut and kill; print the results; return 1 after an error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cuts", type=int, default=200, help="number of cuts of each kind of bag")
    parser.add_argument(
        "--kills", type=int, default=20, help="number of kills; a quarter as many full disks"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        for close in (False, True):
            name = "closed" if close else "unclosed"
            place = Path(folder) / name.replace(" ", "_")
            place.mkdir()
            found = cut_everywhere(place, options.cuts, close, rng)
            wrong += found
            print(f"{name}: cut at {options.cuts} places, {len(found)} wrong")
        for full, count in ((False, options.kills), (True, options.kills // 4)):
            what = "disk full" if full else "killed -9"
            losses = []
            for number in range(count):
                place = Path(folder) / f"{'full' if full else 'kill'}_{number}"
                loss, missing = lost(place, rng, full)
                losses.append(loss)
                if missing:
                    wrong.append(f"{what} ({number}): {missing} earlier states missing")
            if losses:
                worst = f"worst {max(losses):.3f} s, median {np.median(losses):.3f} s"
                print(f"{what}: {count} times, lost at {worst}")
                wrong += [f"{what}: {loss:.3f} s lost" for loss in losses if loss > LOSS_MAX]
    for line in wrong:
        print(f"WRONG: {line}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
