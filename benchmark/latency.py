# SPDX-License-Identifier: Apache-2.0
"""Latency from state to torque in real time: the controller compared with a bare echo node.

    python -m benchmark.latency [--seconds 60] [--load 0] [--period 0.001]

The stand-in publishes 500 states a second, or one each --period, on the wall clock. The controller
answers each with a torque. The echo, a bare rclpy node in a separate process, answers with the same
message holding zeros. The stand-in's process times both, in the same run and with the same
scheduling, so machine and middleware cancel in the ratio. Each topic has one reader. With --load,
as many busy processes run beside it.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from benchmark.nodes import JOINTS, PERIOD_NS, environment, ros_arguments
from benchmark.terminal import options, table_head, table_row
from wam_power_ros.cli.processes import Processes
from wam_power_ros.ros import interface, joint_messages, node_runner, scheduling
from wam_power_ros.ros.domain import private_domain
from wam_power_ros.ros.stamps import nanoseconds

ECHO = "/echo/commands"
MODULE = [sys.executable, "-m"]
ROLE = "--role"  # of a process that this script starts
KEYS = ("p50", "p99", "p99.9")  # columns of the table
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
    from hardware_sim.arm_node import ArmSim
    from hardware_sim.main import Simulation

    sent: dict[int, int] = {}  # stamp -> time of publication [ns, steady clock]
    answered: dict[str, dict[int, int]] = {interface.EFFORT_COMMANDS: {}, ECHO: {}}

    def on_answer(topic: str, message: Float64MultiArray) -> None:
        now = time.monotonic_ns()
        stamp_ns = int(message.layout.dim[0].label.partition(" ")[0])
        answered[topic].setdefault(stamp_ns, now)

    take = ArmSim._on_torque

    def taken(wam: ArmSim, message: Float64MultiArray) -> None:
        on_answer(interface.EFFORT_COMMANDS, message)
        take(wam, message)

    ArmSim._on_torque = taken  # a second subscription would slow down the controller's topic

    def make() -> Simulation:
        simulation = Simulation()
        publish = simulation.wam.publish

        def timed(message: JointState) -> None:
            sent[nanoseconds(message.header.stamp)] = time.monotonic_ns()
            publish(message)

        simulation.wam.publish = timed
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


def measure(seconds: float, fifo: bool, load: int, period: float) -> dict[str, dict[str, float]]:
    """Periods met [%] and quantiles of the latency [us] of controller and echo in one run."""
    own = [*MODULE, "benchmark.latency", ROLE]
    with tempfile.TemporaryDirectory() as folder, private_domain() as domain:
        report = Path(folder) / "times.npy"
        priority = {name: value if fifo else 0 for name, value in PRIORITY.items()}
        of_arm = {"period": period, "realtime_priority": priority["stand-in"]}
        of_loop = {"period": period, "realtime_priority": priority["controller"]}
        arm_words = ros_arguments("wam_sim", "optitrack_sim", pace="real_time", **of_arm)
        words = ros_arguments("torque_controller", "simulation", **of_loop)
        with Processes(Path(folder), environment(domain)) as processes:
            start, loop = processes.start, [*MODULE, "wam_power_ros.entry", "torque_controller"]
            start("stand-in", [*own, str(report), *arm_words])
            start("controller", [*loop, *words])
            start("echo", [*own, f"echo {priority['echo']}"])
            for i in range(load):
                start(f"load {i}", [sys.executable, "-c", "while True: pass"])
            time.sleep(10.0)  # for imports and discovery
            begun_ns = time.monotonic_ns()
            time.sleep(seconds)
            ended_ns = time.monotonic_ns()
            processes.check()
        rows = np.load(report)
    rows = rows[(rows[:, 0] >= begun_ns) & (rows[:, 0] < ended_ns)]
    return {name: _figures(rows, k, period) for k, name in enumerate(("controller", "echo"), 1)}


def _figures(rows: np.ndarray, column: int, period: float) -> dict[str, float]:
    """Periods met [%] and quantiles of the latency [us]; a lost answer counts as missed."""
    answered = rows[rows[:, column] > 0]
    latency = (answered[:, column] - answered[:, 0]) * 1e-3
    met = 100.0 * np.count_nonzero(latency <= period * 1e6) / max(len(rows), 1)
    quantiles = np.percentile(latency, [50.0, 99.0, 99.9]) if len(latency) else np.full(3, np.nan)
    return {"states": len(rows), "met": met, **dict(zip(KEYS, quantiles.tolist(), strict=True))}


def may_schedule() -> bool:
    """Return True if SCHED_FIFO is permitted on this machine."""
    ask = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(70))"
    return subprocess.run([sys.executable, "-c", ask], capture_output=True).returncode == 0


def print_table(title: str, figures: dict[str, dict[str, float]]) -> None:
    """Print the figures of one run, and the ratio of controller and echo."""
    print(f"{title} ({figures['echo']['states']:.0f} states)")
    print(table_head("", "periods met [%]", *(f"{key} [us]" for key in KEYS)))
    for name, each in figures.items():
        print(table_row(name, f"{each['met']:.2f}", *(f"{each[key]:.0f}" for key in KEYS)))
    ratios = (figures["controller"][key] / figures["echo"][key] for key in KEYS)
    print(table_row("ratio", "", *(f"{ratio:.2f}" for ratio in ratios)), flush=True)


def main() -> int:
    """Measure with and without SCHED_FIFO."""
    if ROLE in sys.argv:
        role, _, value = sys.argv[sys.argv.index(ROLE) + 1].partition(" ")
        if role == "echo":
            return node_runner.run(lambda: Echo(int(value)))
        return stand_in(Path(role))
    period = PERIOD_NS * 1e-9
    given = options(__doc__, seconds=60.0, load=0, period=period)
    for title, fifo in (("SCHED_FIFO", True), ("plain scheduling", False)):
        if fifo and not may_schedule():
            print(f"{title}: skipped, not permitted here (rtprio in /etc/security/limits.d)")
            continue
        found = measure(given.seconds, fifo, given.load, given.period)
        print_table(title, found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
