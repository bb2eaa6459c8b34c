# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling: the process has what it was told is granted."""

import subprocess
import sys
import textwrap

import pytest

from wam_power_ros.ros import scheduling

REPORT = """
    import os
    from wam_power_ros.ros import scheduling
    granted = scheduling.request(20)
    fifo = os.sched_getscheduler(0) == os.SCHED_FIFO
    assert (granted.scheduling == "granted") == fifo and granted.memory, granted
"""
THREADS = """
    import os, pathlib, threading, time
    from wam_power_ros.ros import scheduling
    threading.Thread(target=time.sleep, args=(5.0,), daemon=True).start()
    granted = scheduling.request(20)
    threads = [int(path.name) for path in pathlib.Path("/proc/self/task").iterdir()]
    fifo = all(os.sched_getscheduler(thread) == os.SCHED_FIFO for thread in threads)
    assert len(threads) > 1 and (fifo or granted.scheduling != "granted"), granted
"""


def test_nothing_is_asked_for_without_a_priority() -> None:
    assert not scheduling.request(0).complete


@pytest.mark.parametrize("claim", [REPORT, THREADS], ids=["report", "threads"])
def test_what_the_machine_grants_is_reported_and_holds_for_every_thread(claim: str) -> None:
    # In a separate process, because priorities and locked memory cannot be given back.
    code = textwrap.dedent(claim)
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
