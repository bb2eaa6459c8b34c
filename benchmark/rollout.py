# SPDX-License-Identifier: Apache-2.0
"""Time of a rollout in one process compared with that of its bare MuJoCo steps.

    python -m benchmark.rollout [--repeats 15]

A demonstrated toss is executed in one process: the simulated world, the controller and the tracker
are connected by calls. The forces of each physics step are recorded and played back through
`mj_step` alone. The playback starts from the same state and must end in the same state, bit for
bit, so the contacts are the same too. Rollout and playback alternate. Every repeat does the same
work in each tick, so the shortest time of each tick counts, for both: disturbances of a busy
machine only add to it.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

import mujoco
import numpy as np

from hardware_sim.scenes import scene_type
from hardware_sim.sensors import Encoders, Mocap
from hardware_sim.world import World
from reproduction.studies.flip_sessions import teach
from wam_power_ros.control import torque_law
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import Mode
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.policy import Policy
from wam_power_ros.tasks.flip.flight import observe_flight
from wam_power_ros.tracking.tracker import Tracker

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class Part(NamedTuple):
    """A function to time, and the label of its part in the report."""

    owner: object
    name: str
    label: str


PARTS = (
    Part(World, "reset", "world: reset"),
    Part(mujoco, "mj_step", "MuJoCo"),
    Part(World, "step", "world: motors, log"),
    Part(World, "joint_state", "world: state out"),
    Part(Encoders, "read", "world: encoders"),
    Part(Mocap, "expose", "world: cameras"),
    Part(World, "truth", "world: truth"),
    Part(Controller, "step", "controller: checks, limits, policy"),
    Part(Arm, "motion", "controller: kinematics"),
    Part(Arm, "dynamics", "controller: dynamics"),
    Part(torque_law, "operational_space", "controller: torque law"),
    Part(Controller, "load", "controller: load"),
    Part(Tracker, "add", "tracker"),
)


@dataclass
class Recording:
    """The physics steps of one rollout, beginning with those in which the pancake settles."""

    settling_steps: int = 0
    settling: np.ndarray = field(default_factory=lambda: np.empty(0))  # state before settling
    start: np.ndarray = field(default_factory=lambda: np.empty(0))  # state at the release
    end: np.ndarray = field(default_factory=lambda: np.empty(0))
    forces: list[np.ndarray] = field(default_factory=list)  # per tick (nv,) [N m]


@contextmanager
def replaced(owner: object, name: str, value: object) -> Iterator[None]:
    """Replace an attribute within a `with` block."""
    original = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, original)


def state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """State of the integrator, on which the next step depends."""
    values = np.empty(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, values, _STATE)
    return values


def record(environment: Environment, policy: Policy) -> Recording:
    """Execute a policy and record the inputs of its physics steps."""
    recording = Recording()
    step = mujoco.mj_step

    def recorded(model: mujoco.MjModel, data: mujoco.MjData, count: int = 1) -> None:
        if count == 1:  # in `World.reset`; a tick takes several steps in one call
            if not recording.settling_steps:
                recording.settling = state(model, data)
            recording.settling_steps += 1
        else:
            if not recording.forces:
                recording.start = state(model, data)
            recording.forces.append(data.qfrc_applied.copy())
        step(model, data, count)

    with replaced(mujoco, "mj_step", recorded):
        environment.run(policy)
    recording.end = state(environment.world.model, environment.world.data)
    return recording


class Playback:
    """Plays back the recorded physics alone."""

    def __init__(self, world: World, recording: Recording) -> None:
        self._world, self._recording = world, recording
        self._data = mujoco.MjData(world.model)

    def settle(self) -> np.ndarray:
        """Time the steps in which the pancake settles [s]. Shape (steps,)."""
        model, data, recording = self._world.model, self._data, self._recording
        wind = model.opt.wind.copy()
        model.opt.wind[:] = 0.0
        mujoco.mj_setState(model, data, recording.settling, _STATE)
        q, qd = data.qpos[:7], data.qvel[:7]
        q_start = q.copy()
        stamps = [time.perf_counter()]
        for _ in range(recording.settling_steps):
            mujoco.mj_step(model, data)
            q[:] = q_start
            qd[:] = 0.0
            stamps.append(time.perf_counter())
        model.opt.wind[:] = wind
        return np.diff(stamps)

    def fly(self) -> np.ndarray:
        """Time the ticks from the release on [s]. Shape (ticks,).

        Raises:
            RuntimeError: If the playback ends in another state than the rollout.
        """
        model, data, recording = self._world.model, self._data, self._recording
        mujoco.mj_setState(model, data, recording.start, _STATE)
        applied, substeps = data.qfrc_applied, round(0.002 / model.opt.timestep)
        stamps = [time.perf_counter()]
        for force in recording.forces:
            applied[:] = force
            mujoco.mj_step(model, data, substeps)
            stamps.append(time.perf_counter())
        if not np.array_equal(state(model, data), recording.end):
            raise RuntimeError("the playback ended in another state than the rollout")
        return np.diff(stamps)


class Clock:
    """Time spent in each call of functions [s], excluding nested timed functions."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = defaultdict(list)
        self._inner = [0.0]

    def timed(self, function: Callable[..., object], label: str) -> Callable[..., object]:
        """Return the function, timed by this clock."""

        def run(*args: object) -> object:
            self._inner.append(0.0)
            begin = time.perf_counter()
            result = function(*args)
            spent = time.perf_counter() - begin
            self.seconds[label].append(spent - self._inner.pop())
            self._inner[-1] += spent
            return result

        return run


