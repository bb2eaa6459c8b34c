# SPDX-License-Identifier: Apache-2.0
"""Latency from state to torque in real time: the controller compared with a bare echo node.

    python -m benchmark.latency [--seconds 60] [--load 0] [--messages] [--view]
                                 [--period 0.001]

The stand-in publishes 500 states a second, or one each --period, on the wall clock. The controller
answers each with a torque. The echo, a bare rclpy node in a separate process, answers with the same
message holding zeros. The stand-in's process times both, in the same run and with the same
scheduling, so machine and middleware cancel in the ratio. Each topic has one reader. --messages
counts the periods missed while the most difficult messages arrive (`messages`). With --view, the
page of `wam-power view` follows the arm during the measurement.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float64MultiArray

from benchmark import messages, viewing
from benchmark.nodes import JOINTS, PERIOD_NS, environment, ros_arguments
from wam_power_ros.cli.processes import Processes, Running
from wam_power_ros.ros import interface, joint_messages, node_runner, scheduling
from wam_power_ros.ros.domain import private_domain
from wam_power_ros.ros.stamps import nanoseconds

ECHO = "/echo/commands"
PRIORITY = {"stand-in": 70, "controller": 60, "echo": 60}


class Echo(Node):
    """The minimal node at 500 Hz: receives a message, sends a message."""

    def __init__(self, priority: int) -> None:
        super().__init__("echo")
        self._write = joint_messages.TorqueWriter(JOINTS, "multiarray")
        self._zero = np.zeros(len(JOINTS))
        self._out = self.create_publisher(Float64MultiArray, ECHO, interface.COMMAND)
        self.create_subscription(
            JointState, interface.JOINT_STATES, self._on_state, interface.STATE_IN
        )
        scheduling.request(priority)

    def _on_state(self, message: JointState) -> None:
        stamp_ns = nanoseconds(message.header.stamp)
        self._out.publish(self._write(stamp_ns, "echo", self._zero))


def stand_in(report: Path) -> int:
    """Run the stand-ins, time the answers to each state and write the times to `report`."""
    from hardware_sim.main import Simulation
    from hardware_sim.wam_node import WamSim

    sent: dict[int, int] = {}  # stamp -> time of publication [ns, steady clock]
    answered: dict[str, dict[int, int]] = {interface.EFFORT_COMMANDS: {}, ECHO: {}}

    def on_answer(topic: str, message: Float64MultiArray) -> None:
        now = time.monotonic_ns()
        stamp_ns = int(message.layout.dim[0].label.partition(" ")[0])
        answered[topic].setdefault(stamp_ns, now)

    take = WamSim._on_torque

    def taken(wam: WamSim, message: Float64MultiArray) -> None:
        on_answer(interface.EFFORT_COMMANDS, message)
        take(wam, message)

    WamSim._on_torque = taken  # a second subscription would slow down the controller's topic

    def make() -> Simulation:
        simulation = Simulation()
        publish = simulation.wam.publish

        def timed(message: JointState) -> None:
            sent[nanoseconds(message.header.stamp)] = time.monotonic_ns()
            publish(message)

        simulation.wam.publish = timed
        bad = messages.bad_state
        simulation.wam.create_subscription(
            Empty, messages.BAD_STATE, lambda _: publish(bad()), interface.COMMAND
        )
        simulation.wam.create_subscription(
            Float64MultiArray, ECHO, partial(on_answer, ECHO), interface.COMMAND
        )
        return simulation

    status = node_runner.run(make, spin=lambda simulation, ended: simulation.spin(ended))
    rows = [
        (at, *(times.get(stamp_ns, 0) for times in answered.values()))
        for stamp_ns, at in sent.items()
    ]
    np.save(report, np.array(rows, dtype=np.int64))  # (states, 3) [ns]
    return status


def measure(
    seconds: float,
    fifo: bool,
    load: int,
    hardest: bool = False,
    view: bool = False,
    period: float = PERIOD_NS * 1e-9,
) -> dict[str, dict[str, float]]:
    """Measure latencies of controller and echo in one run, and the CPU time of each process.

    Args:
        seconds: Duration of the measurement [s].
        fifo: Use SCHED_FIFO.
        load: Number of busy processes beside it.
        hardest: Publish the messages of `benchmark.messages` instead, and print the table.
        view: Let the page of `wam-power view` follow the arm.
        period: Time between two states [s].

    Returns:
        Per process: periods met [%], quantiles of the latency [us] or rate of the states [Hz],
        and CPU time [%].
    """
    module = [sys.executable, "-m"]
    with tempfile.TemporaryDirectory() as folder, private_domain() as domain:
        report = Path(folder) / "times.npy"
        priority = {name: value if fifo else 0 for name, value in PRIORITY.items()}
        with Processes(Path(folder), environment(domain)) as processes:
            arm = processes.start(
                "stand-in",
                [
                    *(*module, "benchmark.latency", "--role", str(report)),
                    *ros_arguments(
                        "wam_sim",
                        "optitrack_sim",
                        pace="real_time",
                        period=period,
                        realtime_priority=priority["stand-in"],
                    ),
                ],
            )
            controller = processes.start(
                "controller",
                [
                    *(*module, "wam_power_ros.nodes.torque_controller"),
                    *ros_arguments(
                        "torque_controller",
                        "simulation",
                        realtime_priority=priority["controller"],
                        period=period,
                    ),
                ],
            )
            echo = processes.start(
                "echo", [*module, "benchmark.latency", "--role", f"echo {priority['echo']}"]
            )
            published = Path(folder) / "messages.json"
            if hardest:
                processes.start(
                    "messages",
                    [*module, "benchmark.latency", "--role", f"messages {published}"],
                )
            lock = viewing.start(processes, Path(folder), domain, list(JOINTS)) if view else None
            for i in range(load):
                processes.start(f"load {i}", [sys.executable, "-c", "while True: pass"])
            time.sleep(10.0)  # for imports and discovery
            begun_ns, before = time.monotonic_ns(), _cpu([arm, controller, echo])
            if hardest:
                while not published.exists():
                    processes.check()
                    time.sleep(0.5)
            else:
                time.sleep(seconds)
            ended_ns, after = time.monotonic_ns(), _cpu([arm, controller, echo])
            processes.check()
            if lock is not None:
                lock.close()
        rows = np.load(report)
        if hardest:
            print(messages.table(rows, json.loads(published.read_text())))
    rows = rows[(rows[:, 0] >= begun_ns) & (rows[:, 0] < ended_ns)]
    seconds = (ended_ns - begun_ns) * 1e-9
    cpu = {name: 100.0 * (after[name] - before[name]) / seconds for name in after}
    return {
        "controller": {**_figures(rows, 1, period), "cpu": cpu["controller"]},
        "echo": {**_figures(rows, 2, period), "cpu": cpu["echo"]},
        "stand-in": {"rate": len(rows) / seconds, "cpu": cpu["stand-in"]},
    }


def _figures(rows: np.ndarray, column: int, period: float) -> dict[str, float]:
    """Periods met [%] and quantiles of the latency [us]; a lost answer counts as missed."""
    answered = rows[rows[:, column] > 0]
    latency = (answered[:, column] - answered[:, 0]) * 1e-3
    met = 100.0 * np.count_nonzero(latency <= period * 1e6) / max(len(rows), 1)
    quantiles = np.percentile(latency, [50.0, 99.0, 99.9]) if len(latency) else np.full(3, np.nan)
    return {"met": met, **dict(zip(("p50", "p99", "p99.9"), quantiles.tolist(), strict=True))}


def _cpu(running: list[Running]) -> dict[str, float]:
    """CPU time used by each process so far [s]."""
    tick = os.sysconf("SC_CLK_TCK")
    times = {}
    for item in running:
        fields = Path(f"/proc/{item.process.pid}/stat").read_text().rpartition(")")[2].split()
        times[item.name] = (int(fields[11]) + int(fields[12])) / tick
    return times


def may_schedule() -> bool:
    """Return True if SCHED_FIFO is permitted on this machine."""
    ask = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(70))"
    return subprocess.run([sys.executable, "-c", ask], capture_output=True).returncode == 0


def table(title: str, figures: dict[str, dict[str, float]]) -> str:
    """Format the figures of one run as text."""
    controller, echo, arm = figures["controller"], figures["echo"], figures["stand-in"]
    lines = [
        f"{title} (stand-in: {arm['rate']:.1f} states/s, {arm['cpu']:.0f} % CPU)",
        "              periods met   p50 [us]   p99 [us]   p99.9 [us]   CPU [%]",
    ]
    for name, row in (("controller", controller), ("echo", echo)):
        lines.append(
            f"  {name:12s}{row['met']:9.2f} %{row['p50']:11.0f}{row['p99']:11.0f}"
            f"{row['p99.9']:13.0f}{row['cpu']:10.1f}"
        )
    ratio = [controller[key] / echo[key] for key in ("p50", "p99", "p99.9", "cpu")]
    lines.append(
        f"  {'ratio':12s}{'':11s}{ratio[0]:11.2f}{ratio[1]:11.2f}{ratio[2]:13.2f}{ratio[3]:10.2f}"
    )
    return "\n".join(lines)


def main() -> int:
    """Measure with and without SCHED_FIFO."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of each run [s]")
    parser.add_argument("--load", type=int, default=0, help="number of busy processes")
    parser.add_argument(
        "--messages",
        action="store_true",
        help="also count periods missed during difficult messages",
    )
    parser.add_argument(
        "--view", action="store_true", help="with the page of `wam-power view` following the arm"
    )
    parser.add_argument(
        "--period", type=float, default=PERIOD_NS * 1e-9, help="between two states [s]"
    )
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--role", help=argparse.SUPPRESS)
    options, _ = parser.parse_known_args()
    if options.role:
        role, _, priority = options.role.partition(" ")
        if role == "messages":
            return messages.publish(Path(priority))
        if role == "echo":
            return node_runner.run(lambda: Echo(int(priority)))
        return stand_in(Path(options.role))
    results = {}
    for title, fifo in (("SCHED_FIFO", True), ("plain scheduling", False)):
        if fifo and not may_schedule():
            print(f"{title}: skipped, not permitted here (rtprio in /etc/security/limits.d)")
            continue
        results[title] = measure(
            options.seconds, fifo, options.load, view=options.view, period=options.period
        )
        print(table(title, results[title]))
        if options.messages:
            measure(0.0, fifo, options.load, hardest=True)
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
