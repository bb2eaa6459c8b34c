# SPDX-License-Identifier: Apache-2.0
"""Requests to the simulation: reset the scene, demonstrate, drop the body.

They replace the person in the lab, who puts the pancake back and guides the arm by hand. The ground
truth of a rollout is published when it ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat

import numpy as np
from rclpy.node import Node
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from hardware_sim.settings import ArmSimParams
from hardware_sim.world import World
from wam_power_interfaces.action import Demonstrate, ResetScene
from wam_power_interfaces.msg import GroundTruth
from wam_power_ros.learning import policy as policies
from wam_power_ros.ros import interface
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code, fill
from wam_power_ros.ros.pose_messages import TruthReading, ground_truth_message
from wam_power_ros.ros.stamps import time_message

ROLLOUT = "rollout "  # begins the label of a rollout, before its id
WAIT_TIME = 0.1  # [s] from a reset to its answer, and from a request to a refusal
START_TOLERANCE = 0.05  # [rad] between the arm and q_start for a reset
Steps = Iterator[Answer | None]  # what a request does, a step a tick: None until it is answered


class SceneServices:
    """Actions of a simulated world, see `ResetScene` and `Demonstrate`.

    Attributes:
        label: Activity of the controller, the label of its torques; "" before the first.
        covered: Whether the body is hidden from the cameras, by the hand that puts it back.
    """

    def __init__(self, node: Node, world: World, params: ArmSimParams) -> None:
        self.label, self.covered = "", False
        self._node, self._world, self._seed = node, world, params.seed
        self._lockstep = params.lockstep
        self._demonstrations = 0  # completed
        self._wait_ticks = world.settings.ticks(WAIT_TIME)
        self._under_way: dict[str, Steps] = {}  # by the id of the goal
        self._resetting = False  # in slices
        self._prepared = ""  # id of the rollout that the world was reset for
        body = world.scene.body
        self._truths = node.create_publisher(
            GroundTruth, interface.body_topic(body, "truth"), interface.LATCHED
        )
        self._reset_action = Action(node, ResetScene, interface.RESET_SCENE, self._begin_reset)
        self._demonstration = Action(
            node, Demonstrate, interface.DEMONSTRATE, self._begin_demonstration
        )
        if body:
            node.create_service(Trigger, interface.body_topic(body, "drop"), self._on_drop)

    @property
    def busy(self) -> bool:
        """Whether a request is pending or a demonstration or reset under way."""
        return bool(self._under_way) or not self._world.carried

    def change(self, label: str, stamp_ns: int) -> None:
        """Change the activity of the controller, such as to "rollout trial-0001", with this tick.

        `stamp_ns` is the stamp of the last state.
        """
        previous, self.label = self.label, label
        world = self._world
        if world.frozen and not self._resetting and label not in ("hold", "inactive"):
            world.release()
        if label.startswith(ROLLOUT):
            rollout_id = label.removeprefix(ROLLOUT)
            if rollout_id != self._prepared:
                world.release(rollout_id)
            self._prepared = ""
        if previous.startswith(ROLLOUT):
            truth = TruthReading(previous.removeprefix(ROLLOUT), stamp_ns, world.truth())
            self._truths.publish(ground_truth_message(truth))

    def update(self) -> None:
        """Advance the goals under way; called every tick."""
        for id, steps in [*self._under_way.items()]:
            if (answer := next(steps, Answer(Code.DONE))) is not None:
                del self._under_way[id]
                header = Header(stamp=time_message(self._node.stamp_ns))
                if not self._reset_action.finish(id, answer, header=header):
                    self._demonstration.finish(id, answer)

    def _begin_reset(self, id: str, goal: ResetScene.Goal) -> Answer | None:
        """Reset the scene; in lockstep the world then stays frozen until the next activity.

        Without a policy it waits for gravity compensation, and the arm is put to the start of the
        next demonstration as well.

        Raises:
            ValueError: The policy is not valid, or of another arm.
        """
        world = self._world
        if len(self._reset_action.under_way) > 1:
            return Answer(Code.BUSY, "the scene is being reset")
        if not goal.policy.text:
            if world.pulled:
                return Answer(Code.BUSY, "a demonstration is under way")
            self._under_way[id] = self._reset_for_demonstration()
            return None
        policy = policies.from_json(goal.policy.text)
        if len(policy.q_start) != world.n:
            raise ValueError(f"{policy.id} is for {len(policy.q_start)} joints, not {world.n}")
        if world.pulled or self.label not in ("", "inactive", "hold", "move_to_start"):
            return Answer(Code.BUSY, f"the arm is in use (mode {self.label!r})")
        q = world.joint_state().q
        far = np.abs(q - policy.q_start).max()
        if world.settings.output == "pose":  # the posture is its own, and stays
            far = np.abs(world.tool_pose[0] - world.arm.tool_pose(policy.q_start)[0]).max()
        if far > START_TOLERANCE:
            text = f"the arm is {far:.3f} rad or m from the start of {policy.id}"
            return Answer(Code.NOT_AT_START, text)
        start = q if world.settings.output == "pose" else policy.q_start
        self._under_way[id] = self._reset(policy.id, start)
        return None

    def _begin_demonstration(self, id: str, _: Demonstrate.Goal) -> Answer | None:
        if self._world.pulled or len(self._demonstration.under_way) > 1:
            return Answer(Code.BUSY, "a demonstration is under way")
        self._under_way[id] = self._demonstrate()
        return None

    def _reset(self, rollout_id: str, q: np.ndarray) -> Steps:
        """Freeze and reset the world: now in lockstep, else in slices while the clock goes on.

        Raises:
            ValueError: The posture q (n,) [rad] is outside the limits of the arm.
        """
        slices = self._world.resetting(rollout_id, q)
        self._prepared, self._resetting = rollout_id, not self._lockstep
        return self._settle(iter([*slices]) if self._lockstep else slices)

    def _settle(self, slices: Iterator[None]) -> Steps:
        """Do the slices of a reset; wait until the controller has settled."""
        self.covered = True
        yield from slices
        if self._resetting:
            self._resetting = False
            self._world.release()
        yield from repeat(None, self._wait_ticks)
        self.covered = False

    def _reset_for_demonstration(self) -> Steps:
        yield from self._until_guided()
        rollout_id, home = self._next_demonstration()
        yield from self._carry(home)
        yield from self._reset(rollout_id, home)

    def _demonstrate(self) -> Steps:
        world = self._world
        yield from self._until_guided()
        while self._resetting:
            yield None
        rollout_id, home = self._next_demonstration()
        if world.rollout_id != rollout_id:  # not reset for it yet
            yield from self._carry(home)
            yield from self._until_guided()
            world.reset(rollout_id, home)
        if world.frozen:
            world.release()
        rng = np.random.default_rng((self._seed, self._demonstrations))
        world.attach(world.scene.demonstrator(world.scene.script(rng), *world.tool_pose))
        while world.pulled:
            yield None
        self._demonstrations += 1

    def _until_guided(self) -> Steps:
        """Wait until the arm can be guided; refuse if that takes long."""
        for _ in range(self._wait_ticks + 1):
            if self.label == "gravity_compensation":
                return
            yield None
        yield Answer(Code.BUSY, f"the arm is not free to be guided (mode {self.label!r})")

    def _carry(self, home: np.ndarray) -> Steps:
        """Have the arm carried to a posture (n,) [rad] if it is away from it."""
        if np.abs(self._world.joint_state().q - home).max() > START_TOLERANCE:
            self._world.carry(home)
        while not self._world.carried:
            yield None

    def _next_demonstration(self) -> tuple[str, np.ndarray]:
        """Id and start posture (n,) [rad] of the next demonstration."""
        scene, number = self._world.scene, self._demonstrations
        rng = np.random.default_rng((self._seed, number, 1))
        home = self._world.home + scene.home_sd * rng.standard_normal(self._world.n)
        return f"demonstration-{number}", home

    def _on_drop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        answer = Answer(Code.DONE)
        if self._lockstep or self._world.pulled:
            answer = Answer(Code.REFUSED, "only in real time, and not during a demonstration")
        else:
            self._world.drop()
        return fill(response, answer)
