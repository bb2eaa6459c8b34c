# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the node tests: a private DDS domain a test, real processes that always end."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeVar

import forked
import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import settings
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectory

from wam_power_interfaces.action import Demonstrate, ExecutePolicy, MoveToStart, Replay, ResetScene
from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros import rotations
from wam_power_ros.client.link import DISCOVERY, Link
from wam_power_ros.client.robot import Robot
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.policy import Basis, Policy, to_json
from wam_power_ros.ros import interface, network
from wam_power_ros.ros.domain import private_domain, shared
from wam_power_ros.ros.outcomes import Answer, read
from wam_power_ros.ros.stamps import goal_id

network.restrict_to_loopback(os.environ)  # this process, too
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # started in the background by a shell
    signal.signal(signal.SIGINT, signal.default_int_handler)  # tests interrupt processes
settings.register_profile("any machine", deadline=None)  # however busy it is
settings.load_profile("any machine")
T = TypeVar("T")
Process = subprocess.Popen[bytes] | forked.Forked
ROOT = Path(__file__).resolve().parents[1]

# With Fast DDS 3 a process that is forked after its library was loaded ends with a crash.
FORKED = forked.MODULES if network.profile() is network.FAST_DDS_2 else ()


def python_path(*first: Path) -> str:
    """PYTHONPATH of a process: these folders, or the root, before those of a sourced ROS."""
    folders = map(str, first or (ROOT,))
    return os.pathsep.join(filter(None, [*folders, os.environ.get("PYTHONPATH", "")]))


# Folders whose tests take longest, longest first; the rest takes seconds a file.
SLOW = (
    "system",
    "benchmark",
    "nodes",
    "reproduction",
    "examples",
    "in_process",
    "hardware_sim",
    "console",
    "view",
    "test",
    "practice",
)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files without a test of the one mark that is asked for: some 300 of them."""
    asked, name = config.option.markexpr, collection_path.name
    if asked not in ("long", "alone") or not name.startswith("test_"):
        return None
    return True if f"mark.{asked}" not in collection_path.read_text() else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the slow folders first: a worker that is left with one at the end keeps all waiting."""
    rank = {folder: number for number, folder in enumerate(SLOW)}
    items.sort(key=lambda item: rank.get(Path(item.path).parent.name, len(SLOW)))


