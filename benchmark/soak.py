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
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path as RosPath
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from benchmark.nodes import JOINTS, environment
from wam_power_ros.bags import reader
from wam_power_ros.cli.processes import Processes, Running
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.learning.dmp import fit
from wam_power_ros.learning.policy import Policy, to_json
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code, read
from wam_power_ros.ros.domain import private_domain
from wam_power_ros.ros.service_client import DISCOVERY
from wam_power_ros.tasks.flip.settings import FLIP_FIT

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


class Director(Node):
    """Directs the arm and receives the diagnostics of the nodes."""

    def __init__(self, context: rclpy.Context) -> None:
        super().__init__("director", context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self)
        self.published: list[tuple[int, int]] = []  # number of states, stamp of the last one
        self.counts: dict[str, int] = {}  # activities by name
        self.diagnostics: dict[str, dict[str, str]] = {}
        self._paths: list[RosPath] = []
        self._asked: dict[str, Client] = {}
        self._between: Callable[[], None] = lambda: None
        self._policies = self.create_publisher(String, interface.POLICY, interface.LATCHED)
        self.create_subscription(
            DiagnosticArray, interface.DIAGNOSTICS, self._on_diagnostics, interface.DIAGNOSTICS_QOS
        )
        self.create_subscription(
            RosPath, interface.ROLLOUT_END_EFFECTOR, self._paths.append, interface.LATCHED
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            self.diagnostics[status.name.partition(":")[0]] = values
            if status.name.startswith("wam_sim"):
                self.published.append((int(values[COUNT]), int(values[STAMP])))

    @property
    def mode(self) -> str:
        """Mode of the controller, from its diagnostics."""
        return self.diagnostics.get("torque_controller", {}).get("mode", "")

    def attend(self, between: Callable[[], None]) -> None:
        """Set a function that is called between callbacks."""
        self._between = between

    def until(self, condition: Callable[[], bool], patience: float) -> bool:
        """Dispatch callbacks until a condition holds; return False after `patience` [s]."""
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.05)
            self._between()
        return True

    def wait(self, seconds: float) -> None:
        """Dispatch callbacks for some time [s]."""
        self.until(lambda: False, seconds)

    def call(self, kind: type, name: str, request: object = None, patience: float = 60.0) -> str:
        """Call a service until it succeeds; return the id of its policy, or its text.

        Raises:
            TimeoutError: If it does not succeed within `patience` [s].
        """
        why = "did not appear"
        end = time.monotonic() + patience
        while time.monotonic() < end:
            answer = self._ask(kind, name, request or kind.Request(), 60.0)
            if answer is not None:
                if answer.success:
                    return answer.values.get("policy", answer.text)
                why = f"refused: {answer.text}"
                if answer.code is Code.FAULT:  # faults occur on a busy machine
                    self._ask(Trigger, interface.RESET, Trigger.Request(), 5.0)
                    self._count("resets of a fault")
            self.wait(0.2)
        raise TimeoutError(f"{name} {why}")

    def _ask(self, kind: type, name: str, request: object, patience: float) -> Answer | None:
        """Response of a service; None if it is not found in 5 s or too late (`patience` [s])."""
        client = self._asked.get(name)
        if client is None:
            client = self._asked[name] = self.create_client(kind, name)
        if not client.service_is_ready():
            if not self.until(client.service_is_ready, 5.0):
                return None
            self.wait(DISCOVERY)
        future = client.call_async(request)
        if not self.until(future.done, patience):
            return None
        return read(future.result().success, future.result().message)

    def rollout(self, policy: Policy) -> None:
        """Move to the start, reset the pancake, execute, wait for the path; repeat if it fails."""
        while not self._rollout(policy):
            self._count("rollouts broken off")

    def _rollout(self, policy: Policy) -> bool:
        self._paths.clear()
        self._policies.publish(String(data=to_json(policy)))
        self.until(lambda: self.call(Trigger, interface.MOVE_TO_START) == policy.id, 60.0)
        try:
            self.call(Trigger, interface.body_topic("pancake", "reset"), patience=10.0)
            self.call(Trigger, interface.EXECUTE, patience=10.0)
        except TimeoutError:  # after a fault the arm is no longer at the start
            return False
        done = self.until(lambda: bool(self._paths), 30.0)
        self._count("rollouts")
        return done

    def teach(self) -> None:
        """Let the demonstrator guide the arm under gravity compensation; repeat if it fails."""
        while not self._teach():
            self._count("demonstrations broken off")

    def _teach(self) -> bool:
        self.call(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=True))
        try:
            self.call(Trigger, interface.body_topic("pancake", "reset"), patience=10.0)
            self.call(Trigger, interface.DEMONSTRATE, patience=10.0)
        except TimeoutError:  # after a fault the arm is no longer free
            return False
        self.call(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=False))
        self._count("demonstrations")
        return True

    def hold(self, seconds: float) -> None:
        """Let the arm hold for some time [s]."""
        self.wait(seconds)
        self._count("holds")

    def _count(self, what: str) -> None:
        self.counts[what] = self.counts.get(what, 0) + 1


def taught() -> Policy:
    """Policy fitted to the first shipped demonstration of the flip."""
    bag = min(share("bags").glob("demo_*"))
    arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
    return fit([from_joint_samples(arm, *reader.read_demonstration(bag, JOINTS))], FLIP_FIT, "soak")


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
        director = Director(context)
        samples = {name: Samples() for name in NODES}
        try:
            with Processes(folder / "logs", environment(domain)) as processes:
                running = start(processes, folder)
                policy = taught()
                director.until(lambda: director.mode == "hold", 120.0)
                director.rollout(policy)  # warm-up
                director.teach()
                path = Path(director.call(SetBool, interface.RECORD, SetBool.Request(data=True)))
                began = time.monotonic()

                def look() -> None:
                    t = time.monotonic() - began
                    if not samples[NODES[0]].t or t - samples[NODES[0]].t[-1] >= every:
                        processes.check()
                        for name, process in running.items():
                            samples[name].add(t, process.process.pid)

                director.attend(look)
                while time.monotonic() - began < seconds:
                    director.rollout(policy)
                    director.hold(1.0)
                    director.rollout(policy)
                    director.teach()
                director.attend(lambda: None)
                director.call(SetBool, interface.RECORD, SetBool.Request(data=False))
                director.wait(1.5)  # for the last diagnostics
        finally:
            director.destroy_node()
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
