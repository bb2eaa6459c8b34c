# SPDX-License-Identifier: Apache-2.0
"""Execution of a trial over ROS, with a controller of scripted answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial

import numpy as np
import pytest
import rclpy
from conftest import Probe, lift
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from wam_power_interfaces.action import ExecutePolicy, MoveToStart, Replay, ResetScene
from wam_power_interfaces.msg import GroundTruth
from wam_power_ros.client import rollouts
from wam_power_ros.client.link import Link
from wam_power_ros.client.rollouts import (
    Awaited,
    EndedByPersonError,
    RolloutError,
    Rollouts,
    RolloutSettings,
)
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.ros import interface, pose_messages
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.diagnostics import LAST_STOP, diagnostics_message
from wam_power_ros.ros.outcomes import Answer, Code, Ended
from wam_power_ros.tasks.reset import BodyState, Move

POLICY = lift("trial-0002")
MOVE, EXECUTE, SCENE = "move_to_start", "execute", "reset"
WHOLE = 0.5  # [s]
START_NS = 10**9  # stamp of each rollout
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
SETTINGS = RolloutSettings(
    scene_reset=False,
    reset_faults=True,
    record_rollouts=False,
    service_timeout=20.0,
    rollout_timeout=20.0,
    patience=20.0,
)


class Cell:
    """Actions and topics of a controller; every request is kept."""

    def __init__(self, node: Node) -> None:
        self.node, self.requests = node, []
        self.policies: list[str] = []
        self.known: list[str] = []  # last stop that each request knows of
        self.answers = {MOVE: [], EXECUTE: []}  # first ones; later ones: done
        Action(node, MoveToStart, interface.MOVE_TO_START, partial(self.take, MOVE))
        execute = partial(self.take, EXECUTE)
        self._execution = Action(node, ExecutePolicy, interface.EXECUTE_POLICY, execute)
        node.create_service(Trigger, interface.RESET, self._reset)
        self._diagnostics = self.node.create_publisher(
            DiagnosticArray, interface.DIAGNOSTICS, interface.STATE_OUT
        )
        self.end = WHOLE  # of the path [s]
        self.fault: Fault | None = None  # of the rollout
        self.stop = ""  # by which a person ends the rollout

    def offer_scene(self) -> None:
        """Offer the reset of a scene."""
        self.answers[SCENE] = []
        name = interface.RESET_SCENE
        self._scene = Action(self.node, ResetScene, name, partial(self.take, SCENE))

    def take(self, do: str, id: str, goal: ExecutePolicy.Goal) -> Answer | None:
        """Answer a goal."""
        self.requests.append(do)
        self.policies.append(goal.policy.text)
        self.known.append(getattr(goal, "known_stop", ""))
        if self.answers[do]:
            return self.answers[do].pop(0)
        if do == SCENE:
            back = Header(stamp=self.node.get_clock().now().to_msg())
            self._scene.finish(id, Answer(Code.DONE), header=back)
            return None
        if do != EXECUTE:
            return Answer(Code.DONE)
        return self.run(id)

    def run(self, id: str) -> None:
        """Say that a rollout has ended, with the path of the tool."""
        t = np.arange(0.0, self.end, 0.01)
        path = EndEffectorPath(POLICY.id, t, np.zeros((len(t), 3)), np.tile(LEVEL, (len(t), 1)))
        end = Ended(POLICY.id, START_NS, self.fault, stop=self.stop)
        code = Code.STOPPED if self.stop else Code.FAULT if self.fault else Code.DONE
        self._execution.finish(
            id,
            Answer(code, stop=self.stop),
            end=end.message(),
            path=pose_messages.path_message(path, START_NS, "wam_base"),
        )

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.requests.append(interface.RESET)
        response.success = True
        return response

    def diagnose(self, mode: str, level: str, text: str, kind: str = "", stop: str = "") -> None:
        """Diagnostics as a controller publishes them."""
        now, values = self.node.get_clock().now().to_msg(), {"mode": mode, "fault kind": kind}
        values[LAST_STOP] = stop
        self._diagnostics.publish(
            diagnostics_message(now, "torque_controller: loop", "arm", level, text, values)
        )


@pytest.fixture
def cell(probe: Probe) -> Iterator[Cell]:
    node = rclpy.create_node("cell", context=probe.context)
    cell = Cell(node)
    with Link(node):
        yield cell


Connect = Callable[..., Rollouts]


@pytest.fixture
def connect(probe: Probe, cell: Cell) -> Iterator[Connect]:
    """Function that makes a client with changed settings, for a body."""
    with ExitStack() as stack:

        def connect(body: str = "", joint_names: Sequence[str] = (), **changes: object) -> Rollouts:
            node = rclpy.create_node("client", context=probe.context)
            given = SETTINGS.model_copy(update=changes)
            return Rollouts(stack.enter_context(Link(node)), given, body, joint_names)

        yield connect


@pytest.fixture
def client(connect: Connect) -> Rollouts:
    return connect()


@pytest.mark.requirement("S-103")
def test_every_request_brings_the_policy_it_is_about(client: Rollouts, cell: Cell) -> None:
    executed = client.execute(POLICY, WHOLE, lambda state: "")
    assert cell.requests == [MOVE, EXECUTE]
    assert cell.policies == [policies.to_json(POLICY)] * 2
    assert executed.rollout.tool.id == POLICY.id and executed.rollout.body is None
    assert executed.rollout.fault is None and (executed.bag, executed.truth) == ("", None)


def test_the_path_of_the_body_through_another_rollout_is_not_taken(
    connect: Connect, cell: Cell
) -> None:
    client, ball = connect("ball"), Ball(cell, states=-1, start_ns=START_NS // 2)
    client.until(lambda: client._body_path(), "that path", 20.0)
    late = cell.node.create_timer(1.0, lambda: (late.cancel(), ball.path(START_NS, 0.3)))
    executed = client.execute(POLICY, WHOLE, lambda state: "")
    assert executed.rollout.body.t[-1] == pytest.approx(0.29)


def test_the_ground_truth_of_an_earlier_rollout_of_the_same_trial_is_not_taken_however_late(
    client: Rollouts, cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    topic = interface.body_topic("", "truth")
    truths = cell.node.create_publisher(GroundTruth, topic, interface.LATCHED)
    before, now = (
        pose_messages.TruthReading(POLICY.id, end_ns, {"caught": caught})
        for end_ns, caught in ((9 * 10**8, False), (15 * 10**8, True))
    )
    rollout = cell.run

    def run(id: str) -> None:
        rollout(id)  # at 1 s
        truths.publish(pose_messages.ground_truth_message(before))
        timer = cell.node.create_timer(0.3, lambda: (timer.cancel(), truths.publish(after)))

    after = pose_messages.ground_truth_message(now)
    monkeypatch.setattr(cell, "run", run)
    assert client.execute(POLICY, WHOLE, lambda state: "").truth == now.values


def test_a_ground_truth_that_is_lost_with_a_simulation_ends_no_session(
    connect: Connect, cell: Cell
) -> None:
    topic = interface.body_topic("", "truth")
    cell.node.create_publisher(GroundTruth, topic, interface.LATCHED)
    executed = connect(rollout_timeout=0.5).execute(POLICY, WHOLE, lambda state: "")
    assert executed.truth is None and executed.rollout.tool.id == POLICY.id


@pytest.mark.parametrize("fault", [Fault(FaultKind.TOOL_SPEED, "about the workspace"), None])
def test_a_rollout_that_was_cut_short_has_its_fault_if_any(
    client: Rollouts, cell: Cell, fault: Fault | None
) -> None:
    cell.end, cell.fault = 0.2, fault
    assert client.execute(POLICY, WHOLE, lambda state: "").rollout.fault == fault


def test_a_fault_before_the_rollout_is_reset_and_it_begins_again(
    client: Rollouts, cell: Cell
) -> None:
    at_fault = Answer(Code.FAULT, "refused")
    cell.answers[EXECUTE] = [at_fault]
    cell.answers[MOVE] = [at_fault]
    client.execute(POLICY, WHOLE, lambda state: "")
    reset = interface.RESET
    assert cell.requests == [MOVE, reset, MOVE, EXECUTE, MOVE, EXECUTE]


def test_a_controller_that_is_not_active_is_waited_for_without_asking_it_again_and_again(
    cell: Cell, connect: Connect
) -> None:
    client = connect(patience=0.3)  # a person has no such limit
    told: list[str] = []
    inactive = Answer(Code.NOT_ACTIVE, "refused: the controller is not active")
    cell.answers |= {MOVE: [Answer(Code.DONE), inactive], EXECUTE: [inactive]}

    def publish() -> None:  # half a second after each refusal the controller is active
        told.append("inactive" if len(told) % 8 < 5 else "hold")
        cell.diagnose(told[-1], "warn", "not active")

    cell.node.create_timer(0.1, publish)
    client.execute(POLICY, WHOLE, lambda state: "")
    assert cell.requests == [MOVE, EXECUTE, MOVE, MOVE, EXECUTE]  # deactivated in between


def test_the_enabling_switch_is_waited_for(connect: Connect, cell: Cell) -> None:
    client = connect(service_timeout=1.0)
    cell.answers[EXECUTE] = [Answer(Code.SWITCH, "not held") for _ in range(8)]
    client.execute(POLICY, WHOLE, lambda state: "")
    assert cell.requests == [MOVE, *[EXECUTE] * 9]  # for longer than the service's time
    assert client.awaited() is None


STOPPED = Answer(Code.STOPPED, "stopped by a person", "17")


@pytest.mark.requirement("S-128")
@pytest.mark.parametrize("do, ran", [(MOVE, False), (EXECUTE, False), (EXECUTE, True)])
def test_what_a_person_ends_is_not_tried_again_and_says_whether_the_policy_ran(
    client: Rollouts, cell: Cell, do: str, ran: bool
) -> None:
    client.go_on()
    if ran:
        cell.stop = "17"
    else:
        cell.answers[do] = [STOPPED]
    with pytest.raises(EndedByPersonError) as ended:
        client.execute(POLICY, WHOLE, lambda state: "")
    assert ended.value.ran == ran and client.awaited() is None
    asked = [MOVE, EXECUTE][: 1 + (do == EXECUTE)]
    assert (cell.requests, cell.known) == (asked, ["none"] * len(asked))
    client.go_on()
    cell.stop = ""
    client.execute(POLICY, WHOLE, lambda state: "")
    assert cell.known[len(asked) :] == ["17", "17"]


@pytest.mark.requirement("S-128")
def test_a_stop_ends_a_wait_without_limit(connect: Connect, cell: Cell) -> None:
    client = connect(reset_faults=False)
    cell.answers[MOVE] = [Answer(Code.FAULT, "too fast")]
    client.go_on()
    seen = awaited_by(client, cell)
    reports = iter(["", "", "", "17"])
    cell.node.create_timer(
        0.1, lambda: cell.diagnose("fault", "error", "x", stop=next(reports, "17"))
    )
    with pytest.raises(EndedByPersonError, match="a person to reset the controller"):
        client.execute(POLICY, WHOLE, lambda state: "")
    assert cell.requests == [MOVE] and [each.state for each in seen] == ["reset"]


def test_a_fault_that_comes_again_and_again_ends_it_by_name(client: Rollouts, cell: Cell) -> None:
    cell.answers[EXECUTE] = [Answer(Code.FAULT, "no rollout")] * 10
    with pytest.raises(RolloutError, match="no rollout"):
        client.execute(POLICY, WHOLE, lambda state: "")


def in_place(state: BodyState) -> str:
    """What a body lacks before a rollout may begin."""
    return "" if state.position[2] > 0.5 else "on the floor"


def awaited_by(client: Rollouts, cell: Cell) -> list[Awaited]:
    """What a client waits for from now on, each once, as another thread sees it."""
    seen: list[Awaited] = []

    def look() -> None:
        now = client.awaited()
        if now is not None and now not in seen:
            seen.append(now)

    cell.node.create_timer(0.02, look)
    return seen


class Ball:
    """Body that is off its place until the arm has done a movement, or for a number of states."""

    def __init__(self, cell: Cell, states: float = math.inf, start_ns: int = START_NS) -> None:
        self.cell, self.moves, self.off = cell, 0, states
        self.replies = [Answer(Code.SWITCH, "the enabling switch is not held")]  # first one
        Action(cell.node, Replay, interface.REPLAY_MOVEMENT, self._move)
        topic = interface.rollout_topic("ball")
        self._paths = cell.node.create_publisher(Path, topic, interface.LATCHED)
        self.path(start_ns, WHOLE)
        topic = interface.body_topic("ball", "state")
        self._states = cell.node.create_publisher(Odometry, topic, interface.STATE_OUT)
        self.late_ns = 0  # added to the stamps of its states
        cell.node.create_timer(0.02, self._publish)

    def path(self, start_ns: int, end: float) -> None:
        """Publish a path until a time [s] after its start."""
        t = np.arange(0.0, end, 0.01)
        path = BodyPath(POLICY.id, t, np.zeros((len(t), 3)), np.tile(LEVEL, (len(t), 1)))
        self._paths.publish(pose_messages.path_message(path, start_ns, "wam_base"))

    def _move(self, id: str, goal: Replay.Goal) -> Answer:
        self.cell.requests.append("replay")
        answer = self.replies.pop(0) if self.replies else Answer(Code.DONE)
        self.moves += answer.success
        return answer

    def _publish(self) -> None:
        self.off -= SCENE in self.cell.requests
        there = self.moves > 0 or self.off < 0
        zero, place = np.zeros(3), np.array([0.0, 0.0, float(there)])
        stamp_ns = self.cell.node.get_clock().now().nanoseconds + self.late_ns
        state = pose_messages.StateReading(stamp_ns, "wam_base", place, LEVEL, zero, zero, 1e-6)
        self._states.publish(pose_messages.odometry_message(state, "ball"))


def test_a_body_that_is_thrown_off_again_is_put_back_again_by_the_simulation(
    connect: Connect, cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rollouts, "READY_TIMEOUT", 0.5)
    cell.offer_scene()
    ball = Ball(cell)
    placed = lambda: setattr(ball, "moves", int(cell.requests.count(SCENE) > 1))  # noqa: E731
    cell.node.create_timer(0.02, placed)
    move = Move(np.linspace(0.0, 1.0, 6), np.zeros((6, 7)))
    client = connect("ball", joint_names=["j1"], scene_reset=True)
    executed = client.execute(POLICY, WHOLE, in_place, lambda state: move)  # the arm does not
    assert cell.requests == [MOVE, SCENE, MOVE, SCENE, EXECUTE] and executed.reset is None


def test_states_of_a_body_from_before_the_reset_of_its_scene_do_not_begin_a_rollout(
    connect: Connect, cell: Cell
) -> None:
    cell.offer_scene()
    ball = Ball(cell)
    ball.moves, ball.late_ns = 1, -30 * 10**9  # as if the tracker lagged far behind
    begun: list[bool] = []

    def catch_up() -> None:
        begun.append(EXECUTE in cell.requests)
        ball.late_ns = 0

    cell.node.create_timer(2.0, catch_up)
    connect("ball", scene_reset=True).execute(POLICY, WHOLE, in_place)
    assert begun[0] is False and cell.requests[-1] == EXECUTE


def test_no_frame_of_before_a_reset_of_the_scene_is_in_the_path_of_a_rollout(
    connect: Connect, cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    lead_ns = 2_000_000_000  # far longer than what else delays a rollout
    monkeypatch.setattr(rollouts, "LEAD_TIME", lead_ns)
    cell.offer_scene()
    Ball(cell).moves = 1
    since: dict[str, int] = {}

    def look() -> None:
        for request in cell.requests:
            since.setdefault(request, cell.node.get_clock().now().nanoseconds)

    cell.node.create_timer(0.01, look)
    connect("ball", scene_reset=True).execute(POLICY, WHOLE, in_place)
    look()
    assert since[EXECUTE] - since[SCENE] > lead_ns - 100_000_000  # a look may come late


def test_the_arm_puts_the_body_back_once_the_switch_is_held_and_who_did_is_known(
    connect: Connect, cell: Cell
) -> None:
    Ball(cell)
    move = Move(np.linspace(0.0, 1.0, 6), np.zeros((6, 7)))
    names = [f"j{number}" for number in range(7)]
    client = connect("ball", joint_names=names)
    seen = awaited_by(client, cell)
    executed = client.execute(POLICY, WHOLE, in_place, lambda state: move, rest_time=0.2)
    assert Awaited("switch", "the enabling switch to be held, to put the ball back") in seen
    assert client.awaited() is None
    assert cell.requests == [MOVE, "replay", "replay", MOVE, EXECUTE]
    assert executed.reset is not None and executed.reset["by"] == "arm"
    assert 0.0 <= executed.reset["seconds"] < 60.0


def test_a_fault_while_the_body_is_waited_for_takes_the_arm_to_its_start_again(
    connect: Connect, cell: Cell
) -> None:
    ball = Ball(cell)
    cell.answers[MOVE] = [Answer(Code.DONE), Answer(Code.FAULT, "no state for 21 ms")]
    told: list[str] = []  # modes, as published

    def diagnose() -> None:  # a fault, after 1 s reset by a person, who puts the ball back as well
        faulty = len(told) < 10 or cell.requests.count(MOVE) < 2
        told.append("fault" if faulty else "hold")
        cell.diagnose(told[-1], "error" if faulty else "ok", "no state for 21 ms", "states_lost")
        ball.moves = int(not faulty or len(told) > 80)  # at last, so that the test ends

    cell.node.create_timer(0.1, diagnose)
    client = connect("ball", joint_names=["j1"], reset_faults=False, patience=0.5)
    seen = awaited_by(client, cell)
    executed = client.execute(POLICY, WHOLE, in_place)
    assert cell.requests == [MOVE, MOVE, MOVE, EXECUTE]
    assert executed.reset is not None and executed.reset["by"] == "person"
    assert Awaited("reset", "a person to reset the controller: no state for 21 ms") in seen
    assert client.awaited() is None


def test_a_body_that_is_not_seen_is_waited_for_without_limit_and_nobody_is_needed(
    connect: Connect, cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rollouts, "SILENCE", 0.2)
    appears = cell.node.create_timer(2.0, lambda: (appears.cancel(), Ball(cell, states=-1)))
    client = connect("ball", joint_names=["j1"], patience=0.5)
    seen = awaited_by(client, cell)
    executed = client.execute(POLICY, WHOLE, lambda state: "")
    assert executed.reset is not None and executed.reset["by"] == "none"
    assert "not_visible" in {each.state for each in seen} and client.awaited() is None


def test_a_person_is_waited_for_without_limit_where_the_body_has_not_come_to_rest_by_itself(
    connect: Connect, cell: Cell
) -> None:
    client = connect("ball", patience=0.5)
    seen = awaited_by(client, cell)
    ball = Ball(cell)
    placed = cell.node.create_timer(4.0, lambda: (placed.cancel(), setattr(ball, "moves", 1)))
    executed = client.execute(POLICY, WHOLE, in_place)
    assert executed.reset is not None and executed.reset["by"] == "person"
    what = "the ball to be ready, which a person puts back: on the floor"
    asked = [each for each in seen if each.what == what]
    assert asked == [Awaited("rest", what), Awaited("put back", what)]
    assert client.awaited() is None


@pytest.mark.parametrize("step", [2_000_000, 0, 2_000_000_000])
def test_a_simulation_that_is_slow_is_waited_for_and_one_that_stands_or_is_overdue_is_not(
    step: int, client: Rollouts, cell: Cell
) -> None:
    limit, ticks, now_ns = 1.0, 0, 10**9
    client._node.set_parameters([Parameter("use_sim_time", value=True)])
    clock = cell.node.create_publisher(Clock, "/clock", 1)

    def tick() -> None:
        nonlocal ticks, now_ns
        ticks, now_ns = ticks + 1, now_ns + step
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(now_ns, 10**9)
        clock.publish(message)

    timer = cell.node.create_timer(0.05, tick, clock=rclpy.clock.Clock())
    now = client._node.get_clock().now
    client._link.until(lambda: now().nanoseconds, "the simulated clock")
    begun = ticks
    late = lambda: ticks > begun + 50  # noqa: E731 - after two limits of wall time and a half
    if step == 2_000_000:
        client.until(late, "slow", limit)
        with pytest.raises(RolloutError, match="waited 1 s in vain for the end"):
            client.until(lambda: False, "the end", 0.2)  # but not for ever
    else:
        with pytest.raises(RolloutError, match="waited 1 s in vain for the overdue end"):
            client.until(late, "the overdue end", limit)
    timer.cancel()
