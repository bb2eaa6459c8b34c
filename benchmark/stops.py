# SPDX-License-Identifier: Apache-2.0
"""A person ends the movements of a session, in each phase and by each means: what moves after it?

    python -m benchmark.stops [--pace real_time] [--kill NODE]
    python -m benchmark.stops --phases retest --means page     # a phase that ends the session

Every node runs for itself, as `ros2 run` starts them, and the arm puts the ball back between the
rollouts, so that a session has every phase: move, replay, wait, rollout and re-test. After each
stop nothing may begin, and the arm may not move, until the person continues; a node that is killed
(-9) and started again meanwhile changes nothing. At the end no policy may have run after a person
had stopped it.
"""

from __future__ import annotations

import itertools
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from sensor_msgs.msg import JointState

from benchmark.kill import learning, lines
from benchmark.nodes import environment
from benchmark.terminal import options
from wam_power_interfaces.action import ExecutePolicy, MoveToStart, Replay
from wam_power_interfaces.srv import Pause
from wam_power_ros.cli.processes import Processes
from wam_power_ros.client.feedback import Feedback
from wam_power_ros.client.link import Link
from wam_power_ros.params import overlay
from wam_power_ros.practice import session
from wam_power_ros.ros import interface
from wam_power_ros.ros.diagnostics import LEARNER_STATE
from wam_power_ros.ros.domain import private_domain
from wam_power_ros.view.live import View

NODES = ("wam_sim", "torque_controller", "pancake_tracker", "demonstration_recorder")
AWAY = 5.0  # [s] from a kill to the next start
PHASES = ("move_to_start", "replay", "wait", "execute", "retest")  # the last one ends a session
MEANS = ("service", "page", "key", "gravity compensation", "deactivation")
WAITS = ("rest", "put back")  # states of a session
REPORT = 0.2  # [s] in which a report that is under way has come
QUIET = 3.0  # [s] in which nothing may move
COAST = 0.5  # [s] in which a stopped arm comes to rest
STILL = 0.02  # [rad] by which an arm that is held, or that nobody touches, may move meanwhile
PATIENCE = 400.0  # [s] for a phase to come
CHANGE = "torque_controller/change_state"


def demonstrated(task: str, seed: int, folder: Path) -> list[str]:
    """Bags of a session that is stopped after its first rollout."""
    process = learning(folder, "--task", task, "--seed", seed, "--demonstrations", "1")
    while not lines(folder) and process.poll() is None:
        time.sleep(0.05)
    process.terminate()
    process.wait()
    bags: list[str] = json.loads((folder / "demonstrations.json").read_text())
    return bags


def start(processes: Processes, name: str, file: Path) -> None:
    """Start a node with the parameters of a file."""
    words = ["run", name, "--ros-args", "--params-file", str(file)]
    processes.start(name, [sys.executable, "-m", "wam_power_ros.cli", *words])


def restart(processes: Processes, name: str, file: Path) -> None:
    """Kill a node (-9), and start it again later."""
    running = next(each for each in processes._running if each.name == name)
    running.process.kill()
    running.process.wait()
    processes._running.remove(running)
    time.sleep(AWAY)
    start(processes, name, file)


class Person:
    """Person beside the arm: sees what begins and ends it.

    Attributes:
        begun: What the controller has begun, oldest first.
        state: What the learner has said of the session last, "" before.
    """

    def __init__(
        self,
        link: Link,
        view: View,
        keys: Feedback,
        state: str,
        check: Callable[[], None],
    ) -> None:
        self._check = check
        self.link, self.state = link, ""
        self.begun: list[str] = []
        self.view, self._keys = view, keys
        self._take, self._q = link.newest(JointState, state), np.zeros(0)
        listen = link.listen
        for do, kind, name in (
            ("move_to_start", MoveToStart, interface.MOVE_TO_START),
            ("execute", ExecutePolicy, interface.EXECUTE_POLICY),
            ("replay", Replay, interface.REPLAY_MOVEMENT),
        ):
            feedback, begun = kind.Impl.FeedbackMessage, partial(self._on_begin, do)
            listen(feedback, f"{name}/_action/feedback", begun, interface.STATE_OUT)
        qos = interface.DIAGNOSTICS_QOS
        listen(DiagnosticArray, interface.DIAGNOSTICS, self._on_report, qos)

    def _on_begin(self, do: str, _: object) -> None:
        self.begun.append(do)

    def _on_report(self, message: DiagnosticArray) -> None:
        values = {each.key: each.value for status in message.status for each in status.values}
        self.state = values.get(LEARNER_STATE, self.state)

    def await_phase(self, phase: str, retest_due: Callable[[], bool]) -> None:
        """Wait for the begin of a phase of the session."""
        do = "execute" if phase == "retest" else phase

        def begun() -> bool:
            if phase == "wait":
                return self.state in WAITS
            return do in self.begun[seen:]

        if phase == "retest":
            self.expect(retest_due, phase)
        seen = len(self.begun)
        self.expect(begun, phase)

    def expect(self, condition: Callable[[], object], what: str) -> None:
        """Wait for a condition.

        Raises:
            TimeoutError: It did not come true.
        """
        end = time.monotonic() + PATIENCE
        while not self.link.until(condition, timeout=1.0) and time.monotonic() < end:
            self._check()
        if time.monotonic() > end:
            raise TimeoutError(f"no {what} in {PATIENCE:.0f} s; the session says {self.state!r}")

    def end(self, means: str) -> None:
        """End what moves, or keep it from beginning."""
        if means == "service":
            self.link.call(interface.STOP)
        elif means == "page":
            self.view.give("stop")
        elif means == "key":
            self._keys.give("stop")
        elif means == "gravity compensation":
            self.link.call(interface.GRAVITY_COMPENSATION, True)
        else:
            self.link.call(CHANGE, Transition(id=Transition.TRANSITION_DEACTIVATE))

    def go_on(self, means: str) -> None:
        """Make the arm ready again, and continue."""
        if means == "deactivation":
            self.link.call(CHANGE, Transition(id=Transition.TRANSITION_ACTIVATE))
        self.link.insist(interface.LEARNER_PAUSE, Pause.Request(pause=False))
        self.state = ""  # the last report is out of date
        self.link.sleep(REPORT)
        self.state = ""

    def moved(self) -> float:
        """Largest way of a joint in `QUIET`, after it has come to rest [rad]."""
        self.link.sleep(COAST)
        begun, way, end = self._look(), 0.0, time.monotonic() + QUIET
        while time.monotonic() < end:
            self.link.sleep(0.05)
            way = max(way, float(np.abs(self._look() - begun).max()))
        return way

    def _look(self) -> np.ndarray:
        if (message := self._take()) is not None:
            self._q = np.array(message.position)
        return self._q


