# SPDX-License-Identifier: Apache-2.0
"""An arm as a Python object, for scripts, notebooks and the console.

It calls the services of running nodes. A call returns when the motion has ended; Ctrl-C, or the
interrupt of a notebook, stops the arm. It is no safety function.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import rclpy
from rclpy.context import Context
from sensor_msgs.msg import JointState

from wam_power_interfaces.action import Demonstrate, Replay, ResetScene
from wam_power_ros.bags import reader
from wam_power_ros.client.actions import ACCEPT_TIMEOUT, Action
from wam_power_ros.client.link import TIMEOUT, Link
from wam_power_ros.client.reports import ControllerReports
from wam_power_ros.client.rollouts import Executed, Ready, Rollouts, RolloutSettings
from wam_power_ros.control import replay_trajectory
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface
from wam_power_ros.ros.joint_messages import JointMovement, JointStateReader, movement_message
from wam_power_ros.ros.node_runner import participant
from wam_power_ros.ros.outcomes import Answer, Code, ServiceError

RECORDER = "demonstration_recorder"  # node
MOVE_TIMEOUT = 3600.0  # [s of wall time]
RETRY_PERIOD = 0.05  # [s of wall time] between requests to a controller that is still starting
TAKE_PERIOD = 0.002  # [s of wall time] between looks for the next state
REST_TIMES = np.linspace(0.0, 0.1, 6)  # [s] of a movement that rests at one posture


class Stopped(KeyboardInterrupt):
    """An interrupt after which the arm was stopped, with the controller's answer, if one came."""

    def __init__(self, answer: Answer | None) -> None:
        super().__init__(answer.text if answer else "")
        self.answer = answer


@dataclass(frozen=True, eq=False)
class RobotState:
    """State of an arm."""

    q: np.ndarray  # joint angles [rad]. Shape (n,)
    qd: np.ndarray | None  # joint speeds [rad/s], None if the driver sends none. Shape (n,)
    position: np.ndarray  # of the tool in the base frame [m]. Shape (3,)
    rotation: np.ndarray  # axes of the tool as columns. Shape (3, 3)
    mode: str  # of the controller in its last report, sent once a second; "" before the first
    report: str  # its text, such as a fault


