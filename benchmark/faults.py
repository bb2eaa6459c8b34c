# SPDX-License-Identifier: Apache-2.0
"""Fault injection: the requirements of docs/safety.md beside the worst result.

    python -m benchmark.faults [--rows stale kill ...] [--repeats 5] [--json FILE]

Every row runs real nodes in a private domain, with SCHED_FIFO if the machine permits it (`lab`).
`--repeats` replaces the default number of repeats of each row.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from std_msgs.msg import Float64MultiArray, String

from benchmark.false_states import FALSE_STATES, Reading
from benchmark.fuzz import bombard, spoilt, states
from benchmark.hidden_arm import StandIn
from benchmark.lab import ARM, WATCHER, Driver, Lab, RestingArm, inject, new_controller
from benchmark.loop import PHASES, stopped
from benchmark.nodes import HOME, JOINTS, ROOT, node_command, taught
from benchmark.terminal import options, table_head, table_row
from wam_power_ros.bags import reader
from wam_power_ros.bags.layout import unfinished
from wam_power_ros.bags.recovery import recover
from wam_power_ros.control.safety import REST_SPEED
from wam_power_ros.ros import interface, scheduling
from wam_power_ros.ros.requests import Request

Found = tuple[str, bool]  # worst result, and whether the requirement was met
Rng = np.random.Generator
SOFT = "tip at most 0.3 m/s, drop at most 5 cm"


class Case(NamedTuple):
    """A row of the table before it was run.

    Attributes:
        requirement: Id in docs/safety.md.
        text: Requirement that the row measures, for a person.
        run: Runs it in a lab, so many times.
        repeats: Usual number of repeats.
        priority: Real-time priority of this process; 0 for none, as busy processes would inherit.
    """

    requirement: str
    text: str
    run: Callable[[Lab, int, Rng], Found]
    repeats: int
    priority: int = 0


CASES: dict[str, Case] = {}


def case(
    name: str, requirement: str, text: str, repeats: int, priority: int = 0
) -> Callable[[Callable[..., Found]], Callable[..., Found]]:
    """Make a function a case; see `Case`."""

    def add(run: Callable[..., Found]) -> Callable[..., Found]:
        CASES[name] = Case(requirement, text, run, repeats, priority)
        return run

    return add


@case("stale", "S-41", "states stop: first torque without them within 8 ms of the last", 200, ARM)
def stale(lab: Lab, repeats: int, rng: Rng) -> Found:
    """States stop at a random moment of the period."""
    lab.controller()
    driver, first, latched = Driver(lab, RestingArm()), [], 0
    for _ in range(repeats):
        driver.held()
        driver.play(rng.uniform(0.02, 0.1))
        lab.spin(0.003, lambda: lab.torques[-1][1].stamp_ns == driver.stamp_ns)
        del lab.torques[:-1]
        lost, count = driver.published_ns, len(lab.torques)
        lab.spin(0.012, lambda count=count: len(lab.torques) > count)
        first.append((lab.torques[count][0] - lost) * 1e-6 if len(lab.torques) > count else 99.0)
        driver.stamp_ns += time.monotonic_ns() - lost
        driver.play(0.05)
        latched += lab.label == "fault"
    worst = f"{max(first):.1f} ms (median {np.median(first):.1f}); {latched} latched"
    return worst, max(first) <= 8.0


class Disturbed(NamedTuple):
    """What came of disturbances of the loop of the stand-in's arm, which can fall.

    Attributes:
        speed: Largest speed of the tool within 2 s [m/s].
        drop: Largest drop of the tool within 2 s [m].
        faults: Number of faults.
    """

    speed: float
    drop: float
    faults: int

    @property
    def soft(self) -> bool:
        """Whether the arm stayed slow and sank little."""
        return self.speed <= 0.3 and self.drop <= 0.05

    def __str__(self) -> str:
        return f"{self.speed:.3f} m/s, {100 * self.drop:.1f} cm; {self.faults} faults"


def disturbed(
    lab: Lab,
    repeats: int,
    rng: Rng,
    disturb: Callable[[], None],
    prepare: Callable[[], None] = lambda: None,
) -> Disturbed:
    """Disturb the loop of the stand-in's arm while it is held."""
    arm, speed, drop, faults = new_controller().arm, 0.0, 0.0, 0
    lab.stand_in()
    lab.wait(lambda: bool(lab.readings), "state of the stand-in")
    for _ in range(repeats):
        prepare()
        lab.held()
        lab.spin(rng.uniform(0.5, 1.0))
        lab.readings.clear()
        lab.wait(lambda: bool(lab.readings), "state")
        disturb()
        end_ns = lab.readings[0].stamp_ns + 2_000_000_000
        lab.wait(lambda: lab.readings[-1].stamp_ns > end_ns, "state at the end")  # noqa: B023
        faults += lab.label == "fault"
        heights = [arm.tool_pose(reading.q)[0][2] for reading in lab.readings[::5]]
        speed = max(speed, *(arm.speeds(r.q, r.qd).tool_speed for r in lab.readings[::5]))
        drop = max(drop, heights[0] - min(heights))
    return Disturbed(float(speed), float(drop), faults)


