# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling: what the machine grants is what the process then has."""

import os
import time
from pathlib import Path

from wam_power_ros.ros import scheduling


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
