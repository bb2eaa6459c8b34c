# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling: the process has what it was told is granted."""

import subprocess
import sys

REQUEST = """
import os, pathlib, threading, time
from wam_power_ros.ros import scheduling
threading.Thread(target=time.sleep, args=(5.0,), daemon=True).start()
granted = scheduling.request(20)
threads = [int(path.name) for path in pathlib.Path("/proc/self/task").iterdir()]
fifo = {os.sched_getscheduler(thread) == os.SCHED_FIFO for thread in threads}
assert len(threads) > 1 and fifo == {granted.scheduling == "granted"} and granted.memory, granted
"""


def test_what_the_machine_grants_is_reported_and_holds_for_every_thread() -> None:
    # In a separate process, because priorities and locked memory cannot be given back.
    ended = subprocess.run([sys.executable, "-c", REQUEST], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