@contextmanager
def person(setup: overlay.Setup, check: Callable[[], None]) -> Iterator[Person]:
    """A person in the domain of this process."""
    state = setup["torque_controller"]["state_topic"]
    make = rclpy.create_node
    with Link(make("person")) as link, Link(make("feedback")) as keys:
        view = View(setup["torque_controller"], setup["pancake_tracker"]["body"])
        link.prepare(interface.STOP)
        link.prepare(interface.GRAVITY_COMPENSATION, data=True)
        link.prepare(interface.LEARNER_PAUSE, data=Pause.Request())
        link.prepare(CHANGE, data=Transition())
        with view.link:
            yield Person(link, view, Feedback(keys), state, check)


def run_again(folder: Path) -> list[str]:
    """Rollouts of policies that a person had stopped before."""
    refused: set[tuple[str, tuple[float, ...]]] = set()
    again = []
    for record in session.read(folder).records:
        policy = record.demonstration, tuple(record.z)
        again += [record.id] if policy in refused else []
        refused |= {policy} if record.refused else set()
    return again


def measure(
    who: Person, folder: Path, cells: list[tuple[str, str]], kill: Callable[[], None] | None
) -> int:
    """End the session in each of the cells; print what came of it, return the number of faults."""
    budget, wrong = session.read(folder).header.settings.practice.budget, 0

    def retest_due() -> bool:
        return sum(record.ret is not None for record in session.read(folder).records) >= budget

    who.await_phase("execute", bool)
    for name in (interface.STOP, interface.GRAVITY_COMPENSATION, CHANGE):
        who.link.offers(name)  # so that no stop waits for the discovery
    who.view.link.offers(interface.STOP)
    who.expect(lambda: session.read(folder).records, "rollout")
    for phase, means in cells:
        who.await_phase(phase, retest_due)
        who.end(means)
        before = len(who.begun)
        if phase == "retest":
            who.link.sleep(2.0)
        else:
            who.expect(lambda: who.state == "paused", "pause")
        way = who.moved()
        if kill and phase != "retest":
            who.state = ""
            kill()
            who.expect(lambda: who.state == "paused", "pause after the kill")
            way = max(way, who.moved())
        begun = who.begun[before:]
        good = not begun and way < STILL
        wrong += not good
        said = "nothing moved" if good else f"began {begun}, moved by {way:.3f} rad"
        print(f"  {phase:14} {means:22} {said}", flush=True)
        if phase != "retest":
            who.go_on(means)
    return wrong


def main() -> int:
    """Measure, and print every cell."""
    given = options(
        __doc__,
        pace=("lockstep", "real_time"),
        kill=("", "learner", *NODES),
        seed=9300,
        phases=[*PHASES],
        means=[*MEANS],
    )
    phases = [each for each in given.phases if each != "retest" or given.phases == ["retest"]]
    cells = [*itertools.product(phases, given.means)]
    with private_domain() as domain:
        folder = Path(tempfile.mkdtemp())  # stays, to be looked at
        bags = demonstrated("ball_in_cup", given.seed, folder / "begun")
        names = ["full_speed"] + ["unattended"] * (given.pace == "lockstep")
        setup = overlay.setup(names, simulated=True, task="ball_in_cup")
        changes = json.dumps({"retests": 3, "budget": len(cells) + 6, "confirm": 0})
        practice = {"session": str(folder / "session"), "demonstrations": bags, "changes": changes}
        setup = setup.changed(
            {
                "wam_sim": {"seed": given.seed},
                "torque_controller": {"hold_to_run": False},
                "demonstration_recorder": {"directory": str(folder / "session/bags")},
                "learner": {**practice, "scene_reset": False, "seed": given.seed},
            }
        )
        file = folder / "parameters.yaml"
        file.write_text(overlay.text(setup))
        os.environ |= environment(domain)
        rclpy.init()
        try:
            with (
                Processes(folder / "logs", environment(domain)) as processes,
                person(setup, processes.check) as who,
            ):
                for name in (*NODES, "learner"):
                    start(processes, name, file)
                kill = partial(restart, processes, given.kill, file) if given.kill else None
                who.expect(lambda: session.Session.exists(folder / "session"), "session")
                wrong = measure(who, folder / "session", cells, kill)
        finally:
            rclpy.try_shutdown()
        again = run_again(folder / "session")
        refused = sum(record.refused for record in session.read(folder / "session").records)
    print(f"{given.pace}, kill {given.kill or 'nothing'}: {len(cells)} stops")
    print(f"{wrong} of them followed by a movement; {refused} policies refused, run again: {again}")
    return int(bool(wrong or again))


if __name__ == "__main__":
    sys.exit(main())
