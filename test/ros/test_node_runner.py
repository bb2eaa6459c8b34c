# SPDX-License-Identifier: Apache-2.0
"""Running nodes and scripts: status, dispatch, clean end."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String

from wam_power_ros.entry import SIGNALS
from wam_power_ros.ros import interface, node_runner

if TYPE_CHECKING:
    from conftest import Probe, Processes


SCRIPT = """
import signal, sys, time
import rclpy
from rclpy.node import Node
from wam_power_ros.ros.node_runner import run_script

def work(node):
    what = sys.argv[1]
    if what == "refuse":
        raise ValueError("heat -1 must be positive")
    if what == "break":
        raise KeyError("a mistake in the code")
    if what == "interrupt":
        signal.raise_signal(signal.SIGINT)
        time.sleep(30.0)
status = run_script(lambda: Node("script"), work)
print("ended", rclpy.ok())
sys.exit(status)
"""


@pytest.mark.parametrize(
    ("what", "status", "says"),
    [
        ("refuse", 2, "heat -1 must be positive\nended False"),
        ("interrupt", 130, "ended False"),
        ("break", 1, "a mistake in the code"),
    ],
)
def test_a_script_ends_with_the_status_of_what_ended_it(
    what: str, status: int, says: str, processes: Processes
) -> None:
    process = processes.script(SCRIPT, what)
    assert process.wait(60.0) == status
    assert says in processes.output(process)
    assert ("Traceback" in processes.output(process)) == (what == "break")  # only for a defect


NODE = """
import sys
from rclpy.node import Node
from std_msgs.msg import String
from wam_power_ros.ros import interface, node_runner

class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        self._words = self.create_publisher(String, "/words", interface.LATCHED)
        self._words.publish(String(data="first"))

    def close(self):
        self._words.publish(String(data="last"))
        import time; time.sleep(0.3)

sys.exit(node_runner.run(Talker))
"""


def test_a_node_can_still_send_when_a_signal_ends_it(probe: Probe, processes: Processes) -> None:
    words = probe.listen(String, "/words", interface.LATCHED)
    process = processes.script(NODE)
    probe.until(lambda: words, "the first message")
    process.send_signal(signal.SIGTERM)
    probe.until(lambda: words[-1].data == "last", "the last message", deadline=3.0)
    assert processes.end(process) == 0
    assert "Traceback" not in processes.output(process)


LAST = """
import os, signal, sys
class Last:  # deleted after the interpreter has removed its handlers
    def __del__(self, kill=os.kill, me=os.getpid(), number=signal.SIGINT):
        kill(me, number)
sys.last = Last()
"""


def test_a_second_signal_while_the_interpreter_ends_does_not_change_the_exit_status(
    probe: Probe, processes: Processes
) -> None:
    words = probe.listen(String, "/words", interface.LATCHED)
    process = processes.script(f"{LAST}{NODE}")
    probe.until(lambda: words, "the first message")
    assert processes.end(process) == 0


def test_without_an_events_executor_the_plain_one_is_used(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy.experimental.events_executor", None)
    executor = node_runner.executor_for(probe.node)
    assert type(executor) is SingleThreadedExecutor
    assert probe.node in executor.get_nodes()


@pytest.fixture
def interruptible() -> Iterator[None]:
    """A process whose signals raise KeyboardInterrupt."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    node_runner.interrupt_on_signals()
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_the_first_signal_interrupts_at_once_and_further_ones_disturb_nothing(
    number: int, interruptible: None
) -> None:
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), number)
    for each in SIGNALS:
        os.kill(os.getpid(), each)


def test_a_node_in_another_domain_leaves_the_environment_of_its_process_as_it_was(
    domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setenv("ROS_STATIC_PEERS", "192.0.2.1")
    before, context = dict(os.environ), Context()
    make = lambda: rclpy.create_node("guest", context=context)  # noqa: E731
    with node_runner.participant(make, domain_id, context, on_loopback=True):
        assert context.get_domain_id() == domain_id
        assert dict(os.environ) == before
    assert not context.ok()