@pytest.fixture(autouse=True)
def plain_scheduling() -> Iterator[None]:
    """Fail a test after which this process has real-time priority: it would starve the others."""
    yield
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A DDS domain nobody else on this machine uses, for as long as the test runs."""
    with private_domain() as domain:
        yield domain


ACTIONS = {
    "move_to_start": (MoveToStart, interface.MOVE_TO_START),
    "execute": (ExecutePolicy, interface.EXECUTE_POLICY),
    "replay": (Replay, interface.REPLAY_MOVEMENT),
    "follow": (FollowJointTrajectory, interface.FOLLOW_TRAJECTORY),
    "reset": (ResetScene, interface.RESET_SCENE),
    "demonstrate": (Demonstrate, interface.DEMONSTRATE),
}


class Sent:
    """A goal of the test.

    Attributes:
        stages: Stages that it has reported: one once the arm moves.
        status: Status at its end, as of `GoalStatus`; 0 before.
        result: Its result, None before its end.
    """

    def __init__(self) -> None:
        self.stages: list[str] = []
        self.status = GoalStatus.STATUS_UNKNOWN
        self.result: Any = None
        self.handle: Any = None  # of the client, None before it is accepted

    def accepted(self, sent: Future) -> None:
        """Ask for the result."""
        self.handle = sent.result()
        self.handle.get_result_async().add_done_callback(self._ended)

    def _ended(self, asked: Future) -> None:
        self.status, self.result = asked.result().status, asked.result().result

    @property
    def answer(self) -> Answer | None:
        """Its outcome, None before its end."""
        return None if self.result is None else read(self.result.outcome)

    @property
    def begun(self) -> bool:
        """Whether its movement has begun or it has ended."""
        return bool(self.stages) or self.result is not None


class Probe:
    """A node of the test: publishes, listens and calls services, each wait with a deadline."""

    def __init__(self, domain_id: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.node = rclpy.create_node("probe", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}
        self._others: list[Node] = []
        self._actions: dict[str, ActionClient] = {}

    def listen(self, message_type: type, topic: str, qos: QoSProfile) -> list[Any]:
        """Subscribe; the list grows by every message that comes in."""
        received: list[Any] = []
        self.node.create_subscription(message_type, topic, received.append, qos)
        return received

    def diagnostics(self) -> list[DiagnosticArray]:
        """Listen to the diagnostics of all nodes."""
        return self.listen(DiagnosticArray, interface.DIAGNOSTICS, interface.STATE_OUT)

    def publisher(
        self, message_type: type, topic: str, qos: QoSProfile, readers: int = 1, node: str = ""
    ) -> Publisher:
        """A publisher, of a node of its own if named, once `readers` subscriptions match."""
        if node:
            self._others.append(rclpy.create_node(node, context=self.context))
        owner = self._others[-1] if node else self.node
        publisher = owner.create_publisher(message_type, topic, qos)
        self.until(lambda: publisher.get_subscription_count() >= readers, f"readers of {topic}")
        self.spin(0.1)  # a reader that has not matched us yet loses what we send
        return publisher

    def spin(self, seconds: float) -> None:
        """Dispatch callbacks for a while [s of wall time]."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def until(self, condition: Callable[[], T], what: str, deadline: float = 60.0) -> T:
        """Dispatch callbacks until `condition()` is true, fail after `deadline` [s]."""
        end = time.monotonic() + deadline
        while not (result := condition()):
            if time.monotonic() > end:
                pytest.fail(f"not within {deadline} s: {what}")
            self._executor.spin_once(timeout_sec=0.02)
        return result

    def begin(self, service_type: type, name: str, request: object = None) -> Future:
        """Call a service and return the future of its response."""
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.node.create_client(service_type, name)
        if not client.service_is_ready():
            self.until(client.service_is_ready, f"service {name}")
            self.spin(DISCOVERY)
        return client.call_async(service_type.Request() if request is None else request)

    def call(
        self, service_type: type, name: str, request: object = None, deadline: float = 60.0
    ) -> Any:  # noqa: ANN401 (each service has its own type)
        """Call a service and wait for its response."""
        future = self.begin(service_type, name, request)
        self.until(future.done, f"answer of {name}", deadline)
        return future.result()

    def change(self, transition: int, node: str = "torque_controller") -> bool:
        """Whether a transition of the life cycle of a node succeeds."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, f"{node}/change_state", request).success)

    def ask(
        self, do: str, policy: Policy | str | None = None, id: str = "", **goal: object
    ) -> Sent:
        """Send a goal of an action of `ACTIONS`, about a policy, or a text instead, of an id."""
        kind, name = ACTIONS[do]
        if do not in self._actions:
            self._actions[do] = ActionClient(self.node, kind, name)
            self.until(self._actions[do].server_is_ready, f"action {name}")
            self.spin(DISCOVERY)
        if policy is not None:
            text = policy if isinstance(policy, str) else to_json(policy)
            goal["policy"] = PolicyMessage(id=id, text=text)
        sent = Sent()
        self._actions[do].send_goal_async(
            kind.Goal(**goal), lambda message: sent.stages.append(message.feedback.stage), goal_id()
        ).add_done_callback(sent.accepted)
        return sent

    def answer(
        self, sent: Sent, meanwhile: Callable[[], object] = lambda: None, deadline: float = 60.0
    ) -> Answer:
        """The outcome of a goal, once it has ended; `meanwhile` is called again and again."""
        self.until(lambda: meanwhile() or sent.result, "the end of a goal", deadline)
        return sent.answer

    def cancel(self, sent: Sent) -> bool:
        """Cancel a goal; returns whether it will end."""
        self.until(lambda: sent.handle, "an accepted goal")
        future = sent.handle.cancel_goal_async()
        self.until(future.done, "the answer to a cancel")
        return bool(future.result().goals_canceling)

    def call_until_success(
        self, do: str, policy: Policy | None = None, deadline: float = 60.0
    ) -> Answer:
        """Send a goal until it succeeds, such as to a controller that becomes active."""
        end = time.monotonic() + deadline
        while True:
            answer = self.answer(self.ask(do, policy), deadline=deadline)
            if answer.success:
                return answer
            if time.monotonic() > end:
                pytest.fail(f"{do} was refused to the end: {answer}")
            self.spin(0.1)

    def replay(self, movement: JointTrajectory) -> Sent:
        """Send a movement to replay."""
        return self.ask("replay", movement=movement)

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        for node in (*self._others, self.node):
            node.destroy_node()
        rclpy.try_shutdown(context=self.context)  # a signal may have ended it


@pytest.fixture
def probe(domain_id: int) -> Iterator[Probe]:
    """A test's own node in its private domain."""
    probe = Probe(domain_id)
    yield probe
    probe.close()


