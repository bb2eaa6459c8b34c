# SPDX-License-Identifier: Apache-2.0
"""Simulated world, controller and tracker in one process, connected by calls instead of topics.

They exchange the same arrays in the same order as the nodes do over DDS, so a rollout with the same
seed and id is bit for bit the same in both.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from hardware_sim.demonstrator import Script
from hardware_sim.ground_truth import Truth
from hardware_sim.settings import ArmSimParams, OptitrackSimParams
from hardware_sim.world import World
from wam_power_ros.control.feasibility import simulate, simulate_policy, speed_margin
from wam_power_ros.control.modes import Mode
from wam_power_ros.control.reference_output import controller_of
from wam_power_ros.control.replay_trajectory import sampled
from wam_power_ros.faults import Fault
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import LEAD_TIME, Rollout, SimulatedRollout
from wam_power_ros.params import overlay
from wam_power_ros.params.body_tracker_params import BodyTrackerParams
from wam_power_ros.params.overlay import Setup
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session_log import Record
from wam_power_ros.tasks.reset import Resetting
from wam_power_ros.tasks.task import Pose, Task
from wam_power_ros.tracking.tracker import Tracker

_STILL = 0.05  # [s] for which the arm is held before a rollout, so that its state repeats
_SEEN = LEAD_TIME * 1e-9  # [s] for which it is held after it has come there: its body is seen
_HELD = 0.15  # [s] for which the arm is held before it is guided, see `control.unexplained_torque`
_FRAME_WAIT = 0.2  # [s] longest wait for the last camera frame of a rollout


class Environment:
    """One simulated arm that executes demonstrations and policies, one at a time.

    Attributes:
        world: Simulated world.
        arm: The controller's model of the arm.
        controller: Torque controller.
        tracker: Tracker of the scene's body.
    """

    def __init__(self, world: World, urdf: str | None = None, setup: Setup | None = None) -> None:
        """Connect a world to a controller and a tracker.

        Args:
            world: Simulated world.
            urdf: Robot description for the controller; the world's if omitted.
            setup: Set-up of controller and tracker; if omitted, that of config/ with the guarded
                of the world.
        """
        self.world = world
        if setup is None:
            region = {"guarded_region": world.settings.guarded_region}
            setup = overlay.setup().changed({"torque_controller": region})
        params = TorqueControllerParams.from_setup(setup)
        self.controller = params.controller(urdf or world.urdf)
        self.arm = self.controller.arm
        self._tracker_settings = BodyTrackerParams.from_setup(setup)
        self.tracker = Tracker(self._tracker_settings)
        self._truth: Truth | None = None  # of the last rollout

    @classmethod
    def from_setup(cls, setup: Setup) -> Environment:
        """Environment of a set-up: stand-ins, controller and tracker as nodes would have them.

        Raises:
            ValueError: A parameter is not acceptable.
        """
        params = ArmSimParams.from_setup(setup), OptitrackSimParams.from_setup(setup)
        return cls(World.from_params(*params), setup=setup)

    def infeasible(self, policy: Policy, limit_stops: int = 0) -> Fault | None:
        """See `practice.ArmModel`."""
        margin = speed_margin(limit_stops)
        return simulate_policy(self.arm, self.controller.settings, policy, margin).fault

    def simulate(self, policy: Policy) -> SimulatedRollout | None:
        """See `practice.ArmModel`."""
        return simulate(self.arm, self.controller.settings, policy)

    def tick(self) -> None:
        """Run one control period: state to torque, torque to state."""
        world = self.world
        stamp_ns, q, qd, _ = world.joint_state()
        mode = self.controller.mode
        tau = self.controller.step(stamp_ns, q, qd)
        if mode is Mode.ROLLOUT and self.controller.mode is not mode:
            self._truth = world.truth()  # before the step, like the stand-in
        world.guided = mode is Mode.GRAVITY_COMPENSATION
        world.step(tau)
        for frame in world.mocap_frames():
            quat_xyzw = frame.quat_xyzw / float(np.linalg.norm(frame.quat_xyzw))  # like a message
            self.tracker.add(frame.stamp_ns, frame.position, quat_xyzw)

    def _tick_for(self, seconds: float) -> None:
        for _ in range(self.world.settings.ticks(seconds)):
            self.tick()

    def demonstrate(self, script: Script, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Let the simulated demonstrator move the gravity-compensated arm from its home posture.

        Returns:
            Stamps (M,) [ns] and joint positions (M, n) [rad] as the driver reported them.
        """
        world = self.world
        self.place(name, world.home)
        controller = self.controller
        self._tick_for(_HELD)
        controller.set_gravity_compensation(True)
        self._tick_for(_STILL)
        world.release()
        world.attach(world.scene.demonstrator(script, *world.tool_pose))
        stamps, q = [], []
        while world.pulled:
            sample = world.joint_state()
            stamps.append(sample.stamp_ns)
            q.append(sample.q)
            self.tick()
        controller.set_gravity_compensation(False)
        return np.array(stamps), np.array(q)

    def run(self, policy: Policy, placed: bool = False) -> tuple[Rollout, Truth]:
        """Execute a policy; return its rollout and the simulator's ground truth.

        Args:
            policy: Policy to execute.
            placed: Whether arm and body are ready as they are, see `reset_body`; otherwise the
                world is reset.
        """
        world = self.world
        if not placed:
            self.place(policy.id, policy.q_start)
        controller = self.controller
        self._move_to_start(policy)
        self._tick_for(_SEEN)
        controller.execute()
        world.release(policy.id if placed else "")
        while controller.mode is Mode.ROLLOUT:
            self.tick()
        truth, start_ns = self._truth, controller.rollout_stamp_ns
        tool = controller.take_finished()
        if tool is None or start_ns is None or truth is None:
            raise RuntimeError(f"rollout {policy.id} has no path")
        body = None
        if world.scene.body:
            end_ns = start_ns + round(float(tool.t[-1]) * 1e9)
            for _ in range(world.settings.ticks(_FRAME_WAIT)):
                if self.tracker.latest_ns >= end_ns:
                    break
                self.tick()
            body = self.tracker.path(policy.id, start_ns, end_ns)
        return Rollout(tool, body, controller.latched, controller.stopped_in), truth

    def _move_to_start(self, policy: Policy) -> None:
        self.controller.load(policy)
        self.controller.move_to_start()
        while not self.controller.ready:
            self.tick()

    def reset_body(self, task: Task, policy: Policy) -> dict[str, Any]:
        """Put the body back without a reset of the world, as `Task.reset` says.

        What needs a person, a reset of the world does.

        Returns:
            Who was needed, "none", "arm" or "person", and the time it took [s], as logged.
        """
        world, controller, begun_ns = self.world, self.controller, self.world.time_ns
        tool = Pose(*self.arm.tool_pose(policy.q_start))
        resetting = Resetting(
            lambda state: task.ready(state, tool),
            lambda state: task.reset(state, self.arm, policy.q_start),
            task.rest_time,
        )
        if world.frozen:
            world.release()
        if controller.latched is not None:
            resetting.by = "person"
        else:
            self._move_to_start(policy)
        seen_ns = self.tracker.latest_ns
        while not resetting.done and resetting.by != "person":
            self.tick()
            if self.tracker.latest_ns == seen_ns:
                continue
            seen_ns = self.tracker.latest_ns
            resetting.add(self.tracker.at(world.time_ns), world.time_ns)
            if (move := resetting.move) is not None:
                settings, limits = controller.settings, controller.limits
                controller.start_replay(sampled(move.t, move.q, settings.period, limits))
                while controller.mode is Mode.REPLAY or not controller.at_rest:
                    self.tick()
                resetting.move = None
                self._move_to_start(policy)
        if resetting.by == "person":
            self.place(policy.id, policy.q_start)
        return {"by": resetting.by, "seconds": round((world.time_ns - begun_ns) * 1e-9, 3)}

    def practise(self, practice: Practice, scene_reset: bool = True) -> Iterator[Record]:
        """Execute the trials of a session one after another, learn from each, yield its record.

        The clock of a record is the simulation's.

        Args:
            practice: The session.
            scene_reset: Whether the world is reset before each rollout; otherwise see `reset_body`.
        """
        while (trial := practice.next_trial()) is not None:
            clock, begun_ns = {}, self.world.time_ns
            if not scene_reset:
                clock["reset"] = self.reset_body(practice.task, trial.policy)
            rollout, truth = self.run(trial.policy, placed=not scene_reset)
            clock["took"] = (self.world.time_ns - begun_ns) * 1e-9
            yield practice.learn(trial, rollout, truth=truth, clock=clock)

    def place(self, rollout_id: str, q_start: np.ndarray) -> None:
        """Reset the world with the arm at a posture and hold it there."""
        self.world.reset(rollout_id, q_start)
        self.controller = controller_of(self.arm, self.controller.settings)
        self.tracker = Tracker(self._tracker_settings)
        self.tick()
        self.controller.hold()
