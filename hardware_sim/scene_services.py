# SPDX-License-Identifier: Apache-2.0
"""Requests to the simulation: reset the scene, demonstrate, drop the body.

They replace the person in the lab, who puts the pancake back and guides the arm by hand. The ground
truth of a rollout is published when it ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from hardware_sim.demonstrator import Demonstrator
from hardware_sim.world import World
from wam_power_ros.learning import policy as policies
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.ros.pose_messages import GroundTruth, ground_truth_message
from wam_power_ros.ros.requests import Request, Server

ROLLOUT = "rollout "  # begins the label of a rollout, before its id
WAIT_TIME = 0.1  # [s] from a reset to its answer, and from a request to a refusal
START_TOLERANCE = 0.05  # [rad] between the arm and q_start for a reset


class SceneServices:
    """Requests to a simulated world.

    "reset" puts the scene back: for the rollout of a policy whose text is given, or else, under
    gravity compensation, for the next demonstration, which "demonstrate" guides.

    Attributes:
        label: Activity of the controller, the label of its torques; "" before the first.

    Args:
        node: Node that offers the services.
        world: World they act on.
        seed: Seed of the demonstrations.
        lockstep: True if the world steps in lockstep; a reset then takes one tick.
        overridden: Returns True while the driver moves the arm itself.
    """

    def __init__(
        self,
        node: Node,
        world: World,
        seed: int,
        lockstep: bool,
        overridden: Callable[[], bool],
    ) -> None:
        self.label = ""
        self._node, self._world, self._seed = node, world, seed
        self._lockstep, self._overridden = lockstep, overridden
        self._demonstrations = 0  # completed
        self._demonstrating = False
        self._awaited = False  # a demonstration whose scene is to be put back
        self._wait_ticks, self._ticks_left = world.settings.ticks(WAIT_TIME), 0
        self._resetting: Iterator[None] | None = None
        self._prepared = ""  # id of the rollout that the world was reset for
        self._put_back_to: tuple[str, np.ndarray] | None = None  # after the arm was carried there
        body = world.scene.body
        self._truths = node.create_publisher(
            String, interface.body_topic(body, "truth"), interface.LATCHED
        )
        begin = {"reset": self._begin_reset, "demonstrate": self._begin_demonstration}
        self._server = Server(node, interface.SCENE_REQUEST, interface.SCENE_ANSWER, begin)
        if body:
            node.create_service(Trigger, interface.body_topic(body, "drop"), self._on_drop)

    @property
    def busy(self) -> bool:
        """Whether a request is pending or a demonstration or reset under way."""
        under_way = self._demonstrating or self._resetting is not None
        return under_way or bool(self._server.pending) or not self._world.carried

    def change(self, label: str, stamp_ns: int) -> None:
        """Change the activity of the controller; a rollout begins or ends with this tick.

        Args:
            label: New activity of the controller, such as "rollout trial-0001".
            stamp_ns: Stamp of the last state [ns].
        """
        previous, self.label = self.label, label
        world = self._world
        if world.frozen and self._resetting is None and label not in ("hold", "inactive"):
            world.release()
        if label.startswith(ROLLOUT):
            rollout_id = label.removeprefix(ROLLOUT)
            if rollout_id != self._prepared:
                world.release(rollout_id)
            self._prepared = ""
        if previous.startswith(ROLLOUT):
            truth = world.truth() | {"id": previous.removeprefix(ROLLOUT)}
            self._truths.publish(ground_truth_message(GroundTruth(stamp_ns, truth)))

    def update(self) -> None:
        """Advance a pending reset or demonstration; called every tick."""
        world, waited = self._world, self._ticks_left == 0
        self._ticks_left = max(0, self._ticks_left - 1)
        if not world.carried:
            self._ticks_left = self._wait_ticks
            return
        if self._put_back_to is not None:
            self._put_back(*self._put_back_to)
            self._put_back_to = None
        if self._resetting is not None and next(self._resetting, self) is self:
            self._resetting = None
            world.release()
        pending, guided = self._server.pending, self.label == "gravity_compensation"
        text = f"the arm is not free to be guided (mode {self.label!r})"
        if self._awaited and (guided or waited):
            self._awaited = False
            if guided:
                self._put_back_for_demonstration()
            else:
                self._server.finish("reset", Answer(Code.BUSY, text))
        elif "reset" in pending and waited and self._resetting is None:
            self._finish("reset")  # the controller has settled by now
        if "demonstrate" in pending and not self._demonstrating:
            if guided and not self._overridden():
                if self._resetting is None:
                    self._grip()
            elif waited:
                self._server.finish("demonstrate", Answer(Code.BUSY, text))
        elif self._demonstrating and not world.pulled:
            self._demonstrating = False
            self._demonstrations += 1
            self._finish("demonstrate")

    def _finish(self, do: str) -> None:
        self._server.finish(do, Answer(Code.DONE, values={"rollout": self._world.rollout_id}))

    def _begin_reset(self, asked: Request) -> Answer | None:
        """Reset the scene; in lockstep the world then stays frozen until the next activity.

        Without a policy it waits for gravity compensation, and the arm is put to the start of the
        next demonstration as well.

        Raises:
            ValueError: The policy is not valid, or of another arm.
        """
        world = self._world
        if "policy" not in asked.about:
            if world.pulled:
                return Answer(Code.BUSY, "a demonstration is under way")
            self._awaited, self._ticks_left = True, self._wait_ticks
            return None
        policy = policies.from_json(asked.about["policy"])
        if len(policy.q_start) != world.n:
            raise ValueError(f"{policy.id} is for {len(policy.q_start)} joints, not {world.n}")
        if world.pulled or self.label not in ("", "inactive", "hold", "move_to_start"):
            return Answer(Code.BUSY, f"the arm is in use (mode {self.label!r})")
        far = np.abs(world.joint_state().q - policy.q_start).max()
        if far > START_TOLERANCE:
            text = f"the arm is {far:.3f} rad from the start of {policy.id}"
            return Answer(Code.NOT_AT_START, text)
        self._put_back(policy.id, policy.q_start)
        return None

    def _put_back_for_demonstration(self) -> None:
        rollout_id, home = self._next_demonstration()
        if self._carry(home):
            self._put_back_to = rollout_id, home
        else:
            self._put_back(rollout_id, home)

    def _carry(self, home: np.ndarray) -> bool:
        """Whether the arm is away from a posture (n,) [rad], so that it is carried there first."""
        far = np.abs(self._world.joint_state().q - home).max() > START_TOLERANCE
        if far:
            self._world.carry(home)
        return bool(far)

    def _put_back(self, rollout_id: str, q: np.ndarray) -> None:
        """Reset the world: at once in lockstep, else in slices while the clock goes on."""
        if self._lockstep:
            self._world.reset(rollout_id, q)
        else:
            self._resetting = self._world.resetting(rollout_id, q)
        self._prepared, self._ticks_left = rollout_id, self._wait_ticks

    def _begin_demonstration(self, _: Request) -> Answer | None:
        self._ticks_left = self._wait_ticks
        busy = self._world.pulled
        return Answer(Code.BUSY, "a demonstration is under way") if busy else None

    def _grip(self) -> None:
        """Begin the next demonstration."""
        world = self._world
        rollout_id, home = self._next_demonstration()
        if world.rollout_id != rollout_id:  # not reset for it yet
            if self._carry(home):
                return
            world.reset(rollout_id, home)
        rng = np.random.default_rng((self._seed, self._demonstrations))
        if world.frozen:
            world.release()
        world.attach(Demonstrator(world.scene.script(rng), *world.tool_pose))
        self._demonstrating = True

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
        response.success, response.message = answer.success, str(answer)
        return response