@pytest.fixture
def server(probe: Probe) -> Iterator[Node]:
    """A node, dispatched by a thread, for the services and actions that a test offers."""
    with Link(rclpy.create_node("server", context=probe.context)) as link:
        yield link.node


@pytest.fixture
def robot(probe: Probe) -> Iterator[Robot]:
    """An arm of the nodes of a test."""
    with Link(rclpy.create_node("robot", context=probe.context)) as link:
        yield Robot(link)


@functools.cache
def _server() -> forked.Server:
    return forked.Server()


class Processes:
    """Starts node processes in the private domain of the test, with their output in files."""

    def __init__(self, domain_id: int, folder: Path) -> None:
        self._folder = folder
        self.environment = {
            **os.environ,
            **shared(domain_id),
            "PYTHONPATH": python_path(),
            "PYTHONUNBUFFERED": "1",
        }
        self.started: list[tuple[Process, Path]] = []

    def node(self, module: str, *configs: str | Path, **parameters: object) -> Process:
        """Start a module, or a script, with parameter files of `config/` and overrides."""
        program = [module] if module.endswith(".py") else ["-m", module]
        command = [sys.executable, *program, "--ros-args"]
        for config in configs:
            command += ["--params-file", str(ROOT / "config" / config)]
        for name, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            command += ["-p", f"{name}:={text}"]
        return self.start(command)

    def script(self, code: str, *arguments: str) -> Process:
        """Start a script that minds no import that was made before it."""
        return self._start([sys.executable, "-c", code, *arguments], self.environment, bool(FORKED))

    def start(self, command: list[str], **environment: str) -> Process:
        """Start a command in the repository's folder."""
        node = command[:2] == [sys.executable, "-m"] and command[2] in FORKED
        folder, _, name = command[2].rpartition(".") if len(command) > 2 else ("", "", "")
        if folder == "wam_power_ros.nodes" and not node:
            command = [*command[:2], "wam_power_ros.entry", name, *command[3:]]
        return self._start(command, self.environment | environment, node)

    def _start(self, command: list[str], environment: dict[str, str], fork: bool) -> Process:
        log = self._folder / f"process_{len(self.started)}.log"
        log.touch()
        process: Process
        if fork:
            process = _server().fork(command, ROOT, environment, log)
        else:
            with log.open("wb") as output:
                process = subprocess.Popen(
                    command, cwd=ROOT, env=environment, stdout=output, stderr=subprocess.STDOUT
                )
        self.started.append((process, log))
        return process

    def output(self, process: Process) -> str:
        """What a process has printed."""
        return next(log for other, log in self.started if other is process).read_text()

    def end(self, process: Process, how: int = signal.SIGINT) -> int:
        """Signal a process, wait for it, and return its exit status."""
        if process.poll() is None:
            process.send_signal(how)
        try:
            return process.wait(30.0)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait(60.0)  # on a busy machine

    def close(self) -> None:
        """End everything and show what it printed (pytest prints this for a failed test)."""
        with ExitStack() as ends:  # the last first, and every one even if one does not end
            for process, _ in self.started:
                ends.callback(self.end, process)
        for process, log in self.started:
            name = " ".join(process.args[1:5])
            sys.stdout.write(f"--- {name}: {process.returncode}\n{log.read_text()}\n")


