# SPDX-License-Identifier: Apache-2.0
"""A series of takes: kept, repeated, discarded, ended, interrupted."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
import rclpy
from bag_samples import demonstration, random_q
from conftest import Probe
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from wam_power_interfaces.action import Demonstrate, ResetScene
from wam_power_ros.bags import series
from wam_power_ros.client.robot import Robot
from wam_power_ros.console.teach import record_series
from wam_power_ros.ros import interface
from wam_power_ros.ros.action_server import Action
from wam_power_ros.ros.outcomes import Answer, Code, fill

Teach = Callable[..., list[str]]


FREE, HELD = [(interface.GRAVITY_COMPENSATION, switched) for switched in (True, False)]
BEGUN, ENDED = [(interface.RECORD, begun) for begun in (True, False)]
TAKE = [(interface.RESET_SCENE, True), BEGUN, (interface.DEMONSTRATE, True), ENDED]


@pytest.fixture
def asked() -> list[tuple[str, bool]]:
    """What is asked of the nodes."""
    return []


@pytest.fixture
def teach(
    probe: Probe,
    server: Node,
    robot: Robot,
    asked: list[tuple[str, bool]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Teach]:
    """Function that teaches three takes, with what a person types; returns the bags that are kept.

    The demonstrator, controller and recorder are the test's own.
    """
    count = 0

    def record(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        nonlocal count
        asked.append((interface.RECORD, request.data))
        bag = tmp_path / "bags" / f"demo_{count}"
        if not request.data:
            demonstration(bag, random_q(5))
            count += 1
        return fill(response, Answer(Code.DONE, str(bag)))

    def switch(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        asked.append((interface.GRAVITY_COMPENSATION, request.data))
        return fill(response, Answer(Code.DONE))

    server.create_service(SetBool, interface.GRAVITY_COMPENSATION, switch)
    server.create_service(SetBool, interface.RECORD, record)

    def act(name: str, id: str, goal: object) -> Answer:
        asked.append((name, True))
        return Answer(Code.DONE)

    for kind, name in ((ResetScene, interface.RESET_SCENE), (Demonstrate, interface.DEMONSTRATE)):
        Action(server, kind, name, partial(act, name))
    recorder = rclpy.create_node("demonstration_recorder", context=probe.context)
    recorder.create_subscription(JointState, interface.JOINT_STATES, lambda _: None, 1)
    file = tmp_path / series.FILE
    series.write(file, [demonstration(tmp_path / "bags/old", random_q(5))])

    def run(typed: io.StringIO, person: bool = False) -> list[str]:
        monkeypatch.setattr("sys.stdin", typed)
        record_series(robot, file, 3, person=person, review=True)
        return [bag.name for bag in series.read(file)]

    yield run  # until then the recorder lives


class Interrupted(io.StringIO):
    """A terminal at which a person presses Ctrl-C after what is typed."""

    def readline(self) -> str:
        """Next line."""
        if not (line := super().readline()):
            raise KeyboardInterrupt
        return line


def test_takes_are_kept_repeated_and_discarded_and_the_series_is_ended(
    teach: Teach, asked: list[tuple[str, bool]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = ("a", "", "what?", "d", "q")  # repeat, keep, asked again, not repeated, also the last
    assert teach(io.StringIO("\n".join(keys))) == ["old", "demo_1", "demo_3"]
    trash = tmp_path / "bags" / series.TRASH
    assert sorted(bag.name for bag in trash.iterdir()) == ["demo_0", "demo_2"]
    said = capsys.readouterr()
    assert said.err.count("Enter: keep") == 5
    assert asked == [FREE, *TAKE * 4, HELD]


def test_takes_before_ctrl_c_are_in_the_series_and_the_arm_holds(
    teach: Teach, asked: list[tuple[str, bool]], tmp_path: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        teach(Interrupted("\n\n"))
    kept = [bag.name for bag in series.read(tmp_path / series.FILE)]
    assert kept == ["old", "demo_0", "demo_1", "demo_2"]
    assert asked == [FREE, *TAKE * 3, HELD]


def test_a_person_who_cannot_answer_is_not_waited_for_and_the_arm_holds(
    teach: Teach, asked: list[tuple[str, bool]]
) -> None:
    for typed, taken in (("", []), ("\n", [BEGUN, ENDED])):
        del asked[:]
        with pytest.raises(ValueError, match="standard input is closed"):
            teach(io.StringIO(typed), person=True)
        assert asked == [FREE, *taken, HELD]