class Robot:
    """An arm whose nodes are running, see `connect`.

    Publishers and clients are made when they are used. Every method raises ServiceError if a
    service does not appear, does not answer in time or refuses. `settle_time` [s] after the
    movement of a policy belongs to its rollout.
    """

    def __init__(
        self,
        link: Link,
        state_topic: str = interface.JOINT_STATES,
        joint_names: Sequence[str] = (),
        body: str = "",
        arm: Arm | None = None,
        settings: RolloutSettings | None = None,
        settle_time: float = 0.0,
    ) -> None:
        self.link, self.joint_names, self.arm = link, tuple(joint_names), arm
        self._state_topic, self._body = state_topic, body
        self._settings, self._settle_time = settings, settle_time

    # State

    @cached_property
    def _take(self) -> Callable[[], JointState | None]:
        return self.link.poll_latest(JointState, self._state_topic)

    @cached_property
    def _reports(self) -> ControllerReports:
        return ControllerReports(self.link)

    def state(self) -> RobotState:
        """Wait for the next state of the driver; a ValueError if it is not valid."""
        self._take()  # an old state
        deadline = time.monotonic() + TIMEOUT
        while (message := self._take()) is None:
            if time.monotonic() > deadline:
                raise ServiceError(f"no state on {self._state_topic} in {TIMEOUT:.0f} s")
            time.sleep(TAKE_PERIOD)
        reading = JointStateReader(self.joint_names)(message)
        if reading is None:
            raise ValueError(f"{self._state_topic} has none of the joints {self.joint_names}")
        position, rotation = self.arm.tool_pose(reading.q)
        said = self._reports
        return RobotState(reading.q, reading.qd, position, rotation, said.mode, said.text)

    # Movements

    def move_to(self, q: Sequence[float]) -> None:
        """Move to joint angles [rad], shape (n,), at the controller's move speed, and hold.

        Raises:
            ValueError: The number of angles is wrong, or an angle is beyond its limits.
        """
        q, low, high = np.asarray(q, dtype=float), self.arm.q_min, self.arm.q_max
        if q.shape != low.shape or not np.all((q >= low) & (q <= high)):
            limits = f"{low.tolist()} to {high.tolist()}"
            raise ValueError(f"q {q.tolist()} must be {len(low)} angles within {limits}")
        self.follow(REST_TIMES, np.tile(q, (len(REST_TIMES), 1)))

    def replay(self, bag: Path | str, speed: float = 1.0) -> str:
        """Replay a recorded movement, at a speed relative to the recording; see `follow`.

        Raises:
            ValueError: The bag or the speed is not acceptable.
        """
        recorded = reader.read_demonstration(bag, self.joint_names, arm=self.arm.identity())
        return self.follow(*replay_trajectory.movement(*recorded, speed))

    def follow(self, t: np.ndarray, q: np.ndarray) -> str:
        """Move to the start of a movement, follow it and hold.

        Args:
            t: Times [s]. Shape (N,).
            q: Joint angles [rad]. Shape (N, n).

        Returns:
            Tracking error as text, reported by the controller.

        Raises:
            Stopped: After an interrupt.
        """
        movement, goal = movement_message(self.joint_names, JointMovement(t, q)), None
        try:
            self.stop()  # succeeds once the controller is active
            deadline = time.monotonic() + TIMEOUT
            while True:
                goal = self._replays.send(movement=movement)
                try:
                    return str(goal.done(MOVE_TIMEOUT).outcome.text)
                except ServiceError as error:
                    if error.answer.code is not Code.NOT_ACTIVE or time.monotonic() > deadline:
                        raise
                    goal, active = None, self.link.call(interface.STOP)
                    if active is None or not active.success:
                        raise
                self.link.sleep(RETRY_PERIOD)  # its process that reads movements still starts
        except KeyboardInterrupt:
            self._stop(self._replays)
            if goal is not None:
                self.link.until(lambda: goal.ended, "the end of the movement")
            raise Stopped(goal and goal.answer) from None

    def rollout(self, policy: Policy, ready: Ready = lambda state: "") -> Executed:
        """Move to the start of a policy, execute it once, when the body is `Task.ready`, and hold.

        Raises:
            Stopped: After an interrupt.
            EndedByPersonError: A person has stopped the arm otherwise.
        """
        try:
            return self._rollouts.execute(policy, policy.basis.duration + self._settle_time, ready)
        except KeyboardInterrupt:
            self._stop(*self._rollouts.motions)
            raise Stopped(None) from None

    def _stop(self, *motions: Action) -> None:
        """Stop, and again once a goal on its way has been accepted: it may begin in between."""
        self.stop()
        all_answered = lambda: all(action.answered for action in motions)  # noqa: E731
        if not all_answered():
            self.link.until(all_answered, "a goal to be accepted", ACCEPT_TIMEOUT)
            self.stop()

    def stop(self) -> None:
        """End any movement and hold; no safety function."""
        self.link.call_until_success(interface.STOP)

    def reset(self) -> None:
        """Reset a fault of the controller; the arm must be at rest."""
        self.link.call_until_success(interface.RESET)

    @cached_property
    def _replays(self) -> Action:
        return Action(self.link, Replay, interface.REPLAY_MOVEMENT)

    @cached_property
    def scene_reset(self) -> Action:
        """Reset of a simulated scene."""
        return Action(self.link, ResetScene, interface.RESET_SCENE)

    @cached_property
    def demonstrator(self) -> Action:
        """Person of a simulated scene, who guides the arm."""
        return Action(self.link, Demonstrate, interface.DEMONSTRATE)

    @cached_property
    def _rollouts(self) -> Rollouts:
        return Rollouts(self.link, self._settings, self._body)

    # Demonstrations

    def teach(self, wait_for_end: Callable[[], object] | None = None) -> Path:
        """Record a demonstration under gravity compensation; the arm holds afterwards.

        `wait_for_end` returns when the person has finished guiding the arm by hand, such as
        `lambda: input("Enter")`; None for the simulated demonstrator.
        """
        self.await_recorder()
        with self.guided():
            return self.take(wait_for_end)

    def take(self, wait_for_end: Callable[[], object] | None = None) -> Path:
        """Record a demonstration of an arm that is `guided` already; see `teach`."""
        if wait_for_end is None:
            self.scene_reset.send().done()
        with self.record() as bag:
            if wait_for_end is None:
                self.demonstrator.send().done(MOVE_TIMEOUT)
            else:
                wait_for_end()
        return bag

    def await_recorder(self) -> None:
        """Wait until the recorder has subscribed to the states, later than its service appears."""
        subscribers = self.link.node.get_subscriptions_info_by_topic

        def subscribed() -> bool:
            return RECORDER in {info.node_name for info in subscribers(self._state_topic)}

        if not self.link.until(subscribed, f"the subscription of {RECORDER}"):
            raise ServiceError(f"{RECORDER} did not subscribe to the joint states")

    @contextmanager
    def guided(self) -> Iterator[None]:
        """Gravity compensation within a `with` block; the arm holds afterwards."""
        self.link.call_until_success(interface.GRAVITY_COMPENSATION, True)
        try:
            yield
        finally:
            self.link.call_until_success(interface.GRAVITY_COMPENSATION, False)

    @contextmanager
    def record(self) -> Iterator[Path]:
        """Record within a `with` block; yields the path of the bag, complete afterwards."""
        bag = Path(self.link.call_until_success(interface.RECORD, True).text)
        try:
            yield bag
        finally:
            self.link.call_until_success(interface.RECORD, False)


@contextmanager
def connect(*config: str, namespace: str = "", domain: int | None = None) -> Iterator[Robot]:
    """Connect to an arm whose nodes run, with the set-ups that they were started with.

    Args:
        namespace: Namespace of the nodes, such as `left`.
        domain: DDS domain of the nodes; that of ROS_DOMAIN_ID by default.

    Raises:
        ValueError: A set-up is unknown, or none names a URDF.
    """
    setup = overlay.setup(config)
    if not setup["torque_controller"]["urdf"]:
        raise ValueError("the set-up names no urdf: give the one of the nodes")
    with connected(setup, domain, namespace) as robot:
        yield robot


@contextmanager
def connected(
    setup: overlay.Setup, domain: int | None, namespace: str = "", on_loopback: bool = False
) -> Iterator[Robot]:
    """Connect to the nodes of a set-up; see `node_runner.participant` for the arguments."""
    controller, context = setup["torque_controller"], Context()
    make = lambda: rclpy.create_node("robot", namespace=namespace, context=context)  # noqa: E731
    with participant(make, domain, context, on_loopback) as node, Link(node) as link:
        of_arm = controller["state_topic"], controller["joint_names"]
        body, settings = setup["pancake_tracker"]["body"], RolloutSettings(**setup["learner"])
        yield Robot(link, *of_arm, body, setup.arm(), settings, float(controller["settle_time"]))
