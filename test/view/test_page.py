# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: a session and its buttons."""

from __future__ import annotations

import fcntl
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="no viser")

from browser import chromium, opened, scene
from conftest import Probe, lift
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from toss_task import session_of

from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_interfaces.srv import Pause
from wam_power_ros.learning.policy import to_json
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface
from wam_power_ros.ros.diagnostics import diagnostics_message

ROLLOUTS = 5
WHITE = np.full((400, 300, 3), 255)


@pytest.fixture
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


class Running:
    """A running session whose learner and arm are this test: locked folder, services, topics."""

    def __init__(self, folder: Path, domain: int) -> None:
        session_of(folder, preset("flip", budget=ROLLOUTS, confirm=0), ROLLOUTS)
        (folder / "logs").mkdir()
        (folder / "logs/ros_domain_id").write_text(f"{domain}\n")
        self.folder, self.asked, self.probe = folder, [], Probe(domain)
        self.q = lift("lift").q_start
        for name in (interface.LEARNER_REWARD, interface.LEARNER_PUNISH, interface.STOP):
            self._serve(Trigger, name)
        self._serve(Pause, interface.LEARNER_PAUSE)
        node = self.probe.node
        self._states = node.create_publisher(
            JointState, interface.JOINT_STATES, interface.STATE_OUT
        )
        self._policy = node.create_publisher(PolicyMessage, interface.POLICY, interface.LATCHED)
        self._diagnoses = node.create_publisher(
            DiagnosticArray, interface.DIAGNOSTICS, interface.STATE_OUT
        )
        self._policy.publish(PolicyMessage(id="lift", text=to_json(lift("lift"))))
        self._lock = (folder / ".lock").open("a")
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def _serve(self, kind: type, name: str) -> None:
        def answer(request: Any, response: Any) -> Any:  # noqa: ANN401
            self.asked.append((name, getattr(request, "pause", None)))
            response.success = name != interface.LEARNER_PUNISH
            response.message = f"answer to {name}"
            return response

        self.probe.node.create_service(kind, name, answer)

    def live(self) -> None:
        """Publish a state and diagnostics, and answer service calls."""
        now = self.probe.node.get_clock().now().to_msg()
        names = [f"wam_j{i}" for i in range(1, 8)]
        state = JointState(name=names, position=self.q.tolist())
        state.header.stamp = now
        self._states.publish(state)
        text = "joint 4 is beyond its limit <img src=x onerror=\"document.title='theirs'\">"
        said = ("wam7", "error", text, {})
        self._diagnoses.publish(diagnostics_message(now, "torque_controller: loop", *said))
        self.probe.spin(0.05)

    def until(self, condition: Callable[[], Any], what: str) -> None:
        """Publish until a condition holds."""

        def living() -> Any:  # noqa: ANN401
            self.live()
            return condition()

        self.probe.until(living, what)

    def end(self) -> None:
        """Release the lock, as a killed learner does."""
        self._lock.close()


@pytest.fixture
def running(domain_id: int, tmp_path: Path) -> Iterator[Running]:
    session = Running(tmp_path / "flips", domain_id)
    yield session
    session.end()
    session.probe.close()


@pytest.fixture
def session_url(running: Running) -> Iterator[str]:
    """Of `wam-power view` of its folder, as a process, until Ctrl-C."""
    command = [sys.executable, "-m", "wam_power_ros.cli", "view", str(running.folder)]
    process = subprocess.Popen([*command, "--port", "0"], stdout=subprocess.PIPE, text=True)
    yield process.stdout.readline().split()[0]
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0


def differs(page: Any, before: np.ndarray) -> bool:  # noqa: ANN401
    """Whether the picture has changed visibly."""
    return bool(np.abs(scene(page) - before).max() > 60)


def until_drawn_otherwise(page: Any, before: np.ndarray) -> None:  # noqa: ANN401
    for _ in range(200):
        if differs(page, before):
            return
        page.wait_for_timeout(100)
    raise AssertionError("the picture did not change")


def says(page: Any, text: str) -> bool:  # noqa: ANN401
    return text in page.inner_text("body")


def test_a_session_is_displayed_and_controlled_by_buttons_until_it_ends(
    browser: Any,  # noqa: ANN401
    running: Running,
    session_url: str,
) -> None:
    page = opened(browser, session_url)
    running.until(lambda: says(page, "flips (running)"), "the page shows that it runs")
    assert says(page, f"{ROLLOUTS}, best return") and says(page, "no safety function")
    running.until(lambda: says(page, "error: joint 4 is beyond its limit"), "diagnostics")
    assert says(page, "<img src=x") and page.title() != "theirs"  # text, not HTML
    until_drawn_otherwise(page, WHITE)
    page.wait_for_timeout(500)  # until drawing is complete
    before = scene(page)
    running.q = running.q - [0.0, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0]
    running.until(lambda: differs(page, before), "the arm is drawn where it is")

    for label, expected in (
        ("Reward", (interface.LEARNER_REWARD, None)),
        ("Punish", (interface.LEARNER_PUNISH, None)),
        ("Pause", (interface.LEARNER_PAUSE, True)),
        ("Continue", (interface.LEARNER_PAUSE, False)),
        ("STOP the arm", (interface.STOP, None)),
    ):
        page.get_by_role("button", name=label, exact=True).click()
        running.until(lambda expected=expected: running.asked[-1:] == [expected], label)
    running.until(lambda: says(page, f"answer to {interface.STOP}"), "the answer is shown")

    asked = len(running.asked)
    running.end()
    running.until(lambda: says(page, "not running"), "the page shows that it has ended")
    reward = page.get_by_role("button", name="Reward", exact=True)
    assert reward.is_disabled() and len(running.asked) == asked
    page.close()
