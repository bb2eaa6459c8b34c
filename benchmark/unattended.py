# SPDX-License-Identifier: Apache-2.0
"""Practice without a hand in real time over DDS, disturbed: who had to help, and what was learnt.

    python -m benchmark.unattended [--task ball_in_cup] [--rollouts 200] [--every 20] [--seed 9260]

A demonstration is recorded with `wam-power learn`. Then every node runs for itself, as `ros2 run`
starts them, and nothing puts the body back between rollouts but the arm. After every so many
rollouts, at a random moment of the next one and in turn, the cameras are silent for a minute, the
driver is killed (-9) and started again, or the learner is. What a person does on an arm, the
benchmark does: it starts what was killed, and puts the body back when the learner says that a
person must. The learner itself resets the fault that a new driver leaves.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
import time
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2

from benchmark.kill import learning, lines
from benchmark.nodes import environment
from wam_power_ros.cli.processes import Processes, Running
from wam_power_ros.client.link import Link
from wam_power_ros.client.requests import Requests
from wam_power_ros.params import overlay
from wam_power_ros.practice import session
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import ServiceError
from wam_power_ros.ros.diagnostics import LEARNER_STATE
from wam_power_ros.ros.domain import private_domain

NODES = ("wam_sim", "torque_controller", "pancake_tracker", "demonstration_recorder")
SILENT = 60.0  # [s] of the cameras
AWAY = 5.0  # [s] from a kill to the next start
PATIENCE = 600.0  # [s] for a rollout
TOPICS = {"pose_topic": PoseStamped, "markers_topic": PointCloud2}  # of cameras and tracker
SEEN = "cameras/"  # before the name of a topic of the stand-in's cameras
AGAIN = 5.0  # [s] to the next time that a person puts the body back
DISTURBANCES = ("cameras", "driver", "learner")


def demonstrated(task: str, seed: int, folder: Path) -> list[str]:
    """Bags of a session that is stopped after its first rollout."""
    words = ["--task", task, "--seed", seed, "--demonstrations", "1"]
    process = learning(folder, *words)
    while not lines(folder) and process.poll() is None:
        time.sleep(0.05)
    process.terminate()
    process.wait()
    bags: list[str] = json.loads((folder / "demonstrations.json").read_text())
    return bags


class Room:
    """What surrounds the arm: cameras that may be silent, and a person who puts the body back.

    Attributes:
        silent: While it is set, no frame of the stand-in's cameras reaches the tracker.
    """

    def __init__(self, link: Link, setup: overlay.Setup, session: Path) -> None:
        self.silent = threading.Event()
        self._session, self._state, self._helped = session, "", -AGAIN
        self._scene = Requests(link, interface.SCENE_REQUEST, interface.SCENE_ANSWER)
        for key, kind in TOPICS.items():
            if name := setup["pancake_tracker"][key]:
                out = link.node.create_publisher(kind, name, interface.MOCAP)
                link.listen(kind, SEEN + name, partial(self._pass, out), interface.MOCAP)
        qos = interface.DIAGNOSTICS_QOS
        link.listen(DiagnosticArray, interface.DIAGNOSTICS, self._on_report, qos)

    def _on_report(self, message: DiagnosticArray) -> None:
        values = {each.key: each.value for status in message.status for each in status.values}
        self._state = values.get(LEARNER_STATE, self._state)

    def _pass(self, out: Publisher, frame: object) -> None:
        if not self.silent.is_set():
            out.publish(frame)

    def attend(self) -> None:
        """Put the body back if the learner says that it waits for that."""
        if self._state == "put back" and time.monotonic() > self._helped + AGAIN:
            self._helped = time.monotonic()
            policy = (self._session / "policy.json").read_text()
            try:
                self._scene.ask("reset", policy=policy)
                print("  a person puts the body back", flush=True)
            except ServiceError as error:
                print(f"  a person cannot put the body back: {error}", flush=True)


class Lab:
    """The nodes of a session, each in a process of its own."""

    def __init__(self, file: Path, domain: int) -> None:
        self._file, self._env = file, environment(domain)
        self._running: dict[str, tuple[Processes, Running]] = {}

    def start(self, name: str) -> None:
        """Start a node, again if it was killed."""
        words = ["run", name, "--ros-args", "--params-file", str(self._file)]
        processes = Processes(self._file.parent / "logs", self._env)
        command = [sys.executable, "-m", "wam_power_ros.cli", *words]
        self._running[name] = processes, processes.start(name, command)

    def kill(self, name: str) -> None:
        """Kill a node (-9), and start it again later."""
        process = self._running[name][1].process
        process.kill()
        process.wait()
        time.sleep(AWAY)
        self.start(name)

    def check(self) -> None:
        """Raise a `ProcessError` if a node has ended."""
        for processes, _ in self._running.values():
            processes.check()

    def stop(self) -> None:
        """End all nodes, last started first."""
        for processes, _ in reversed(self._running.values()):
            processes.stop()


def disturbed(lab: Lab, room: Room, folder: Path, options: argparse.Namespace) -> None:
    """Let a session run to its number of rollouts, disturbed; print what was done."""
    rng, took = np.random.default_rng(options.seed), 5.0  # [s] of a rollout and what is before it
    for number in range(options.rollouts // options.every + 1):
        begun, before = time.monotonic(), len(lines(folder))
        count = min((number + 1) * options.every, options.rollouts)
        while (found := len(lines(folder))) < count:
            end = time.monotonic() + PATIENCE
            while len(lines(folder)) == found:
                if time.monotonic() > end:
                    raise TimeoutError(f"no rollout after {found} in {PATIENCE:.0f} s")
                room.attend()
                lab.check()
                time.sleep(0.05)
        if count == options.rollouts:
            return
        took = (time.monotonic() - begun) / (count - before)
        time.sleep(rng.uniform(0.0, took))
        which = DISTURBANCES[number % len(DISTURBANCES)]
        print(f"  after {len(lines(folder))} rollouts: {which}", flush=True)
        if which == "cameras":
            room.silent.set()
            time.sleep(SILENT)
            room.silent.clear()
        else:
            lab.kill("wam_sim" if which == "driver" else "learner")


def report(folder: Path, count: int) -> str:
    """Who put the body back, in which time, and how many repetitions of the answer succeeded."""
    read = session.read(folder)
    goal, found = read.task.goal, list(read.records)[:count]
    resets = [record.clock.get("reset") or {"by": "nobody", "seconds": 0.0} for record in found]
    seconds = np.quantile([each["seconds"] for each in resets], (0.1, 0.5, 0.9)).round(1)
    known = [record for record in found if record.ret is not None]
    again = [record for record in known if record.kind == "retest"]
    pairs = [(each.truth, each.observation) for each in known if each.truth and each.observation]
    other = sum(truth[goal.true] != seen[goal.observed] for truth, seen in pairs)
    learnt = sum(record.kind != "retest" for record in found)
    lost = Counter(record.why or record.fault for record in found if record.ret is None)
    return "\n".join(
        [
            f"{len(found)} rollouts, {learnt} of them before the answer; put back by "
            f"{dict(Counter(each['by'] for each in resets))}, {seconds} s before a rollout",
            f"{sum(record.success for record in again)} of {len(again)} repetitions succeeded",
            f"{len(pairs)} with a ground truth, of which {other} differ in {goal.question!r}",
            f"{len(found) - len(known)} not learnt from: {dict(lost)}",
        ]
    )


def main() -> int:
    """Run a session and print its report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", default="ball_in_cup")
    parser.add_argument("--rollouts", type=int, default=200)
    parser.add_argument("--every", type=int, default=20, help="rollouts between disturbances")
    parser.add_argument("--seed", type=int, default=9260)
    parser.add_argument("--folder", type=Path, help="keep the session in this folder")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch, private_domain() as domain:
        folder = (options.folder or Path(scratch)).resolve()
        bags = demonstrated(options.task, options.seed, folder / "begun")
        setup = overlay.setup(["full_speed"], simulated=True, task=options.task)
        given = {key: setup["pancake_tracker"][key] for key in TOPICS}
        seen = {key: SEEN + name for key, name in given.items() if name}
        changes = json.dumps({"retests": options.rollouts})
        practice = {"session": str(folder / "session"), "demonstrations": bags, "changes": changes}
        setup = setup.changed(
            {
                "wam_sim": {"seed": options.seed},
                "optitrack_sim": dict.fromkeys(TOPICS, "") | seen,
                "demonstration_recorder": {"directory": str(folder / "session/bags")},
                "learner": {**practice, "scene_reset": False, "seed": options.seed},
            }
        )
        file = folder / "parameters.yaml"
        file.write_text(overlay.text(setup))
        lab = Lab(file, domain)
        os.environ |= environment(domain)
        rclpy.init()
        try:
            with Link(rclpy.create_node("room")) as link:
                room = Room(link, setup, folder / "session")
                for name in (*NODES, "learner"):
                    lab.start(name)
                disturbed(lab, room, folder / "session", options)
        finally:
            lab.stop()
            rclpy.shutdown()
        print(f"{options.task}, seed {options.seed}")
        print(report(folder / "session", options.rollouts))
    return 0


if __name__ == "__main__":
    sys.exit(main())
