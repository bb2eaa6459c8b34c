# SPDX-License-Identifier: Apache-2.0
"""False alarms and contacts: conditions that must not stop the arm, and contacts that must.

    python -m benchmark.contact [--rollouts 72] [--replays 100]

World, controller and tracker are connected by calls, in one process. Rollouts of exploration are
executed under conditions unknown to the controller, or with drivers that report with jitter, lag or
repetitions, and demonstrations are replayed: this must cause no fault. Then the tool is pushed
during a replay, and hits a wall: the replay must stop, and the force stay small.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from typing import Any, NamedTuple

import numpy as np

from benchmark.terminal import options
from hardware_sim.scenes.flip import wrist_flick
from hardware_sim.sensors import MocapSettings
from hardware_sim.wam import PERIOD_NS
from hardware_sim.world import JointSample, World
from reproduction.studies.flip_sessions import stand_in, teach
from wam_power_ros.control import replay_trajectory
from wam_power_ros.control.modes import Mode
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros.joint_messages import JointMovement

CONDITIONS: dict[str, dict[str, Any]] = {
    "pan believed 20 % lighter": {"believed_pan": 0.8},
    "pan believed 20 % heavier": {"believed_pan": 1.2},
    "joint friction doubled": {"friction_share": 2.0},
    "2 ms more delay": {"command_delay_ticks": 3},
    "torque constants, sd 5 %": {"torque_scale_sd": 0.05},
    "30 Hz motion capture": {"mocap": MocapSettings(rate=30.0)},
    "120 Hz motion capture": {"mocap": MocapSettings(rate=120.0)},
}
SEED = 3000  # first seed; seeds from 1000 on were used to choose the bounds
SESSION_ROLLOUTS = 24  # rollouts of a session with one demonstration
PUSH, STOP_WITHIN = 30.0, 0.06  # [N], [s]
HOLD_TIME, TOUCH = 8.0, 3.0  # [s] of a hold, [N] of a hand that touches the arm meanwhile
WALLS = (1e3, 2e3, 5e3, 10e3, 75e3)  # stiffness [N/m]; the last is that of a hand in ISO/TS 15066
REPLAY_SPEED = 0.5  # of the replays with contacts, as a share of the recorded speed


@dataclass(frozen=True)
class Habits:
    """How a driver reports its measurements.

    Attributes:
        jitter: Standard deviation of the stamps [s]; its clock never runs back.
        lag: Time constant of a filter of the velocities, after the encoders' own [s]; 0 for none.
        repeats: Number of states with the same measurement.
    """

    jitter: float = 0.0
    lag: float = 0.0
    repeats: int = 1


HONEST = Habits()
REALISTIC = {
    "stamps that jitter by 0.3 ms": Habits(jitter=3e-4),
    "stamps that jitter by 0.6 ms": Habits(jitter=6e-4),
    "velocities behind a filter of 10 ms": Habits(lag=0.01),
    "250 Hz under 500 Hz stamps": Habits(repeats=2),
}
CASES: dict[str, tuple[dict[str, Any], Habits]] = {
    **{name: (condition, HONEST) for name, condition in CONDITIONS.items()},
    **{name: ({}, habits) for name, habits in REALISTIC.items()},
}


def report(world: World, habits: Habits, seed: int) -> None:
    """Let a world report its joint states with these habits; `seed` is that of the jitter."""
    measure, rng = world.joint_state, np.random.default_rng(seed)
    share = 1.0 - math.exp(-PERIOD_NS * 1e-9 / habits.lag) if habits.lag else 1.0
    filtered, held, last_ns = np.zeros(7), measure(), 0
    told = held, measure()  # the last measurement and what was reported of it

    def joint_state() -> JointSample:
        nonlocal filtered, held, last_ns, told
        sample = measure()
        if sample.stamp_ns == told[0].stamp_ns:
            return told[1]
        # Where the simulation puts the arm somewhere else, its driver starts anew.
        filtered = sample.qd if world.frozen else filtered + share * (sample.qd - filtered)
        if world.frozen or sample.stamp_ns // PERIOD_NS % habits.repeats == 0:
            held = sample._replace(qd=filtered.copy())
        stamp_ns = sample.stamp_ns + round(1e9 * habits.jitter * rng.standard_normal())
        last_ns = max(stamp_ns, last_ns + 1000)
        told = sample, held._replace(stamp_ns=last_ns)
        return told[1]

    world.joint_state = joint_state  # type: ignore[method-assign]


def simulated(seed: int, condition: dict[str, Any], habits: Habits) -> Environment:
    """Stand-in under a condition, fields of its settings, whose driver has these habits."""
    environment = stand_in(seed, **condition)
    if habits is not HONEST:
        report(environment.world, habits, seed)
    return environment


def rollouts(
    condition: dict[str, Any], count: int, habits: Habits = HONEST
) -> tuple[int, list[str]]:
    """Run sessions of at least `count` rollouts in all; return their number and all faults."""
    done, faults, seed = 0, [], SEED
    while done < count:
        environment = simulated(seed, condition, habits)
        budget = max(6, min(SESSION_ROLLOUTS, count - done))  # a session needs a few rollouts
        settings = preset("flip", "paper", budget=budget, retests=0)
        practice = Practice(settings, {}, teach(environment, seed, 1), seed, environment)
        found = [record.fault for record in environment.practise(practice)]
        done += len(found)
        faults += filter(None, found)
        seed += 1
    return done, faults


class Replay:
    """Replays of a demonstration in one environment.

    Attributes:
        environment: The environment.
        periods: Duration of the present movement [periods].
    """

    def __init__(self, seed: int, condition: dict[str, Any], habits: Habits = HONEST) -> None:
        self.environment = simulated(seed, condition, habits)
        script = wrist_flick(np.random.default_rng([seed, 0]))
        stamps_ns, q = self.environment.demonstrate(script, "demonstration")
        self._stamps_ns, self._q = stamps_ns, q
        self._count = self.periods = 0

    @property
    def start(self) -> np.ndarray:
        """Posture at the start of the movement [rad]. Shape (7,)."""
        return replay_trajectory.movement(self._stamps_ns, self._q, 1.0)[1][0]

    def begin(self, speed: float) -> None:
        """Hold at the start of the movement, then start the replay."""
        environment = self.environment
        movement = JointMovement(*replay_trajectory.movement(self._stamps_ns, self._q, speed))
        self.periods = round(movement.t[-1] * 1e9 / PERIOD_NS)
        self._count += 1
        environment.world.attach(None)
        environment.place(f"replay-{self._count}", movement.q[0])
        for _ in range(100):
            environment.tick()
        controller = environment.controller
        period, limits = controller.settings.period, controller.limits
        controller.start_replay(replay_trajectory.sampled(*movement, period, limits))
        environment.world.release()
        while environment.controller.mode is not Mode.REPLAY:
            environment.tick()

    def ticks(self) -> Iterator[int]:
        """Run to the end, or to rest after a fault; yield the number of periods so far."""
        controller, k = self.environment.controller, 0
        while controller.mode is Mode.REPLAY or (controller.mode is Mode.FAULT and k < 5000):
            if controller.mode is Mode.FAULT and controller.at_rest:
                return
            yield k
            self.environment.tick()
            k += 1


def replays(count: int) -> list[str]:
    """Replay demonstrations under all conditions; return all faults."""
    faults: list[str] = []
    arms = [Replay(SEED + k, each) for k, each in enumerate(CONDITIONS.values())]
    speeds = cycle((0.5, 1.0))
    for arm, speed in zip(islice(cycle(arms), count), speeds, strict=False):
        arm.begin(speed)
        for _ in arm.ticks():
            pass
        if (latched := arm.environment.controller.latched) is not None:
            faults.append(latched.text)
    return faults


class Force:
    """A force of `peak` [N] in a random direction, of which `share` acts by the time [s]."""

    def __init__(
        self, peak: float, rng: np.random.Generator, share: Callable[[float], float]
    ) -> None:
        direction = rng.normal(size=3)
        self.peak, self._share = peak, share
        self._force = peak * direction / np.linalg.norm(direction)

    def wrench(
        self, t: float, position: np.ndarray, rotation: np.ndarray, twist: np.ndarray
    ) -> np.ndarray:
        """Wrench at the pan's centre; see `hardware_sim.demonstrator.Demonstrator`."""
        return np.concatenate([self._share(t) * self._force, np.zeros(3)])


