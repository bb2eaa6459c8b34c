# SPDX-License-Identifier: Apache-2.0
"""Endurance run of all nodes in real time while recording: no memory growth, no lost states.

    python -m benchmark.soak [--seconds 600]

Stand-in, controller, tracker and recorder run at 500 Hz on the wall clock. In turn, the arm
executes a taught flip, is guided by the demonstrator under gravity compensation, and holds, all in
one recording. Resident memory and open files of every process are sampled. At the end the states in
the bag are compared with the numbers that the stand-in reports as published.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from benchmark.nodes import JOINTS, environment, taught
from wam_power_ros.bags import reader
from wam_power_ros.cli.processes import Processes, Running
from wam_power_ros.client.link import Link
from wam_power_ros.client.robot import Robot
from wam_power_ros.client.rollouts import RolloutSettings
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import ServiceError
from wam_power_ros.ros.domain import private_domain

NODES = ("wam_sim", "torque_controller", "pancake_tracker", "demonstration_recorder")
WARM_UP = 0.2  # share of the time before samples count
GROWTH_MAX = 0.01  # allowed growth, as a share of the memory
COUNT, STAMP = "states published", "stamp of the last [ns]"


@dataclass
class Samples:
    """Resident memory [bytes] and open descriptors of one process over time [s]."""

    t: list[float] = field(default_factory=list)
    memory: list[int] = field(default_factory=list)
    files: list[int] = field(default_factory=list)

    def add(self, t: float, pid: int) -> None:
        """Take a sample."""
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        self.t.append(t)
        self.memory.append(pages * os.sysconf("SC_PAGE_SIZE"))
        self.files.append(len(os.listdir(f"/proc/{pid}/fd")))

    def figures(self) -> dict[str, float]:
        """Figures after the warm-up; growth compares its last tenth with its first.

        The numbers of descriptors compared are the minima of both halves, because the middleware
        opens some for a moment.
        """
        t = np.array(self.t)
        after = t >= WARM_UP * t[-1]
        memory, files = np.array(self.memory)[after], np.array(self.files)[after]
        tenth, half = max(1, len(memory) // 10), len(files) // 2
        first, last = np.median(memory[:tenth]), np.median(memory[-tenth:])
        return {
            "memory [MB]": float(first) * 1e-6,
            "growth": float(last / first - 1.0),
            "largest": float(memory.max() / first - 1.0),
            "descriptors": int(np.median(files)),
            "descriptors change": int(files[half:].min() - files[: max(1, half)].min()),
        }


SETTINGS = RolloutSettings(
    scene_reset=True,
    reset_faults=True,  # faults occur on a busy machine
    record_rollouts=False,  # all is in one recording
    service_timeout=30.0,
    rollout_timeout=30.0,
    patience=60.0,
)


class Director:
    """Directs the arm and receives the diagnostics of the nodes.

    Attributes:
        published: Number of states that the stand-in has published, and stamp of the last one.
        counts: Activities by name.
        diagnostics: Last values of each node.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self.robot = Robot(link, body="pancake", settings=SETTINGS)
        self.published: list[tuple[int, int]] = []
        self.counts: Counter[str] = Counter()
        self.diagnostics: dict[str, dict[str, str]] = {}
        qos = interface.DIAGNOSTICS_QOS
        link.listen(DiagnosticArray, interface.DIAGNOSTICS, self._on_diagnostics, qos)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            self.diagnostics[status.name.partition(":")[0]] = values
            if status.name.startswith("wam_sim"):
                self.published.append((int(values[COUNT]), int(values[STAMP])))

    def await_hold(self) -> None:
        """Wait until the controller holds the arm.

        Raises:
            TimeoutError: It does not.
        """
        mode = lambda: self.diagnostics.get("torque_controller", {}).get("mode")  # noqa: E731
        if not self._link.until(lambda: mode() == "hold", timeout=120.0):
            raise TimeoutError(f"the controller does not hold: {mode()}")

    def rollout(self, policy: Policy) -> None:
        """Execute a policy; repeat if it fails."""
        while self.robot.rollout(policy).rollout.fault is not None:
            self.counts["rollouts broken off"] += 1
        self.counts["rollouts"] += 1

    def teach(self) -> None:
        """Let the demonstrator guide the arm under gravity compensation; repeat if it fails."""
        while True:
            try:
                with self.robot.guided():
                    self.robot.put_back()
                    self.robot.demonstrate()
            except ServiceError:  # after a fault the arm is no longer free
                self.robot.reset()
                self.counts["demonstrations broken off"] += 1
            else:
                self.counts["demonstrations"] += 1
                return

    def hold(self, seconds: float) -> None:
        """Let the arm hold for some time [s]."""
        self._link.sleep(seconds)
        self.counts["holds"] += 1


