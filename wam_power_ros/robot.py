# SPDX-License-Identifier: Apache-2.0
"""An arm as a Python object, for scripts and notebooks.

It uses the same services as the command line, of running nodes (`connect`) or of stand-ins that it
starts (`simulated`). A call returns when the motion has ended; Ctrl-C, or the interrupt of a
notebook, stops the arm. It is no safety function.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from wam_power_ros.bags import reader
from wam_power_ros.cli import launcher
from wam_power_ros.cli.plan import CONTROLLER, RECORDER, TRACKER, plan_of
from wam_power_ros.control import replay_trajectory
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.policy import Policy
from wam_power_ros.nodes.learner import LearnerParams
from wam_power_ros.nodes.rollout_client import Executed, Ready, RolloutClient
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share
from wam_power_ros.ros import diagnostics, interface
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.ros.joint_messages import JointMovement, JointStateReader, movement_message
from wam_power_ros.ros.node_runner import participant
from wam_power_ros.ros.service_client import ServiceClient, ServiceError

STATE_TIMEOUT = 60.0  # [s of wall time] for a joint state or a receipt; nodes may be starting
MOVE_TIMEOUT = 3600.0  # [s of wall time]
BUSY_RETRY_PERIOD = 0.1  # [s of wall time] between requests to a busy controller
CALLBACKS_MAX = 8  # per call of `state`
REST_TIMES = np.linspace(0.0, 0.1, 6)  # [s] of a movement that rests at one posture


@dataclass(frozen=True, eq=False)
class RobotState:
    """State of an arm.

    Attributes:
        q: Joint angles [rad]. Shape (n,).
        qd: Joint speeds [rad/s], None if the driver sends none. Shape (n,).
        position: Position of the tool in the base frame [m]. Shape (3,).
        rotation: Axes of the tool as columns. Shape (3, 3).
        mode: Mode of the controller in its last report, sent once a second; "" before the first.
        report: Text of that report, such as a fault; "" before the first.
    """

    q: np.ndarray
    qd: np.ndarray | None
    position: np.ndarray
    rotation: np.ndarray
    mode: str
    report: str


class Robot:
    """An arm whose nodes are running; created by `connect` or `simulated`.

    Attributes:
        arm: Model of the arm.
        joint_names: Joint names of the driver, base to tip.

    Args:
        node: Node that nothing else spins.
        setup: Parameters of the arm's nodes.
    """

    def __init__(self, node: Node, setup: overlay.Setup) -> None:
        controller, body = setup[CONTROLLER], setup["pancake_tracker"]["body"]
        self.arm = Arm(
            share(controller["urdf"]).read_text(),
            controller["model_joint_names"],
            controller["tool_frame"],
            guarded=(),
        )
        self.joint_names = tuple(controller["joint_names"])
        self._settle_time = float(controller["settle_time"])
        self._state_topic = controller["state_topic"]
        self._node = node
        self._read = JointStateReader(self.joint_names)
        self._states: list[JointState] = []
        self._mode = self._report = ""
        self._executor = executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        self._calls = ServiceClient(node, executor)
        learner = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in setup["learner"].items()
            if name in LearnerParams.model_fields
        }
        self._rollouts = RolloutClient(node, executor, LearnerParams(**learner), body)
        self._reset = interface.body_topic(body, "reset")
        self._movements = node.create_publisher(
            JointTrajectory, interface.REPLAY_TRAJECTORY, interface.LATCHED
        )
        # Spun by `state` alone: callbacks for 500 states a second would use a whole core.
        newest = QoSProfile(depth=1, reliability=interface.STATE_IN.reliability)
        listener = rclpy.create_node(
            "robot_states", namespace=node.get_namespace(), context=node.context
        )
        listener.create_subscription(JointState, self._state_topic, self._on_state, newest)
        self._listener_executor = SingleThreadedExecutor(context=node.context)
        self._listener_executor.add_node(listener)
        node.context.on_shutdown(self._listener_executor.shutdown)
        node.create_subscription(
            DiagnosticArray, interface.DIAGNOSTICS, self._on_report, interface.DIAGNOSTICS_QOS
        )

    def state(self) -> RobotState:
        """Wait for the next state of the driver.

        Raises:
            ServiceError: No state is received in time.
            ValueError: The state is not valid.
        """
        self._listener_executor.spin_once(timeout_sec=0.0)  # discards an old state
        self._states.clear()
        deadline = time.monotonic() + STATE_TIMEOUT
        while not self._states:
            self._listener_executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > deadline:
                raise ServiceError(f"no state on {self._state_topic} in {STATE_TIMEOUT:.0f} s")
        for _ in range(CALLBACKS_MAX):
            self._executor.spin_once(timeout_sec=0.0)
        reading = self._read(self._states[-1])
        if reading is None:
            raise ValueError(f"{self._state_topic} has none of the joints {self.joint_names}")
        position, rotation = self.arm.tool_pose(reading.q)
        return RobotState(reading.q, reading.qd, position, rotation, self._mode, self._report)

    def move_to(self, q: Sequence[float]) -> None:
        """Move to joint angles [rad], shape (n,), at the controller's move speed, and hold.

        Raises:
            ValueError: The number of angles is wrong, or an angle is beyond its limits.
            ServiceError: The controller refuses, or the arm did not arrive.
        """
        q = np.asarray(q, dtype=float)
        low, high = self.arm.q_min, self.arm.q_max
        if q.shape != low.shape or not np.all((q >= low) & (q <= high)):
            limits = f"{low.tolist()} to {high.tolist()}"
            raise ValueError(f"q {q.tolist()} must be {len(low)} angles within {limits}")
        self._follow(REST_TIMES, np.tile(q, (len(REST_TIMES), 1)))

    def teach(self, lead: Callable[[], object] | None = None) -> Path:
        """Record a demonstration under gravity compensation; the arm holds afterwards.

        Args:
            lead: Returns when the person has finished guiding the arm by hand, such as
                `lambda: input("Enter")`; None for the simulated demonstrator.

        Returns:
            Path of the bag.

        Raises:
            ServiceError: A service refuses or does not answer.
        """
        if not self._calls.until(self._recorder_subscribed, f"discovery by {RECORDER}"):
            raise ServiceError(f"{RECORDER} did not subscribe to the joint states")
        insist = self._calls.insist
        insist(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=True))
        try:
            if lead is None:
                insist(Trigger, self._reset)
            insist(SetBool, interface.RECORD, SetBool.Request(data=True))
            try:
                if lead is None:
                    insist(Trigger, interface.DEMONSTRATE)
                else:
                    lead()
            finally:
                bag = insist(SetBool, interface.RECORD, SetBool.Request(data=False)).text
        finally:
            insist(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=False))
        return Path(bag)

    def replay(self, bag: Path | str, speed: float = 1.0) -> str:
        """Replay a recorded movement and hold.

        Args:
            bag: Path of a bag with joint states of this arm.
            speed: Speed relative to the recording.

        Returns:
            Tracking error as text, reported by the controller.

        Raises:
            ValueError: The bag or the speed is not acceptable.
            ServiceError: The controller refuses, or the movement did not finish.
        """
        recorded = reader.read_demonstration(bag, self.joint_names, arm=self.arm.identity())
        return self._follow(*replay_trajectory.movement(*recorded, speed)).text

    def rollout(self, policy: Policy, ready: Ready = lambda state: "") -> Executed:
        """Move to the start of a policy, execute it once and hold.

        Args:
            policy: Policy to execute.
            ready: Returns what is missing before it may begin, given the state of the tracked body,
                as `Task.ready` does; "" for nothing.

        Returns:
            Paths of tool and body, fault if any, bag, and ground truth of a simulation.

        Raises:
            RolloutError: The rollout could not begin, or did not end in time.
        """
        duration = policy.basis.duration + self._settle_time
        with self._stopping():
            return self._rollouts.execute(policy, duration, ready)

    def stop(self) -> None:
        """End any movement and hold; no safety function.

        Raises:
            ServiceError: The controller refuses or does not answer.
        """
        self._calls.insist(Trigger, interface.STOP)

    def _follow(self, t: np.ndarray, q: np.ndarray) -> Answer:
        """Move to the start of a movement, follow it and hold.

        Args:
            t: Times [s]. Shape (N,).
            q: Joint angles [rad]. Shape (N, n).
        """
        self.stop()  # succeeds once the controller is active
        topic, subscribed = interface.REPLAY_TRAJECTORY, self._movements.get_subscription_count
        if not self._calls.until(subscribed, f"a subscriber of {topic}", STATE_TIMEOUT):
            raise ServiceError(f"{topic} has no subscriber: is the controller running?")
        self._movements.publish(movement_message(self.joint_names, JointMovement(t, q)))
        # Topics and services are not ordered: without this the last movement might be repeated.
        if not self._movements.wait_for_all_acked(Duration(seconds=STATE_TIMEOUT)):
            raise ServiceError(f"the movement on {topic} was not received")
        answer = self._request_replay()
        if answer is None or answer.code is not Code.DONE:
            raise ServiceError(f"{interface.REPLAY}: {answer or 'no answer'}")
        return answer

    def _request_replay(self) -> Answer | None:
        """Answer to a replay, requested again while the controller has not read the movement."""
        deadline = time.monotonic() + STATE_TIMEOUT
        with self._stopping():
            while True:
                answer = self._calls.call(Trigger, interface.REPLAY, timeout=MOVE_TIMEOUT)
                if answer is None or answer.code is not Code.BUSY or time.monotonic() > deadline:
                    return answer
                time.sleep(BUSY_RETRY_PERIOD)

    @contextmanager
    def _stopping(self) -> Iterator[None]:
        """Stop the arm on an interrupt."""
        try:
            yield
        except KeyboardInterrupt:
            self.stop()
            raise

    def _recorder_subscribed(self) -> bool:
        infos = self._node.get_subscriptions_info_by_topic(self._state_topic)
        return RECORDER in {info.node_name for info in infos}

    def _on_state(self, message: JointState) -> None:
        self._states = [message]

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = diagnostics.of_controller(self._node.get_namespace(), status)
            if values is not None:
                self._mode, self._report = values.get("mode", ""), status.message


@contextmanager
def connect(*config: str, namespace: str = "") -> Iterator[Robot]:
    """Connect to an arm whose nodes run in this DDS domain.

    Args:
        config: Set-ups with which the nodes were started.
        namespace: Namespace of the nodes, such as `left`.

    Raises:
        ValueError: A set-up is unknown, or none names a URDF.
    """
    setup = overlay.setup(config)
    if not setup[CONTROLLER]["urdf"]:
        raise ValueError(f"none of the set-ups {list(config)} names a urdf")
    make = lambda: rclpy.create_node("robot", namespace=namespace)  # noqa: E731
    with participant(make, SignalHandlerOptions.NO) as node:
        yield Robot(node, setup)


@contextmanager
def simulated(folder: Path | str, task: str = "flip", seed: int = 0) -> Iterator[Robot]:
    """Start an arm's nodes and stand-ins, in a DDS domain of their own.

    Args:
        folder: Folder for bags and logs.
        task: Name of the task whose scene is simulated.
        seed: Seed of the simulation.

    Raises:
        UsageError: Another launcher uses the folder, or its disk is nearly full.
        ValueError: There is no such task.
    """
    folder, before = Path(folder).resolve(), dict(os.environ)
    parameters = launcher.Devices().parameters(task, seed, folder)
    plan = plan_of(folder, parameters, stand_ins=True, also=[TRACKER])
    try:
        with launcher.launch(plan):
            os.environ |= launcher.session_environment(folder)
            with participant(lambda: rclpy.create_node("robot"), SignalHandlerOptions.NO) as node:
                yield Robot(node, plan.parameters)
    finally:
        os.environ.clear()
        os.environ.update(before)