def touch(t: float) -> float:
    """Share of a force that rises and falls within a second."""
    return float(np.sin(np.pi * min(t, 1.0))) ** 2


def holds(count: int) -> list[str]:
    """Hold for `HOLD_TIME` under all conditions, touched once a second; return all faults."""
    faults, rng = [], np.random.default_rng(SEED)
    for k, (condition, habits) in enumerate(islice(cycle(CASES.values()), count)):
        replay = Replay(SEED + k, condition, habits)
        environment = replay.environment
        environment.world.attach(None)
        environment.place(f"hold-{k}", replay.start)
        for tick in range(round(HOLD_TIME * 1e9 / PERIOD_NS)):
            if tick == 100:
                environment.world.release()
            if tick % 500 == 400:
                environment.world.attach(Force(TOUCH, rng, touch))
            environment.tick()
        if (latched := environment.controller.latched) is not None:
            faults.append(latched.text)
    return faults


class Wall:
    """An elastic half space whose surface is at the tool's position, across its motion.

    Attributes:
        peak: Largest force so far [N].
    """

    def __init__(self, stiffness: float) -> None:
        self._stiffness = stiffness
        self._at: np.ndarray | None = None
        self.peak = 0.0

    def wrench(
        self, t: float, position: np.ndarray, rotation: np.ndarray, twist: np.ndarray
    ) -> np.ndarray:
        """Wrench at the pan's centre; see `hardware_sim.demonstrator.Demonstrator`."""
        if self._at is None:
            self._at, self._normal = position.copy(), twist[:3] / np.linalg.norm(twist[:3])
        depth = float((position - self._at) @ self._normal)
        force = self._stiffness * max(depth, 0.0)
        self.peak = max(self.peak, force)
        return np.concatenate([-force * self._normal, np.zeros(3)])