def start(processes: Processes, folder: Path) -> dict[str, Running]:
    """Start the nodes, with the stand-in in real time."""
    setup = overlay.setup((), simulated=True)
    setup["demonstration_recorder"]["directory"] = str(folder)
    setup["torque_controller"]["idle_service"] = (
        ""  # an idled arm would hang down until a person lifts it
    )
    file = folder / "parameters.yaml"
    file.write_text(overlay.text(setup))
    command = [sys.executable, "-m", "wam_power_ros.cli", "run"]
    given = ["--ros-args", "--params-file", str(file)]
    return {name: processes.start(name, [*command, name, *given]) for name in NODES}


def missing(stamps_ns: np.ndarray, published: list[tuple[int, int]]) -> tuple[int, int]:
    """Number of published states that are missing in the bag, and number of states compared."""
    inside = [item for item in published if stamps_ns[0] <= item[1] <= stamps_ns[-1]]
    lost = total = 0
    for (count, stamp_ns), (next_count, next_ns) in pairwise(inside):
        found = int(np.count_nonzero((stamps_ns > stamp_ns) & (stamps_ns <= next_ns)))
        lost += abs(next_count - count - found)
        total += next_count - count
    return lost, total


def soak(seconds: float, every: float, folder: Path) -> dict[str, object]:
    """Run for some time [s]; return the figures."""
    with private_domain() as domain:
        os.environ.update(environment(domain))
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        node = Node("director", context=context)
        samples = {name: Samples() for name in NODES}
        try:
            with (
                Processes(folder / "logs", environment(domain)) as processes,
                Link(node) as link,
            ):
                running, director, policy = start(processes, folder), Director(link), taught()
                director.await_hold()
                director.rollout(policy)  # warm-up
                director.teach()
                with director.robot.record() as path:
                    began = time.monotonic()

                    def look() -> None:
                        processes.check()
                        t = time.monotonic() - began
                        for name, process in running.items():
                            samples[name].add(t, process.process.pid)

                    looking = node.create_timer(every, look)
                    while time.monotonic() - began < seconds:
                        director.rollout(policy)
                        director.hold(1.0)
                        director.rollout(policy)
                        director.teach()
                    looking.cancel()
                link.sleep(1.5)  # for the last diagnostics
        finally:
            node.destroy_node()
            rclpy.shutdown(context=context)
    stamps_ns, _ = reader.read_demonstration(path, JOINTS)
    lost, total = missing(stamps_ns, director.published)
    reported = director.diagnostics
    return {
        "seconds": samples[NODES[0]].t[-1],
        "done": director.counts,
        "states": total,
        "lost": lost,
        "held up": int(reported["wam_sim"].get("clock held", 0)),
        "faults": int(reported["torque_controller"].get("faults", 0)),
        "scheduling": reported["torque_controller"].get("real-time scheduling", ""),
        "processes": {name: item.figures() for name, item in samples.items()},
    }


def text(figures: dict[str, object]) -> str:
    """Format the figures as text."""
    done = ", ".join(f"{count} {what}" for what, count in figures["done"].items())
    lines = [
        f"{figures['seconds']:.0f} s in real time, scheduling {figures['scheduling']}: {done}; "
        f"{figures['faults']} faults, stand-in delayed {figures['held up']} times",
        f"recorder: {figures['lost']} of {figures['states']} states lost",
        "                         memory [MB]   growth  largest   descriptors  change",
    ]
    for name, row in figures["processes"].items():
        lines.append(
            f"  {name:22s}{row['memory [MB]']:12.1f}{row['growth']:9.2%}{row['largest']:9.2%}"
            f"{row['descriptors']:14d}{row['descriptors change']:8d}"
        )
    return "\n".join(lines)


def broken(figures: dict[str, object]) -> list[str]:
    """Return a line for every violated bound."""
    found = []
    if figures["lost"] or not figures["states"]:
        found.append(f"{figures['lost']} of {figures['states']} states are not in the bag")
    for name, row in figures["processes"].items():
        if row["growth"] > GROWTH_MAX:
            found.append(f"{name} grew by {row['growth']:.2%}")
        if row["descriptors change"]:
            found.append(f"{name}: descriptors changed by {row['descriptors change']}")
    return found


def main() -> int:
    """Run and print the figures; return 1 if a bound is violated."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--every", type=float, default=2.0, help="time between two samples [s]")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = soak(options.seconds, options.every, Path(folder))
    print(text(figures))
    for line in broken(figures):
        print(f"WRONG: {line}")
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return int(bool(broken(figures)))


if __name__ == "__main__":
    sys.exit(main())