@case("kill", "S-06", f"controller killed (-9): {SOFT}", 50, WATCHER)
def kill(lab: Lab, repeats: int, rng: Rng) -> Found:
    """The controller is killed while it holds the arm."""
    ready, running = [], []

    def start() -> None:
        lab.torques.clear()
        begun = time.monotonic()
        running.append(lab.controller())
        lab.held()
        ready.append(time.monotonic() - begun)

    found = disturbed(lab, repeats, rng, lambda: lab.end(running.pop()), start)
    return f"{found}; holds again within {max(ready):.1f} s", found.soft


@case("stop", "S-52", f"controller stopped for 0.5 s: fault, {SOFT}", 20, WATCHER)
def paused(lab: Lab, repeats: int, rng: Rng) -> Found:
    """The controller is stopped for half a second (SIGSTOP) and continues."""
    controller = lab.controller()

    def pause() -> None:
        controller.process.send_signal(signal.SIGSTOP)
        lab.spin(0.5)
        controller.process.send_signal(signal.SIGCONT)
        lab.spin(2.0, lambda: lab.label == "fault")

    found = disturbed(lab, repeats, rng, pause)
    return str(found), found.soft and found.faults == repeats


@case(
    "intruder",
    "S-45",
    "second commander: fault within 2 s, discovery (0.3 to 1.9 s) included",
    10,
    ARM,
)
def intruder(lab: Lab, repeats: int, rng: Rng) -> Found:
    """A second publisher appears on the command topic."""
    lab.controller()
    driver, taken = Driver(lab, RestingArm()), []
    for _ in range(repeats):
        driver.held()
        driver.play(rng.uniform(1.0, 1.2))  # until the previous publisher is forgotten
        begun = time.monotonic()
        other = lab.node.create_publisher(
            Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND
        )
        driver.wait(lambda: lab.label == "fault", "fault")
        taken.append(time.monotonic() - begun)
        lab.node.destroy_publisher(other)
    return f"{max(taken):.2f} s (median {np.median(taken):.2f})", max(taken) <= 2.0


@case(
    "clock",
    "S-51",
    "stamps jump: fault, torques continue, change by at most 0.1 N m, reset",
    20,
    ARM,
)
def clock(lab: Lab, repeats: int, rng: Rng) -> Found:
    """The clock that stamps the states jumps by up to an hour, either way."""
    lab.controller()
    driver, worst, faults, silences = Driver(lab, RestingArm()), 0.0, 0, 0
    for _ in range(repeats):
        driver.held()
        driver.play(0.2)
        del lab.torques[:-1]
        held = lab.torques[-1][1].tau
        driver.stamp_ns += round(rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 3600.0) * 1e9)
        driver.play(0.3)
        after = [float(np.abs(torque.tau - held).max()) for _, torque in lab.torques[1:]]
        silences += len(after) < 100
        faults += lab.label == "fault"
        worst = max(worst, *after, 0.0)
        driver.held()
    found = f"{worst:.3f} N m, {faults} faults, {silences} silences"
    return found, worst <= 0.1 and faults == repeats and not silences


@case(
    "restart",
    "S-44",
    "driver killed and restarted: fault, tip at most 0.3 m/s, reset possible",
    5,
    WATCHER,
)
def restart(lab: Lab, repeats: int, rng: Rng) -> Found:
    """The driver is killed and restarted."""
    lab.controller()

    def begin_anew() -> None:
        lab.end(next(item for item in lab.processes._running if item.name == "wam_sim"))
        lab.spin(1.0)
        lab.readings.clear()
        lab.stand_in()
        lab.wait(lambda: len(lab.readings) > 500, "states after the restart")

    found = disturbed(lab, repeats, rng, begin_anew)
    return str(found), found.speed <= 0.3 and found.faults == repeats


@case(
    "fuzz",
    "S-01",
    "fuzzed messages: every torque finite, within limits of magnitude and rate",
    1000000,
)
def fuzz(lab: Lab, repeats: int, rng: Rng) -> Found:
    """Fuzzed messages are passed to conversion and controller, in this process."""
    found = bombard(new_controller(), taught(), repeats, int(rng.integers(2**32)))
    wrong = sum(found[kind] for kind in ("not finite", "over", "rate"))
    worst = (
        f"{wrong} of {found['torques']} torques; {found['refused']} refusals; "
        f"largest {100 * found['largest']:.0f} % of its limit"
    )
    return worst, wrong == 0


