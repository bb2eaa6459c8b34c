# SPDX-License-Identifier: Apache-2.0
"""Running a node: dispatch, end on a signal with a last word, refusal of a bad configuration."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from std_srvs.srv import Trigger

from wam_power_ros.ros import scheduling

if TYPE_CHECKING:
    from conftest import Probe, Processes

NODE = """
import sys
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger
from wam_power_ros.ros import interface, scheduling
from wam_power_ros.ros.deferred_service import LateTrigger

class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        if "bad" in sys.argv:
            raise ValueError("heat -1 must be positive")
        self._words = self.create_publisher(String, "/words", interface.LATCHED)
        self._late = LateTrigger(self, "/late", lambda: None)
        self._never = LateTrigger(self, "/never", lambda: "not today")
        self.create_timer(0.3, lambda: self._late.pending and self._late.finish(True, "there"))

    def close(self):
        self._words.publish(String(data="last"))
        import time; time.sleep(0.3)

sys.exit(scheduling.run(Talker))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_node_can_still_send_when_a_signal_ends_it(
    probe: Probe, processes: Processes, number: int
) -> None:
    from std_msgs.msg import String

    from wam_power_ros.ros import interface

    words = probe.listen(String, "/words", interface.LATCHED)
    process = processes.start([sys.executable, "-c", NODE])
    assert probe.call(Trigger, "/late").message == "there"
    process.send_signal(number)
    probe.until(lambda: words, "the last word", deadline=3.0)
    assert processes.end(process) == 0
    assert "Traceback" not in processes.output(process)


def test_a_late_answer_comes_late_and_a_refusal_at_once(probe: Probe, processes: Processes) -> None:
    processes.start([sys.executable, "-c", NODE])
    first, second = probe.begin(Trigger, "/late"), probe.begin(Trigger, "/late")
    refusal = probe.call(Trigger, "/never")
    assert (refusal.success, refusal.message) == (False, "not today")
    probe.until(lambda: first.done() and second.done(), "both late answers")
    assert first.result().success
    assert second.result().success


def test_a_refused_configuration_ends_the_process_with_its_reason(processes: Processes) -> None:
    process = processes.start([sys.executable, "-c", NODE, "bad"])
    assert process.wait(60.0) == 2
    assert "heat -1 must be positive" in processes.output(process)
    assert "Traceback" not in processes.output(process)


def test_what_the_machine_grants_is_reported_either_way() -> None:
    assert not scheduling.request(0).complete
    child = os.fork()
    if child == 0:  # in a process of its own: priorities and locked memory are for keeps
        granted = scheduling.request(20)
        fifo = os.sched_getscheduler(0) == os.SCHED_FIFO
        os._exit(0 if (granted.scheduling == "granted") == fifo and granted.memory else 1)
    end = time.monotonic() + 20.0
    while (result := os.waitpid(child, os.WNOHANG)) == (0, 0) and time.monotonic() < end:
        time.sleep(0.01)
    assert result[1] == 0


def test_every_thread_is_given_the_priority() -> None:
    child = os.fork()
    if child == 0:
        import threading

        threading.Thread(target=time.sleep, args=(5.0,), daemon=True).start()
        granted = scheduling.request(20)
        threads = [int(path.name) for path in Path("/proc/self/task").iterdir()]
        fifo = all(os.sched_getscheduler(thread) == os.SCHED_FIFO for thread in threads)
        os._exit(0 if fifo or granted.scheduling != "granted" else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_an_executor_that_dispatches_nothing_is_replaced(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.experimental import events_executor

    class Deaf(SingleThreadedExecutor):
        def spin_once(self, timeout_sec: float | None = None) -> None:
            time.sleep(timeout_sec or 0.0)

    monkeypatch.setattr(events_executor, "EventsExecutor", lambda: Deaf(context=probe.context))
    monkeypatch.setattr(
        scheduling, "SingleThreadedExecutor", lambda: SingleThreadedExecutor(context=probe.context)
    )
    executor = scheduling.executor_for(probe.node, patience=0.2)
    assert type(executor) is SingleThreadedExecutor
    assert probe.node in executor.get_nodes()
