# SPDX-License-Identifier: Apache-2.0
"""The bench in one process: stand-in world, controller and tracker wired by calls, not topics.

What the nodes exchange over DDS passes here as arrays, in the same order and through the same
core, so a rollout of one seed and id comes out bit for bit as it does there.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import yaml

from hardware_sim.demonstrator import Demonstrator, Script
from hardware_sim.ground_truth import Truth
from hardware_sim.world import World
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.feasibility import simulate_policy
from wam_power_ros.control.modes import Mode
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Fault, Rollout
from wam_power_ros.params.resources import share
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.tracking.tracker import Tracker, TrackerSettings

_STILL_TICKS = 25  # ticks a held arm repeats its state before a rollout begins
_LATE_TICKS = 100  # that are waited at most for the rollout's last frame, as frames come late


def tracker_settings() -> TrackerSettings:
    """The tracker's settings of config/pancake_tracker.yaml."""
    text = share("config/pancake_tracker.yaml").read_text()
    (values,) = (node["ros__parameters"] for node in yaml.safe_load(text).values())
    names = {field.name for field in dataclasses.fields(TrackerSettings)}
    return TrackerSettings(**{name: values[name] for name in names})


class Environment:
    """One arm on which policies are tried, one at a time."""

    def __init__(
        self,
        world: World,
        settings: ControllerSettings | None = None,
        urdf: str | None = None,
    ) -> None:
        """Wire `world` to a controller and a tracker of its own, set as config/ sets the nodes.

        Args:
            world: where it happens.
            settings: of the controller, those of config/ when omitted.
            urdf: the arm as the controller believes it to be; as it is when omitted.
        """
        self.world = world
        file = share("config/torque_controller.yaml")
        as_set = TorqueControllerParams.of_file(file, "torque_controller").controller(
            urdf or world.urdf
        )
        self.arm = as_set.arm
        self.controller = Controller(self.arm, settings or as_set.settings)
        self._tracker_settings = tracker_settings()
        self.tracker = Tracker(self._tracker_settings)
        self._truth: Truth | None = None  # of the last rollout

    def infeasible(self, policy: Policy) -> Fault | None:
        """Fault in which a simulated execution of a policy ends, None when there is none."""
        return simulate_policy(self.arm, self.controller.settings, policy).fault

    def tool_position(self, q: np.ndarray) -> np.ndarray:
        """Position of the tool at joint angles q [m]. Shape (3,)."""
        return self.arm.tool_pose(q)[0]

    def tick(self) -> None:
        """State to torque, torque to state."""
        world = self.world
        stamp_ns, q, qd, _ = world.joint_state()
        was = self.controller.mode
        tau = self.controller.step(stamp_ns, q, qd)
        if was is Mode.ROLLOUT and self.controller.mode is not was:
            self._truth = world.truth()  # before the step, as the stand-in tells it
        world.step(tau)
        for frame in world.mocap_frames():
            quat_xyzw = frame.quat_xyzw / float(np.linalg.norm(frame.quat_xyzw))  # as a message
            self.tracker.add(frame.stamp_ns, frame.position, quat_xyzw)

    def demonstrate(self, script: Script, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Let a hand move the gravity-compensated arm from home.

        Returns:
            Stamps (M,) [ns] and joint positions (M, 7) [rad] as the driver reported them.
        """
        world = self.world
        self._place(name, world.scene.home)
        controller = self.controller
        controller.set_gravity_compensation(True)
        for _ in range(_STILL_TICKS):
            self.tick()
        world.release()
        world.attach(Demonstrator(script, *world.pan_pose))
        stamps, q = [], []
        while world.pulled:
            sample = world.joint_state()
            stamps.append(sample.stamp_ns)
            q.append(sample.q)
            self.tick()
        controller.set_gravity_compensation(False)
        return np.array(stamps), np.array(q)

    def run(self, policy: Policy) -> tuple[Rollout, Truth]:
        """Execute a policy; returns its rollout and the simulator's ground truth."""
        world = self.world
        self._place(policy.id, policy.q_start)
        controller = self.controller
        controller.load(policy)
        controller.move_to_start()
        while not controller.ready:
            self.tick()
        for _ in range(_STILL_TICKS):
            self.tick()
        controller.execute()
        world.release()
        while controller.mode is Mode.ROLLOUT:
            self.tick()
        truth = self._truth
        pan = controller.take_finished()
        start_ns = controller.rollout_stamp_ns
        if pan is None or start_ns is None or truth is None:
            raise RuntimeError(f"rollout {policy.id} left no path")
        end_ns = start_ns + round(float(pan.t[-1]) * 1e9)
        for _ in range(_LATE_TICKS):
            if self.tracker.latest_ns >= end_ns:
                break
            self.tick()
        pancake = self.tracker.path(policy.id, start_ns, end_ns)
        return Rollout(pan, pancake, controller.latched), truth

    def _place(self, rollout_id: str, q_start: np.ndarray) -> None:
        """Hold the arm still at a place it has been put to; only a stand-in can do that."""
        self.world.reset(rollout_id, q_start)
        self.controller = Controller(self.arm, self.controller.settings)
        self.tracker = Tracker(self._tracker_settings)
        self.tick()
        self.controller.hold()