@case(
    "fuzz_dds",
    "S-11",
    "fuzzed messages over DDS: every torque within its limit; the node survives",
    10000,
    ARM,
)
def fuzz_over_dds(lab: Lab, repeats: int, rng: Rng) -> Found:
    """The same messages are sent to the node over DDS."""
    running, driver = lab.controller(), Driver(lab, RestingArm())
    driver.held()
    policies = lab.node.create_publisher(String, interface.CONTROLLER_REQUEST, interface.REQUESTS)
    limit = new_controller().limits.torque
    source, count, wrong = states(JOINTS, HOME, rng), 0, 0
    lab.link.wait_for(interface.RESET)
    for number in range(repeats):
        driver.states.publish(next(source))
        if number % 50 == 0:
            request = Request("move_to_start", {"policy": spoilt(driver.policy, rng)})
            policies.publish(request.message())
            lab.link.begin(interface.RESET)
        lab.spin(0.001)
        new, lab.torques = lab.torques, lab.torques[-1:]
        count += len(new) - 1
        wrong += sum(not (np.abs(torque.tau) <= limit).all() for _, torque in new)
    alive = running.process.poll() is None
    worst = f"{wrong} of {count} torques, {'alive' if alive else 'dead'}"
    return worst, wrong == 0 and alive


@case("network", "S-53", f"network cut for 1 s: fault until reset, {SOFT}", 5, WATCHER)
def network(lab: Lab, repeats: int, rng: Rng) -> Found:
    """The network between driver and controller is cut for a second; in a namespace, over UDP."""
    lab.controller()

    def cut() -> None:
        subprocess.run(["ip", "link", "set", "lo", "down"], check=True)
        lab.spin(1.0)
        subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
        subprocess.run(["ip", "route", "add", "224.0.0.0/4", "dev", "lo"], check=True)
        before = len(lab.readings)
        lab.wait(lambda: len(lab.readings) > before + 10, "states after the reconnection")

    found = disturbed(lab, repeats, rng, cut)
    return str(found), found.soft and found.faults == repeats


@case(
    "recorder", "S-65", "recorder killed (-9), or its disk full: at most one second lost", 50, ARM
)
def recorder(lab: Lab, repeats: int, rng: Rng) -> Found:
    """The recorder is killed, and at each fifth time its disk is full; its bag is recovered."""
    driver, stamps, reports = Driver(lab, RestingArm()), list[int](), list[str]()
    lost: dict[str, list[float]] = {"killed": [], "disk full": []}
    missing = 0

    def noted(state: Reading) -> Reading:
        stamps.append(state.stamp_ns)
        return state

    driver.falsify = noted
    lab.link.listen(
        DiagnosticArray,
        interface.DIAGNOSTICS,
        lambda message: reports.append(str(message)),
        interface.DIAGNOSTICS_QOS,
    )
    for number in range(repeats):
        folder = lab.folder / str(number)
        command = node_command("demonstration_recorder", directory=str(folder))
        running = lab.processes.start("demonstration_recorder", command)
        answer = None
        while answer is None:  # a request that went to the killed recorder alone is lost
            begun = lab.ask(interface.RECORD, True, timeout=10.0)
            driver.wait(begun.done, "recording")
            answer = begun.result()
        path = Path(answer.text)
        driver.play(rng.uniform(1.0, 3.0))
        full = number % 5 == 4
        if full:  # a limit of the file size stands for the size of the disk
            size = (unfinished(path) / path.name / f"{path.name}.mcap").stat().st_size + 1000
            hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
            resource.prlimit(running.process.pid, resource.RLIMIT_FSIZE, (size, hard))
            reports.clear()
            driver.wait(lambda: any("left unfinished" in each for each in reports), "refusal")
        lab.end(running)
        kept, _ = reader.read_demonstration(recover(path).path, JOINTS)
        missing += sum(kept[0] <= stamp <= kept[-1] for stamp in stamps) - len(kept)
        lost["disk full" if full else "killed"].append((stamps[-1] - int(kept[-1])) * 1e-9)
        stamps.clear()
    worst = [f"{what}: {max(each):.3f} s lost at worst" for what, each in lost.items() if each]
    latest = max(max(each, default=0.0) for each in lost.values())
    return f"{'; '.join(worst)}; {missing} earlier states missing", latest <= 1.0 and not missing


