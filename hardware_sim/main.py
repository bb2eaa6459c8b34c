# SPDX-License-Identifier: Apache-2.0
"""Process of both stand-ins: one world, two nodes, and the pace.

Lockstep: publish a state, and repeat it every 50 ms, until the torque with its stamp arrives; then
step the world, and only 20 times a second while nothing has moved for long. Real time: a step every
control period on absolute deadlines.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import start

    raise SystemExit(start("hardware_sim.main"))

import os
import sys
import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor

from hardware_sim.arm_node import ArmSim
from hardware_sim.driver_watch import DriverWatch
from hardware_sim.optitrack_node import OptitrackSim
from hardware_sim.scenes import scene_type
from hardware_sim.world import World
from wam_power_ros.entry import REFUSED
from wam_power_ros.ros import joint_messages, node_runner, scheduling
from wam_power_ros.ros.domain import exported, lock
from wam_power_ros.ros.loop_statistics import LoopStatistics

REPEAT_PERIOD_NS = 50_000_000  # [ns] after which an unanswered state is published again
IDLE_PERIOD_NS = 50_000_000  # [ns] between two steps while nothing moves: waiting costs little
OWN_NAME = ["--ros-args", "-r", "__node:=optitrack_sim"]
LAG_MAX_NS = 100_000_000  # [ns] behind the clock; beyond, the time of the simulation is shifted


class Simulation:
    """The two nodes on one world; only that of the WAM if the scene has no tracked body.

    Nothing is published in a domain with a robot, or with another simulation unless both are in
    namespaces of their own.

    Attributes:
        intruder: Robot whose appearance ended the simulation, described; "" for none.

    Raises:
        ValueError: A parameter is not acceptable, or the domain is not free.
    """

    def __init__(self) -> None:
        self.robot = ""
        self.wam = ArmSim()
        params = self.wam.params
        # a lock, held while the process lives
        self._domain = lock(exported(os.environ), self.wam.get_namespace())
        self._watch = DriverWatch(self.wam)
        # A name that is given to the process is that of the arm's node.
        given = any(word.startswith("__node:=") for word in sys.argv)
        own = {"cli_args": OWN_NAME} if given else {}
        self.optitrack = OptitrackSim(**own) if scene_type(params.scene).body else None
        cameras, on_frame = None, lambda *_: None
        if self.optitrack is not None:
            cameras, on_frame = self.optitrack.params, self.optitrack.publish
            if cameras.camera and not params.lockstep:
                raise ValueError(
                    "camera = True of optitrack_sim needs pace = lockstep of wam_sim: to draw an "
                    "image takes longer than a state may be late"
                )
        world = World.from_params(params, cameras)
        self._watch.check()  # discovery went on while the world was built
        self.wam.attach(world, on_frame)
        self._statistics = LoopStatistics(params.period_ns)
        self._published_ns = 0  # [ns] on the steady clock
        self._held: joint_messages.TorqueReading | None = None  # newest that has no step yet
        self._granted = _schedule(0 if self.wam.params.lockstep else params.realtime_priority)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.wam.create_timer(1.0, self._report, clock=steady)

    def spin(self, ended: Callable[[], bool]) -> None:
        """Step the world at its pace until `ended()`, or until a robot appears."""

        def stopped() -> bool:
            self.robot = self._watch.look()
            return bool(self.robot) or ended()

        commands = self.wam.resolve_topic_name(self.wam.params.command_topic)
        waiting = (
            "each step waits" if self.wam.params.lockstep else "the arm, held by its driver, waits"
        )
        self.wam.get_logger().info(f"{waiting} for torques on {commands}")
        executor = node_runner.executor_for(self.wam)
        if self.optitrack is not None:
            executor.add_node(self.optitrack)
        if self.wam.params.lockstep:
            self._lockstep(executor, stopped)
        else:
            self._real_time(executor, stopped)

    def _lockstep(self, executor: Executor, ended: Callable[[], bool]) -> None:
        self.wam.on_torque = self._answered
        while not ended():
            waited_ns = time.monotonic_ns() - self._published_ns
            if self._held is not None:
                if waited_ns > IDLE_PERIOD_NS or not self.wam.idle:
                    self._step(self._held)
            elif waited_ns > REPEAT_PERIOD_NS:
                self._publish(self.wam.state())
            executor.spin_once(timeout_sec=0.02)

    def _answered(self, reading: joint_messages.TorqueReading) -> None:
        """Step if this is the torque for the last published state; in idleness later."""
        if reading.stamp_ns != self.wam.stamp_ns:
            self.wam.counters["torques out of step"] += 1
        elif self.wam.idle:
            self._held = reading
        else:
            self._step(reading)

    def _step(self, reading: joint_messages.TorqueReading) -> None:
        self._held = None
        begun_ns = time.monotonic_ns()
        self._publish(self.wam.tick(reading))
        self._statistics.add(begun_ns, self._published_ns)

    def _publish(self, message: object) -> None:
        self.wam.publish(message)
        self._published_ns = time.monotonic_ns()

    def _real_time(self, executor: Executor, ended: Callable[[], bool]) -> None:
        self.wam.on_torque = lambda reading: setattr(self, "_held", reading)
        period_ns = self.wam.params.period_ns
        deadline_ns = time.monotonic_ns() + period_ns
        self.wam.stamp_offset_ns = time.time_ns() - self.wam.world.time_ns  # system clock
        while not ended():
            now = time.monotonic_ns()
            if now < deadline_ns:
                executor.spin_once(timeout_sec=(deadline_ns - now) * 1e-9)
                continue
            reading, self._held = self._held, None
            self.wam.publish(self.wam.tick(reading))
            self._statistics.add(now, time.monotonic_ns())
            deadline_ns += period_ns  # absolute: being late once does not shift the rest
            due_ns = deadline_ns
            if now - due_ns > LAG_MAX_NS:
                self.wam.counters["clock held"] += 1
                deadline_ns = time.monotonic_ns() + period_ns  # leaves the core to others
                self.wam.stamp_offset_ns += deadline_ns - due_ns

    def _report(self) -> None:
        granted = {"real-time scheduling": self._granted.scheduling}
        self.wam.report({**self._statistics.report(), **granted})


def _schedule(priority: int) -> scheduling.Granted:
    """Request real-time scheduling, except on a single core, where nothing else would run."""
    if priority and hasattr(os, "sched_getaffinity") and len(os.sched_getaffinity(0)) == 1:
        return scheduling.Granted("refused: on a single core nothing else would run")
    return scheduling.request(priority)


def main() -> int:
    """Run both stand-ins until a signal, or until a robot appears in their domain."""
    robots = []

    def spin(simulation: Simulation, ended: Callable[[], bool]) -> None:
        simulation.spin(ended)
        if simulation.robot:
            robots.append(simulation.robot)
            simulation.wam.get_logger().fatal(
                f"{simulation.robot}: the simulation ends, as it must not share a domain with a "
                "robot"
            )

    return node_runner.run(Simulation, spin=spin) or (REFUSED if robots else 0)