def diagnosis(messages: list[Any], name: str) -> dict[str, str]:
    """The newest values of a node's diagnostics, with its level and message; empty before any."""
    for message in reversed(messages):
        for status in message.status:
            if status.name.startswith(name):
                values = {item.key: item.value for item in status.values}
                return values | {"level": str(status.level[0]), "message": status.message}
    return {}


def lift(policy_id: str, arm: Arm | None = None, home: Sequence[float] = ()) -> Policy:
    """A policy that lifts the tool, usually a WAM's pan, by some centimetres and lowers it."""
    if arm is None:
        home = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0])
        arm = Arm((ROOT / "urdf/wam7.urdf").read_text(), [f"wam_j{i}" for i in range(1, 8)])
    position, rotation = arm.tool_pose(np.array(home))
    attractors = np.tile(position, (8, 1))
    attractors[2:5, 2] += 0.05
    return Policy(
        id=policy_id,
        basis=Basis(count=8, duration=0.4, variance=0.001),
        stiffness=np.tile(300.0 * np.eye(3), (8, 1, 1)),
        attractors=attractors,
        damping=32.0,
        orientation_reference=rotations.quat_xyzw(rotation),
        rotation_attractors=np.zeros((8, 3)),
        rotation_stiffness=400.0,
        rotation_damping=36.0,
        q_start=np.array(home),
    )


@pytest.fixture
def processes(domain_id: int, tmp_path: Path) -> Iterator[Processes]:
    """Node processes of a test, all ended after it."""
    processes = Processes(domain_id, tmp_path)
    yield processes
    processes.close()


@pytest.fixture(scope="module")
def shared_nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Probe, Processes]]:
    """A probe and node processes that the tests of a module share, in a domain of their own."""
    with private_domain() as domain, ExitStack() as ends:
        probe = Probe(domain)
        ends.callback(probe.close)
        processes = Processes(domain, tmp_path_factory.mktemp("processes"))
        ends.callback(processes.close)
        yield probe, processes


@pytest.fixture
def refusal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., str]:
    """Function that runs `wam-power` in `tmp_path`, expects a refusal and returns its message."""
    from wam_power_ros.cli import main

    monkeypatch.chdir(tmp_path)

    def refuse(*words: str) -> str:
        before = sorted(tmp_path.iterdir())
        assert main.main(words) == 2
        assert sorted(tmp_path.iterdir()) == before
        return capsys.readouterr().err

    return refuse


@pytest.fixture
def said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., str]:
    """Function that runs `wam-power` in `tmp_path`, expects success and returns what it prints."""
    from wam_power_ros.cli import main

    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> str:
        capsys.readouterr()
        assert main.main([*map(str, words)]) == 0
        return capsys.readouterr().out

    return run


LAUNCHED = ("torque_controller", "demonstration_recorder", "pancake_tracker", "learner", "wam_sim")


@pytest.fixture
def installation(tmp_path: Path) -> Path:
    """Launch files and executables, as colcon installs them."""
    prefix = tmp_path / "install"
    share, programs = prefix / "share/wam_power_ros", prefix / "lib/wam_power_ros"
    index = prefix / "share/ament_index/resource_index/packages"
    for folder in (share, programs, index):
        folder.mkdir(parents=True)
    (index / "wam_power_ros").touch()
    for name in ("launch", "config"):
        (share / name).symlink_to(ROOT / name)
    for name in LAUNCHED:
        (programs / name).write_text(
            f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {str(ROOT)!r})\n"
            f"from wam_power_ros import entry\nraise SystemExit(entry.{name}())\n"
        )
        (programs / name).chmod(0o755)
    folder = share / "launch"
    return folder