def false_states(lab: Lab, repeats: int, rng: Rng, name: str = "") -> Found:
    """False states in every phase, with an arm that keeps the last torque.

    Without a name, a second publisher repeats the states of the driver 6 ms late.
    """
    driver, relayed = Driver(lab, StandIn()), 0 if name else 3
    lab.controller()
    lines, passed = [], True
    for phase in PHASES:
        nominal = inject(driver, lab, phase, lambda state: state).peak
        for _ in range(repeats):
            falsify = FALSE_STATES[name]() if name else lambda state: state
            found = inject(driver, lab, phase, falsify, relayed)
            passed &= stopped(found, nominal) and (found.noticed is not None or not relayed)
            when = "none" if found.noticed is None else f"{2 * found.noticed} ms"
            speeds = f"{found.peak:.2f} ({nominal:.2f}), then {found.rest:.2f} m/s"
            lines.append(f"{phase} {when} {speeds}")
    return "; ".join(lines), passed


@case(
    "ended",
    "S-05",
    "ended or deactivated in a rollout: at rest 0.5 s later, last torque within 0.5 N m of g(q)",
    50,
    ARM,
)
def ended(lab: Lab, repeats: int, rng: Rng) -> Found:
    """The controller is ended or deactivated in a rollout; the arm keeps the last torque."""
    driver = Driver(lab, StandIn())
    off = Transition(id=Transition.TRANSITION_DEACTIVATE)
    rests, wrong = [], []
    for number in range(repeats):
        controller = lab.controller()
        driver.begin("early")
        driver.play(rng.uniform(0.0, 0.8))
        how = (signal.SIGTERM, signal.SIGINT, None)[number % 3]
        if how is None:
            lab.ask("/torque_controller/change_state", off)
        else:
            controller.process.send_signal(how)
        driver.play(0.5)
        driver.speeds.clear()
        driver.play(0.5)
        rests.append(max(driver.speeds))
        wrong.append(float(np.abs(lab.torques[-1][1].tau - driver.plant.gravity()).max()))
        lab.end(controller)
    good = max(rests) < REST_SPEED and max(wrong) < 0.5
    return f"{max(rests):.3f} m/s, {max(wrong):.2f} N m", good


FASTER = "tool at most 0.5 m/s faster than with true states, at rest 0.5 s after fault"
RELAYED = "states relayed 6 ms late: fault, at rest 0.5 s after it"
CASES["relay"] = Case("S-130", RELAYED, false_states, 1, ARM)
for _name in FALSE_STATES:
    _run = partial(false_states, name=_name)
    CASES[_name] = Case("S-91", f"{_name}: {FASTER}", _run, 1, ARM)


@dataclass(frozen=True)
class Row:
    """A row of the table in docs/safety.md."""

    requirement: str
    text: str
    worst: str
    repeats: int
    passed: bool


def alone(which: Case, scratch: Path, repeats: int, rng: Rng) -> Found | None:
    """Run a case in its own process, because priorities are not revocable; None on failure."""
    kept = scratch / "row.json"
    child = os.fork()
    if child == 0:
        try:
            if which.priority:
                scheduling._schedule(which.priority)
            with Lab(scratch).open() as lab:
                kept.write_text(json.dumps(which.run(lab, repeats, rng), default=bool))
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    return tuple(json.loads(kept.read_text())) if kept.exists() else None


def isolated(name: str, repeats: int, scratch: Path) -> Found | None:
    """Run a case in a network namespace, where the network can be cut; None on failure."""
    report = scratch / "isolated.json"
    inside = [sys.executable, "-m", "benchmark.faults", "--inside", "--rows", name]
    inside += ["--repeats", str(repeats), "--json", str(report)]
    up = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "
    environment = os.environ | {  # without shared memory, which a cut network would not stop
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    }
    command = ["unshare", "-n", "sh", "-c", up + " ".join(inside)]
    subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL)
    if not report.exists():
        return None
    found = json.loads(report.read_text())[0]
    return found["worst"], found["passed"]


def main() -> int:
    """Run the rows; return 1 if one fails."""
    given = options(__doc__, rows=[*CASES], repeats=0, seed=21, json=Path, inside=False)
    rows: list[Row] = []
    print(table_head("id", "requirement", "worst seen", "repeats", ""))
    for name in given.rows:
        chosen = CASES[name]
        repeats = given.repeats or chosen.repeats
        with tempfile.TemporaryDirectory() as scratch:
            if name == "network" and not given.inside:
                found = isolated(name, repeats, Path(scratch))
            else:
                rng = np.random.default_rng((given.seed, list(CASES).index(name)))
                found = alone(chosen, Path(scratch), repeats, rng)
        worst, passed = found or ("ended with an error", False)
        rows.append(Row(chosen.requirement, chosen.text, worst, repeats, passed))
        print(table_row(*astuple(rows[-1])[:-1], "pass" if passed else "**FAIL**"), flush=True)
        if given.json:
            given.json.write_text(json.dumps([asdict(each) for each in rows], indent=1) + "\n")
    return int(not all(each.passed for each in rows))


if __name__ == "__main__":
    sys.exit(main())
