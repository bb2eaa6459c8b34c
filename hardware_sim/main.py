# SPDX-License-Identifier: Apache-2.0
"""The process of both stand-ins: one world, two nodes, and the pace.

Lockstep: a state is published, and again every 50 ms, until the torque labelled with its stamp has
come; then the world steps. Real time: 500 steps a second on absolute deadlines, with links that
delay, jitter and lose as real networks do.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import start

    raise SystemExit(start("hardware_sim.main"))

import copy
import os
import time
from collections.abc import Callable

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor

from hardware_sim.driver_watch import DriverWatch
from hardware_sim.network_link import Link
from hardware_sim.optitrack_node import OptitrackSim
from hardware_sim.scenes import scene_type
from hardware_sim.sensors import MocapFrame, MocapSettings
from hardware_sim.wam import PERIOD_NS
from hardware_sim.wam_node import WamSim
from hardware_sim.world import World
from wam_power_ros.ros import joint_messages, node_runner, scheduling
from wam_power_ros.ros.domain import exported, hold
from wam_power_ros.ros.loop_statistics import LoopStatistics
from wam_power_ros.ros.node_runner import REFUSED

REPEAT_NS = 50_000_000  # [ns] without the torque, after which a state is published again
LATE_NS = 100_000_000  # [ns] behind by more, real time gives up on catching up


class Simulation:
    """The two nodes on one world; only the WAM's when the scene has no tracked body.

    Nothing is published in a domain in which a robot or another simulation is.

    Attributes:
        intruder: Who has appeared there since and ended the simulation; empty for nobody.

    Raises:
        ValueError: A parameter that is not acceptable, or a domain that is not free.
    """

    def __init__(self) -> None:
        self.intruder = ""
        self.wam = WamSim()
        params = self.wam.params
        # for as long as the process lives
        self._domain = hold(exported(os.environ), self.wam.get_namespace())
        self._watch = DriverWatch(self.wam, params.command_topic, params.listeners)
        make_scene = scene_type(params.scene)
        self.optitrack: OptitrackSim | None = None
        mocap, on_frame = MocapSettings(), _no_frame
        if make_scene.body:
            self.optitrack = OptitrackSim()
            mocap, on_frame = self.optitrack.params.mocap(), self.optitrack.publish
            body = self.optitrack.params.body
            if body != make_scene.body:
                raise ValueError(
                    f"optitrack_sim is set to body {body!r}, but the tracked body of scene "
                    f"{params.scene!r} is {make_scene.body!r}"
                )
        world = World(params.world(mocap), params.seed, make_scene)
        self._watch.check()  # while the world was built, others were discovered
        self.wam.attach(world, on_frame)
        rngs = [np.random.default_rng((params.seed, link)) for link in range(2)]
        self._out = Link(params.state_latency, params.state_jitter, params.state_loss, rngs[0])
        self._in = Link(params.command_latency, params.command_jitter, params.command_loss, rngs[1])
        self._statistics = LoopStatistics(PERIOD_NS)
        self._published_ns = 0  # steady clock
        self._granted = _schedule(0 if self.wam.lockstep else params.realtime_priority)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.wam.create_timer(1.0, self._report, clock=steady)

    def spin(self, ended: Callable[[], bool]) -> None:
        """Keep the pace until `ended()`, or until a robot appears."""

        def over() -> bool:
            self.intruder = self._watch.look()
            return bool(self.intruder) or ended()

        commands = self.wam.resolve_topic_name(self.wam.params.command_topic)
        for_what = "each step waits" if self.wam.lockstep else "the arm waits, held by itself,"
        self.wam.get_logger().info(f"{for_what} for torques on {commands}")
        executor = node_runner.executor_for(self.wam)
        if self.optitrack is not None:
            executor.add_node(self.optitrack)
        if self.wam.lockstep:
            self._lockstep(executor, over)
        else:
            self._real_time(executor, over)

    def _lockstep(self, executor: Executor, ended: Callable[[], bool]) -> None:
        self.wam.on_torque = self._answer
        while not ended():
            if time.monotonic_ns() - self._published_ns > REPEAT_NS:
                self._publish(self.wam.state())
            executor.spin_once(timeout_sec=0.02)

    def _answer(self, reading: joint_messages.TorqueReading) -> None:
        """One step, if this is the torque for the state that was published last."""
        if reading.stamp_ns != self.wam.stamp_ns:
            self.wam.counters["torques out of step"] += 1
            return
        begun_ns = time.monotonic_ns()
        self._publish(self.wam.tick(reading))
        self._statistics.add(begun_ns, self._published_ns)

    def _publish(self, message: object) -> None:
        self.wam.publish(message)
        self._published_ns = time.monotonic_ns()

    def _real_time(self, executor: Executor, ended: Callable[[], bool]) -> None:
        self.wam.on_torque = lambda reading: self._in.put(time.monotonic_ns(), reading)
        deadline_ns = time.monotonic_ns() + PERIOD_NS
        self.wam.stamp_offset_ns = time.time_ns() - self.wam.world.time_ns  # the clock starts now
        while not ended():
            now = time.monotonic_ns()
            if now < deadline_ns:
                executor.spin_once(timeout_sec=(deadline_ns - now) * 1e-9)
                continue
            arrived = self._in.take(now)
            state = self.wam.tick(arrived[-1] if arrived else None)
            self._out.put(now, copy.deepcopy(state) if self._delays else state)
            for message in self._out.take(now):
                self.wam.publish(message)
            self._statistics.add(now, time.monotonic_ns())
            deadline_ns += PERIOD_NS  # absolute: being late once does not shift the rest
            due_ns = deadline_ns
            if now - due_ns > LATE_NS:
                self.wam.counters["clock held"] += 1
                deadline_ns = time.monotonic_ns() + PERIOD_NS  # a rest: others need the core too
                self.wam.stamp_offset_ns += deadline_ns - due_ns

    @property
    def _delays(self) -> bool:
        return self.wam.params.state_latency > 0.0 or self.wam.params.state_jitter > 0.0

    def _report(self) -> None:
        granted = {"real-time scheduling": self._granted.scheduling}
        self.wam.report({**self._statistics.report(), **granted})


def _schedule(priority: int) -> scheduling.Granted:
    """Real-time scheduling, except on a single core, where nothing else would run beside it."""
    if priority and hasattr(os, "sched_getaffinity") and len(os.sched_getaffinity(0)) == 1:
        return scheduling.Granted("refused: on a single core a simulation would take it whole")
    return scheduling.request(priority)


def _no_frame(frame: MocapFrame, stamp_offset_ns: int, now_ns: int) -> None:
    """Frames of a scene without a tracked body: there are none."""


def main() -> int:
    """Run both stand-ins until a signal, or until a robot appears in their domain."""
    intruders = []

    def spin(simulation: Simulation, ended: Callable[[], bool]) -> None:
        simulation.spin(ended)
        if simulation.intruder:
            intruders.append(simulation.intruder)
            text = f"{simulation.intruder}: a simulation must not meet a robot, and ends"
            simulation.wam.get_logger().fatal(text)

    return node_runner.run(Simulation, spin=spin) or (REFUSED if intruders else 0)