def by_part(environment: Environment, policy: Policy) -> dict[str, list[float]]:
    """Time of each call of each part [s]; their sum slightly exceeds an untimed rollout."""
    clock = Clock()
    with ExitStack() as stack:
        for part in PARTS:
            timed = clock.timed(getattr(part.owner, part.name), part.label)
            stack.enter_context(replaced(part.owner, part.name, timed))
        clock.timed(environment.run, "connections")(policy)
    return clock.seconds


def by_tick(environment: Environment, policy: Policy) -> np.ndarray:
    """Time of one rollout, by tick of the world [s]. Shape (ticks + 1,)."""
    stamps = [time.perf_counter()]
    step = World.step

    def stamped(world: World, torque: np.ndarray | None) -> None:
        stamps.append(time.perf_counter())
        step(world, torque)

    with replaced(World, "step", stamped):
        environment.run(policy)
    stamps.append(time.perf_counter())
    return np.diff(stamps)


def control_steps(environment: Environment, policy: Policy) -> list[float]:
    """Time of each of the controller's steps in a rollout [s]."""
    times: list[float] = []
    step = Controller.step

    def timed(controller: Controller, *args: object) -> object:
        begin = time.perf_counter()
        torque = step(controller, *args)
        if controller.mode is Mode.ROLLOUT:
            times.append(time.perf_counter() - begin)
        return torque

    with replaced(Controller, "step", timed):
        environment.run(policy)
    return times


def best(times: Sequence[Sequence[float]]) -> np.ndarray:
    """Shortest time of each call over the repeats (repeats, calls). Shape (calls,)."""
    return np.min(times, axis=0)


def seconds_of(function: Callable[[], object]) -> float:
    """Time of one call [s]."""
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=15)
    repeats = parser.parse_args().repeats
    environment = Environment(World(scene_type("flip"), seed=1))
    (policy,) = teach(environment, seed=1, count=1)
    recording = record(environment, policy)
    playback = Playback(environment.world, recording)
    wholes, settles, flights, controls = [], [], [], []
    parts: dict[str, list[list[float]]] = defaultdict(list)
    for _ in range(repeats):
        wholes.append(by_tick(environment, policy))
        settles.append(playback.settle())
        flights.append(playback.fly())
        controls.append(control_steps(environment, policy))
        for label, calls in by_part(environment, policy).items():
            parts[label].append(calls)
    rollout, truth = environment.run(policy)
    observing = min(
        seconds_of(lambda: observe_flight(rollout.tool, rollout.body)) for _ in range(repeats)
    )

    whole, settle, flight = (float(best(times).sum()) for times in (wholes, settles, flights))
    seconds = {label: float(best(calls).sum()) for label, calls in parts.items()}
    ticks = len(recording.forces)
    simulated = 0.002 * ticks
    print(f"rollout of {simulated:.2f} s, {ticks} ticks; tossed {truth['tossed']}")
    print(f"rollouts per second      {1.0 / whole:8.1f}")
    print(f"times real time          {simulated / whole:8.1f}")
    print(f"whole rollout            {whole * 1e3:8.1f} ms")
    bare = f"{(settle + flight) * 1e3:8.1f} ms, {settle * 1e3:.1f} of it while the pancake settles"
    print(f"bare MuJoCo steps        {bare}")
    print(f"whole over bare          {whole / (settle + flight):8.2f}")
    print(f"control step, median     {np.median(best(controls)) * 1e6:8.1f} us")
    print(f"observing the flight     {observing * 1e3:8.1f} ms, not included above")
    print("microseconds per tick by part, including the timing")
    for label in sorted(seconds, key=seconds.get, reverse=True):
        print(f"  {label:36s}{seconds[label] / ticks * 1e6:8.1f}")


if __name__ == "__main__":
    main()