class Stop(NamedTuple):
    """Reaction to one contact.

    Attributes:
        faulted: Time from the first force to the fault [s]; None without a fault.
        peak: Largest force [N].
        speed: Speed of the tool when the contact began [m/s].
    """

    faulted: float | None
    peak: float
    speed: float


def touched(replay: Replay, moment: float, contact: Force | Wall) -> Stop:
    """Run a replay with a contact at the tool from a moment on, a share of the movement."""
    replay.begin(REPLAY_SPEED)
    controller, world = replay.environment.controller, replay.environment.world
    at, faulted, speed = round(moment * replay.periods), None, 0.0
    for k in replay.ticks():
        if k == at:
            sample = world.joint_state()
            speed = replay.environment.arm.speeds(sample.q, sample.qd).tool_speed
            world.attach(contact)
        if faulted is None and controller.mode is Mode.FAULT:
            faulted = (k - at) * PERIOD_NS * 1e-9
    return Stop(faulted, contact.peak, speed)


def pushes(count: int, rng: np.random.Generator) -> list[Stop]:
    """Push the tool in random directions at random moments."""
    replay, stops = Replay(SEED, {}), []
    for _ in range(count):
        push = Force(PUSH, rng, lambda t: min(t / 0.01, 1.0))  # rises within 10 ms
        stops.append(touched(replay, rng.uniform(0.1, 0.9), push))
    return stops


def walls(stiffness: float, count: int, rng: np.random.Generator) -> list[Stop]:
    """Place a wall in front of the moving tool at random moments."""
    replay, stops = Replay(SEED, {}), []
    while len(stops) < count:
        stop = touched(replay, rng.uniform(0.1, 0.9), Wall(stiffness))
        if stop.speed > 0.05:
            stops.append(stop)
    return stops


def summary(stops: Sequence[Stop]) -> str:
    """Summarize contacts in one line."""
    times = [stop.faulted for stop in stops if stop.faulted is not None]
    latest = f"{max(times) * 1e3:.0f} ms" if times else "-"
    late = sum(time > STOP_WITHIN for time in times)
    peaks = [stop.peak for stop in stops]
    speeds = [stop.speed for stop in stops]
    return (
        f"{len(times)} of {len(stops)} found, after {latest} at most, {late} later than 60 ms; "
        f"force at most {max(peaks):.0f} N, median {sorted(peaks)[len(peaks) // 2]:.0f}; speed of "
        f"the tool {min(speeds):.2f} to {max(speeds):.2f} m/s"
    )


def main() -> int:
    """Print every part; return 1 after a false alarm."""
    given = options(__doc__, rollouts=72, replays=100, holds=60, contacts=50)
    alarms = done = 0
    for name, (condition, habits) in CASES.items() if given.rollouts else ():
        count, faults = rollouts(condition, given.rollouts, habits)
        alarms, done = alarms + len(faults), done + count
        print(f"{count} rollouts, {name}: {len(faults)} faults {faults[:3]}", flush=True)
    print(f"{done} rollouts: {alarms} faults")
    for name, part, count in (
        ("replays at half and full speed", replays, given.replays),
        (f"holds of {HOLD_TIME:.0f} s, touched with {TOUCH:.0f} N", holds, given.holds),
    ):
        faults = part(count)
        alarms += len(faults)
        print(f"{count} {name}, under all conditions: {len(faults)} {faults[:3]}", flush=True)
    rng = np.random.default_rng(SEED)
    print(f"pushed with {PUSH:.0f} N at half speed: {summary(pushes(given.contacts, rng))}")
    for stiffness in WALLS:
        stops = walls(stiffness, given.contacts, rng)
        print(f"wall of {stiffness * 1e-3:.0f} N/mm: {summary(stops)}", flush=True)
    return int(bool(alarms))


if __name__ == "__main__":
    sys.exit(main())
