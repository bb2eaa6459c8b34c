# SPDX-License-Identifier: Apache-2.0
"""Fault injection: the requirements of docs/safety.md beside the worst result.

    python -m benchmark.faults [--rows stale kill ...] [--repeats 5] [--json FILE]

Every row runs real nodes in a private domain, with SCHED_FIFO if the machine permits it (`lab`).
`--repeats` replaces the default number of repeats of each row. The rows `learner`, `recorder` and
`disk` run `benchmark.kill`, `benchmark.recover` and the test of a full disk.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from lifecycle_msgs.msg import Transition
from std_msgs.msg import Float64MultiArray

from benchmark.false_states import Driver, inject
from benchmark.fuzz import bombard, spoilt, states
from benchmark.lab import ARM, WATCHER, Lab, new_controller
from benchmark.lies import FALSE_STATES
from benchmark.loop import PHASES, Outcome, stopped
from benchmark.nodes import HOME, JOINTS, ROOT, environment
from wam_power_ros.control.safety import REST_SPEED
from wam_power_ros.learning.policy import Basis, Policy
from wam_power_ros.ros import interface, scheduling
from wam_power_ros.ros.requests import Request
from wam_power_ros.rotations import quat_xyzw


@dataclass(frozen=True)
class Row:
    """One row of the table in docs/safety.md."""

    requirement: str
    text: str
    worst: str
    repeats: int
    passed: bool


def stale(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """States stop at a random moment of the period."""
    lab.controller()
    first, latched = [], 0
    for _ in range(repeats):
        lab.played()
        lab.play(rng.uniform(0.02, 0.1))
        lab.spin(0.003, lambda: lab.torques[-1][1].stamp_ns == lab.stamp_ns)
        del lab.torques[:-1]
        lost, count = lab.published_ns, len(lab.torques)
        lab.spin(0.012, lambda count=count: len(lab.torques) > count)
        first.append((lab.torques[count][0] - lost) * 1e-6 if len(lab.torques) > count else 99.0)
        lab.stamp_ns += time.monotonic_ns() - lost
        lab.play(0.05)
        latched += lab.label == "fault"
    return Row(
        "S-41",
        "states stop: first torque without them within 8 ms of the last",
        f"{max(first):.1f} ms (median {np.median(first):.1f}); {latched} latched",
        repeats,
        max(first) <= 8.0,
    )


def disturbed(
    lab: Lab,
    repeats: int,
    rng: np.random.Generator,
    disturb: Callable[[], None],
    prepare: Callable[[], None] = lambda: None,
) -> tuple[float, float, int]:
    """Disturb the loop of the stand-in's arm, which can fall, while it is held.

    Returns:
        Largest tip speed [m/s] and drop [m] within 2 s, and the number of faults.
    """
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
    return speed, drop, faults


def kill(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The controller is killed while it holds the arm."""
    ready, running = [], []

    def start() -> None:
        lab.torques.clear()
        begun = time.monotonic()
        running.append(lab.controller())
        lab.held()
        ready.append(time.monotonic() - begun)

    speed, drop, _ = disturbed(lab, repeats, rng, lambda: lab.end(running.pop()), start)
    return Row(
        "S-06",
        "controller killed (-9): tip at most 0.3 m/s, drop at most 5 cm",
        f"{speed:.3f} m/s, {100 * drop:.1f} cm; holds again within {max(ready):.1f} s",
        repeats,
        bool(speed <= 0.3 and drop <= 0.05),
    )


