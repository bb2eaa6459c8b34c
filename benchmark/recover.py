# SPDX-License-Identifier: Apache-2.0
"""Bags that were cut anywhere, and recorders that were killed: how much `wam-power recover` saves.

    python -m benchmark.recover [--cuts 200] [--kills 20] [--seed 0]

Cuts: a bag of 3 s, once never closed and once closed, is cut at so many places and recovered each
time. What comes back must begin as the whole does, hold every message of the chunks that are whole
(an independent reader, `mcap`, says which) and open in that reader again.

Kills: a recorder hears 500 states a second and is killed (-9) at a random moment, or its disk
refuses (a limit of the file's size); lost is the time from the last state in the recovered bag to
the last one sent before, and none may be missing among those that came back.
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
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from benchmark.kill import node
from wam_power_ros.bags import reader
from wam_power_ros.bags.reader import BagWriter, unfinished
from wam_power_ros.bags.recovery import recover
from wam_power_ros.cli.processes import Processes, Running, private_domain
from wam_power_ros.ros import interface

NAMES = [f"wam_j{number}" for number in range(1, 8)]
START = 1_700_000_000_000_000_000
FLUSH = 250  # states between two chunks, as the recorder does it at 500 Hz
PROMISE = 1.0  # [s] that a kill may cost


def write(path: Path, states: int, close: bool) -> Path:
    """A bag as the recorder writes it; its MCAP file."""
    make, serialize = reader.TYPES.types, reader.TYPES.serialize_cdr
    rng = np.random.default_rng(0)
    writer = BagWriter(path)
    writer.event("start", "demo", START, {"joint_names": str(NAMES).replace("'", '"')})
    writer.add(reader.STATES, reader.JOINT_STATE, [reader.qos(reliable=True, latched=False)])
    for index in range(states):
        stamp_ns = START + 2_000_000 * index
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        stamp = make["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        state = make[reader.JOINT_STATE](
            header=make["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
            name=NAMES,
            position=rng.normal(size=7),
            velocity=rng.normal(size=7),
            effort=rng.normal(size=7),
        )
        writer.write(reader.STATES, stamp_ns, bytes(serialize(state, reader.JOINT_STATE)))
        if index % FLUSH == FLUSH - 1:
            writer.flush()
    if close:
        return writer.close({"joint_names": "[]"}) / f"{path.name}.mcap"
    writer.abandon()
    return unfinished(path) / path.name / f"{path.name}.mcap"


def in_whole_chunks(file: Path) -> int:
    """Messages in the complete chunks of a file, by another reader."""
    count = 0
    with file.open("rb") as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True).records:
                if isinstance(record, Chunk):
                    count += sum(isinstance(inner, Message) for inner in breakup_chunk(record))
        except (EndOfFile, ValueError, struct.error):  # whichever the reader trips over first
            pass
    return count


def cut_everywhere(folder: Path, cuts: int, close: bool, rng: np.random.Generator) -> list[str]:
    """Cut a bag at `cuts` places, recover each; what was wrong."""
    file = write(folder / "demo", 6 * FLUSH, close)
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
            wrong.append(f"cut at {place}: something else came back")
        if len(back) < must:
            wrong.append(f"cut at {place}: {len(back)} messages of {must} in whole chunks")
        shutil.rmtree(path)
    return wrong


class Source(Node):
    """500 states a second by the wall clock, and the recorder's service."""

    def __init__(self, context: rclpy.Context) -> None:
        super().__init__("source", context=context)
        self._states = self.create_publisher(
            JointState, interface.JOINT_STATES, interface.STATE_OUT
        )
        self._write = interface.JointStateWriter(NAMES)
        self._record = self.create_client(SetBool, interface.RECORD)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self)
        self.sent = 0
        self.trouble = False
        self.create_subscription(
            DiagnosticArray, interface.DIAGNOSTICS, self._on_diagnostics, interface.DIAGNOSTICS_QOS
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.trouble |= "left unfinished" in str(message)

    def begin(self) -> Path:
        """Have a recording begun; its bag."""
        if not self._record.wait_for_service(60.0):
            raise RuntimeError("the recorder did not appear within 60 s")
        end = time.monotonic() + 60.0
        while self._states.get_subscription_count() == 0 and time.monotonic() < end:
            time.sleep(0.05)
        future = self._record.call_async(SetBool.Request(data=True))
        self._executor.spin_until_future_complete(future, 60.0)
        return Path(future.result().message)

    def send(self, seconds: float, enough: Callable[[], bool] = lambda: False) -> None:
        """Publish until the time is up or it is enough."""
        due = time.monotonic()
        end = due + seconds
        zero = np.zeros(7)
        while due < end and not enough():
            self._states.publish(self._write(START + 2_000_000 * self.sent, zero, zero, zero))
            self.sent += 1
            due += 0.002
            self._executor.spin_once(timeout_sec=max(0.0, due - time.monotonic()))


def lost(folder: Path, rng: np.random.Generator, full: bool) -> tuple[float, int]:
    """Seconds lost when a recorder is killed, or its disk is full, and states missing before."""
    with private_domain() as domain:
        environment = {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
        os.environ.update(environment)
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        command = node("demonstration_recorder", directory=str(folder))
        source = Source(context)
        try:
            with Processes(folder / "logs", environment) as processes:
                recorder = processes.start("demonstration_recorder", command)
                path = source.begin()
                source.send(1.0 + 2.0 * rng.random())
                if full:
                    _refuse_more(recorder, unfinished(path) / path.name / f"{path.name}.mcap")
                    source.send(30.0, lambda: source.trouble)
                else:
                    os.kill(recorder.process.pid, signal.SIGKILL)
                    recorder.process.wait()
        finally:
            source.destroy_node()
            rclpy.shutdown(context=context)
            os.environ.pop("ROS_DOMAIN_ID")
    stamps_ns, _ = reader.read_demonstration(recover(path).path, NAMES)
    missing = int((stamps_ns[-1] - stamps_ns[0]) // 2_000_000 + 1) - len(stamps_ns)
    return (START + 2_000_000 * (source.sent - 1) - int(stamps_ns[-1])) * 1e-9, missing


def _refuse_more(recorder: Running, file: Path) -> None:
    """Let the recorder's file grow no more than a little."""
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    limit = file.stat().st_size + 1000
    resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (limit, hard))


def main() -> int:
    """Cut and kill, and tell what came back."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cuts", type=int, default=200, help="places, of each kind of bag")
    parser.add_argument("--kills", type=int, default=20, help="and a quarter as many full disks")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        for close in (False, True):
            name = "closed" if close else "never closed"
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
                    wrong.append(f"{what} ({number}): {missing} states missing before")
            if losses:
                worst = f"worst {max(losses):.3f} s, median {np.median(losses):.3f} s"
                print(f"{what}: {count} times, lost at {worst}")
                wrong += [f"{what}: {loss:.3f} s lost" for loss in losses if loss > PROMISE]
    for line in wrong:
        print(f"WRONG: {line}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