def paused(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The controller is stopped for half a second (SIGSTOP) and continues."""
    controller = lab.controller()

    def pause() -> None:
        controller.process.send_signal(signal.SIGSTOP)
        lab.spin(0.5)
        controller.process.send_signal(signal.SIGCONT)
        lab.spin(2.0, lambda: lab.label == "fault")

    speed, drop, faults = disturbed(lab, repeats, rng, pause)
    return Row(
        "S-52",
        "controller stopped for 0.5 s: fault, tip at most 0.3 m/s, drop at most 5 cm",
        f"{speed:.3f} m/s, {100 * drop:.1f} cm; {faults} faults",
        repeats,
        bool(speed <= 0.3 and drop <= 0.05 and faults == repeats),
    )


def intruder(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """A second publisher appears on the command topic."""
    lab.controller()
    taken = []
    for _ in range(repeats):
        lab.played()
        lab.play(rng.uniform(1.0, 1.2))  # until the previous publisher is forgotten
        begun = time.monotonic()
        other = lab.node.create_publisher(
            Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND
        )
        lab.wait(lambda: lab.label == "fault", "fault", play=True)
        taken.append(time.monotonic() - begun)
        lab.node.destroy_publisher(other)
    return Row(
        "S-45",
        "second commander: fault within 2 s of its start, discovery (0.3 to 1.9 s) included",
        f"{max(taken):.2f} s (median {np.median(taken):.2f})",
        repeats,
        max(taken) <= 2.0,
    )


def clock(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The clock that stamps the states jumps by up to an hour, either way."""
    lab.controller()
    worst, faults, silences = 0.0, 0, 0
    for _ in range(repeats):
        lab.played()
        lab.play(0.2)
        del lab.torques[:-1]
        count, held = len(lab.torques), lab.torques[-1][1].tau
        jump = rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 3600.0)
        lab.stamp_ns += round(jump * 1e9)
        lab.play(0.3)
        silences += len(lab.torques) - count < 100
        faults += lab.label == "fault"
        worst = max(
            worst, *(float(np.abs(t.tau - held).max()) for _, t in lab.torques[count:]), 0.0
        )
        lab.played()
    return Row(
        "S-51",
        "stamps jump by up to an hour: fault, torques continue, change by at most 0.1 N m, reset",
        f"{worst:.3f} N m, {faults} faults, {silences} silences",
        repeats,
        worst <= 0.1 and faults == repeats and not silences,
    )


def restart(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The driver is killed and restarted."""
    lab.controller()

    def begin_anew() -> None:
        lab.end(next(item for item in lab.processes._running if item.name == "wam_sim"))
        lab.spin(1.0)
        lab.readings.clear()
        lab.stand_in()
        lab.wait(lambda: len(lab.readings) > 500, "states after the restart")

    speed, _, faults = disturbed(lab, repeats, rng, begin_anew)
    return Row(
        "S-44",
        "driver killed and restarted: fault, tip at most 0.3 m/s, reset possible",
        f"{speed:.3f} m/s, {faults} faults",
        repeats,
        bool(speed <= 0.3 and faults == repeats),
    )


def fuzz_policy() -> Policy:
    """Valid policy that keeps the pan in place, for corruption."""
    arm = new_controller().arm
    position, rotation = arm.tool_pose(HOME)
    return Policy(
        id="fuzz",
        basis=Basis(count=4, duration=0.4, variance=0.004),
        stiffness=np.tile(300.0 * np.eye(3), (4, 1, 1)),
        attractors=np.tile(position, (4, 1)),
        damping=32.0,
        orientation_reference=quat_xyzw(rotation),
        rotation_attractors=np.zeros((4, 3)),
        rotation_stiffness=400.0,
        rotation_damping=36.0,
        q_start=HOME,
    )


def fuzz(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """Fuzzed messages are passed to conversion and controller, in this process."""
    controller = new_controller()
    found = bombard(controller, fuzz_policy(), repeats, int(rng.integers(2**32)))
    wrong = sum(found[kind] for kind in ("not finite", "over", "rate"))
    return Row(
        "S-01",
        "fuzzed messages: every torque is finite and within its limits of magnitude and rate",
        f"{wrong} of {found['torques']} torques; {found['refused']} refusals; "
        f"largest {100 * found['largest']:.0f} % of its limit",
        repeats,
        wrong == 0,
    )


def fuzz_over_dds(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The same messages are sent to the node over DDS."""
    from std_msgs.msg import String

    running = lab.controller()
    lab.played()
    policies = lab.node.create_publisher(String, interface.CONTROLLER_REQUEST, interface.REQUESTS)
    limit = new_controller().limits.torque
    policy, source, count, wrong = fuzz_policy(), states(JOINTS, HOME, rng), 0, 0
    lab.link.wait_for(interface.RESET)
    for number in range(repeats):
        lab._states.publish(next(source))
        if number % 50 == 0:
            request = Request("move_to_start", {"policy": spoilt(policy, rng)})
            policies.publish(request.message())
            lab.link.begin(interface.RESET)
        lab.spin(0.001)
        new, lab.torques = lab.torques, lab.torques[-1:]
        count += len(new) - 1
        wrong += sum(not (np.abs(torque.tau) <= limit).all() for _, torque in new)
    alive = running.process.poll() is None
    return Row(
        "S-11",
        "fuzzed messages over DDS: every torque is finite and within its limit; the node survives",
        f"{wrong} of {count} torques, {'alive' if alive else 'dead'}",
        repeats,
        wrong == 0 and alive,
    )


def starved(fifo: bool) -> Callable[[Lab, int, np.random.Generator], Row]:
    """Four busy processes run beside the control loop, for some seconds."""

    def row(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
        from benchmark.latency import measure

        figures = measure(float(repeats), fifo, 4)
        missed = 100.0 - figures["controller"]["met"]
        how = "SCHED_FIFO" if fifo else "plain scheduling (no requirement)"
        return Row(
            "S-50",
            f"four busy processes, {how}: at most 0.1 % of the periods missed",
            f"{missed:.2f} % (echo {100.0 - figures['echo']['met']:.2f} %)",
            repeats * 500,
            missed <= 0.1 or not fifo,
        )

    return row


def network(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The network between driver and controller is cut for a second; in a namespace, over UDP."""
    lab.controller()

    def cut() -> None:
        subprocess.run(["ip", "link", "set", "lo", "down"], check=True)
        lab.spin(1.0)
        subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
        subprocess.run(["ip", "route", "add", "224.0.0.0/4", "dev", "lo"], check=True)
        before = len(lab.readings)
        lab.wait(lambda: len(lab.readings) > before + 10, "states after the reconnection")

    speed, drop, faults = disturbed(lab, repeats, rng, cut)
    return Row(
        "S-53",
        "network cut for 1 s: fault until reset, tip at most 0.3 m/s, drop at most 5 cm",
        f"{speed:.3f} m/s, {100 * drop:.1f} cm; {faults} faults",
        repeats,
        bool(speed <= 0.3 and drop <= 0.05 and faults == repeats),
    )


def learner(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The learner is killed in the middle of a session."""
    kills, differing = 0, []
    while kills < repeats and not differing:
        seed = str(rng.integers(21, 100))
        command = [sys.executable, "-m", "benchmark.kill", "--seed", seed]
        command += ["--trials", "20", "--kills", str(min(20, repeats - kills))]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        ran = done.stdout.count("killed learner")
        kills += ran
        if done.returncode or not ran:
            last = (done.stdout.strip() or done.stderr.strip() or "no output").splitlines()[-1]
            differing.append(f"seed {seed}: {last}")
    return Row(
        "S-61",
        "learner killed (-9): no acknowledged rollout lost, identical records at the end",
        "; ".join(differing) or f"none lost, all identical in {kills} kills",
        kills,
        not differing,
    )


def recorder(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The recorder is killed while recording, and its bag is recovered."""
    command = [sys.executable, "-m", "benchmark.recover", "--cuts", "0", "--kills", str(repeats)]
    command += ["--seed", str(rng.integers(21, 100))]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    reported = [
        line for line in done.stdout.splitlines() if line.startswith(("killed", "disk", "WR"))
    ]
    return Row(
        "S-65",
        "recorder killed (-9), or its disk full: at most one second lost, the rest recovered",
        "; ".join(reported) or "nothing was printed",
        repeats,
        done.returncode == 0,
    )


def disk(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The disk fills up while recording."""
    test = "test_a_disk_that_fills_up_ends_the_recording_and_nothing_else"
    command = [sys.executable, "-m", "pytest", "-q", "-k", test, "test"]
    passed = 0
    for _ in range(repeats):
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        passed += done.returncode == 0 and "passed" in done.stdout
    return Row(
        "S-66",
        "full disk: the recording ends, the arm continues",
        f"{passed} of {repeats} as required",
        repeats,
        passed == repeats,
    )


PEAKS: dict[str, float] = {}  # tool speed of every phase with true states [m/s]


def seen(phase: str, found: Outcome) -> str:
    """What came of false states in a phase."""
    when = "none" if found.noticed is None else f"{2 * found.noticed} ms"
    return f"{phase} {when} {found.peak:.2f} ({PEAKS[phase]:.2f}), then {found.rest:.2f} m/s"


def false_states(name: str) -> Callable[[Lab, int, np.random.Generator], Row]:
    """One kind of false state in every phase, with an arm that keeps the last torque.

    "relay" is a second publisher that repeats the states of the driver 6 ms late.
    """

    def row(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
        driver, relayed = Driver(lab), 3 if name == "relay" else 0
        lab.controller()
        for phase in PHASES:
            if phase not in PEAKS:
                PEAKS[phase] = inject(driver, lab, phase, lambda state: state).peak
        lines, passed = [], True
        for _ in range(repeats):
            for phase in PHASES:
                lie = (lambda state: state) if relayed else FALSE_STATES[name]()
                found = inject(driver, lab, phase, lie, relayed)
                passed &= stopped(found, PEAKS[phase])
                passed &= found.noticed is not None or not relayed
                lines.append(seen(phase, found))
        ident, text = (
            ("S-130", "states relayed 6 ms late: fault, at rest 0.5 s after it")
            if relayed
            else ("S-91", f"{name}: tool at most 0.5 m/s faster than with true states, at rest")
        )
        text += "" if relayed else " 0.5 s after fault"
        return Row(ident, text, "; ".join(lines), repeats * len(PHASES), passed)

    return row


def ended(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """The controller is ended or deactivated in a rollout; the arm keeps the last torque."""
    driver = Driver(lab)
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
    return Row(
        "S-05",
        "SIGTERM, SIGINT or deactivation in a rollout: at rest 0.5 s later, last torque within "
        "0.5 N m of g(q)",
        f"{max(rests):.3f} m/s, {max(wrong):.2f} N m",
        repeats,
        max(rests) < REST_SPEED and max(wrong) < 0.5,
    )


def simulation(lab: Lab, repeats: int, rng: np.random.Generator) -> Row:
    """A simulation is started in the robot's terminal while its driver subscribes to torques."""
    answers = []
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            given = environment(lab.domain) | {"MUJOCO_GL": "disable"}
            command = [sys.executable, "-m", "wam_power_ros.cli", "learn", "--session", folder]
            learning = subprocess.Popen(
                command,
                env=os.environ | given,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            bags = Path(folder) / "bags"

            def teaching(learning=learning, bags=bags) -> bool:  # noqa: ANN001
                return any(bags.glob("*/*.mcap")) or learning.poll() is not None

            lab.wait(teaching, "demonstration in the simulation", play=True)
            lab.play(rng.uniform(1.0, 2.0))
            learning.send_signal(signal.SIGINT)
            answers.append(learning.communicate()[0])
    warned = sum(f"not in the exported {lab.domain}" in answer for answer in answers)
    return Row(
        "S-55",
        "simulation started in a robot's domain: no torque reaches its driver",
        f"{len(lab.torques)} torques; {warned} warnings",
        repeats,
        not lab.torques and warned == repeats,
    )


FALSE_STATE_ROWS = {name: false_states(name) for name in ("relay", *FALSE_STATES)}
ROWS = {  # name -> function and number of repeats
    "stale": (stale, 200),
    "kill": (kill, 50),
    "stop": (paused, 20),
    "intruder": (intruder, 10),
    "fuzz": (fuzz, 1_000_000),
    "fuzz_dds": (fuzz_over_dds, 10_000),
    "clock": (clock, 20),
    "restart": (restart, 5),
    "starved": (starved(True), 30),
    "starved_plain": (starved(False), 30),
    "network": (network, 5),
    "ended": (ended, 50),
    **{name: (function, 1) for name, function in FALSE_STATE_ROWS.items()},
    "simulation": (simulation, 3),
    "learner": (learner, 50),
    "recorder": (recorder, 50),
    "disk": (disk, 3),
}


# Rows in which this process publishes the states of the arm.
PLAYED = (
    *(stale, intruder, clock, fuzz_over_dds, simulation, ended),
    *FALSE_STATE_ROWS.values(),
)
WATCHED = (kill, paused, restart, network)  # rows with the stand-in as the arm


def alone(function: Callable, scratch: Path, repeats: int, rng: np.random.Generator) -> Row | None:
    """Run a row in its own process, because priorities are not revocable; None on failure."""
    kept = scratch / "row.json"
    child = os.fork()
    if child == 0:
        try:
            if (
                function in PLAYED or function in WATCHED
            ):  # busy processes must not inherit the priority
                scheduling._schedule(ARM if function in PLAYED else WATCHER)
            lab = Lab(scratch)
            with lab.open():
                row = function(lab, repeats, rng)
            kept.write_text(json.dumps([asdict(row), PEAKS], default=bool))
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    if not kept.exists():
        return None
    row, peaks = json.loads(kept.read_text())
    PEAKS.update(peaks)
    return Row(**row)


def isolated(name: str, repeats: int, scratch: Path) -> Row | None:
    """Run a row in a network namespace, where the network can be cut; None on failure."""
    report = scratch / "isolated.json"
    inside = [sys.executable, "-m", "benchmark.faults", "--inside", "--rows", name]
    inside += ["--repeats", str(repeats), "--json", str(report)]
    up = (
        "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && "
        f"exec {' '.join(inside)}"
    )
    environment = os.environ | {  # without shared memory, which a cut network would not stop
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    }
    subprocess.run(
        ["unshare", "-n", "sh", "-c", up], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL
    )
    return Row(**json.loads(report.read_text())[0]) if report.exists() else None


def table(rows: list[Row]) -> str:
    """Format rows as a Markdown table."""
    lines = ["| id | requirement | worst seen | repeats | |", "|---|---|---|---|---|"]
    for row in rows:
        verdict = "pass" if row.passed else "**FAIL**"
        lines.append(
            f"| {row.requirement} | {row.text} | {row.worst} | {row.repeats} | {verdict} |"
        )
    return "\n".join(lines)


def main() -> int:
    """Run the rows; return 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=list(ROWS))
    parser.add_argument(
        "--repeats", type=int, help="number of repeats of every row (default: each its own)"
    )
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    rows: list[Row] = []
    for name in options.rows:
        function, own = ROWS[name]
        repeats = options.repeats or own
        with tempfile.TemporaryDirectory() as scratch:
            if name == "network" and not options.inside:
                row = isolated(name, repeats, Path(scratch))
            else:
                rng = np.random.default_rng((options.seed, list(ROWS).index(name)))
                row = alone(function, Path(scratch), repeats, rng)
        rows.append(row or Row("-", name, "ended with an error", repeats, False))
        print(table(rows[-1:]).splitlines()[-1], flush=True)
        if options.json:
            options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    print(table(rows))
    return int(not all(row.passed for row in rows))


if __name__ == "__main__":
    sys.exit(main())
