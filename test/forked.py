# SPDX-License-Identifier: Apache-2.0
"""Node processes forked from one that has imported their modules.

A node takes a second of processor time for its imports, and the suite starts some hundreds. A
forked process has all else of its own: arguments, environment, signal handlers, DDS participant,
end. Nodes that start from nothing are tested where `wam-power` and launch files start them.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

MODULES = (
    "wam_power_ros.nodes.torque_controller",
    "wam_power_ros.nodes.body_tracker",
    "wam_power_ros.nodes.demonstration_recorder",
    "wam_power_ros.nodes.learner",
    "wam_power_ros.nodes.check_driver",
    "hardware_sim.main",
)
LATER = ("scipy.interpolate", "scipy.linalg.lapack", "scipy.signal")  # imported when needed
REQUEST_MAX = 1 << 17  # [byte], an environment above all


class Forked:
    """A forked process, with what tests use of `subprocess.Popen`."""

    def __init__(self, server: Server, command: list[str], pid: int) -> None:
        self._server = server
        self.args = command
        self.pid = pid
        self.returncode: int | None = None

    def wait(self, timeout: float | None = None) -> int:
        """Exit status once it has ended, negative for a signal."""
        end = None if timeout is None else time.monotonic() + timeout
        while self.returncode is None:
            left = None if end is None else max(0.0, end - time.monotonic())
            if self._server.receive(left) is None:
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        return self.returncode

    def poll(self) -> int | None:
        """Exit status, None while it runs."""
        try:
            return self.wait(0.0)
        except subprocess.TimeoutExpired:
            return None

    def send_signal(self, number: int) -> None:
        """Send a signal unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


class Server:
    """The process that forks; it ends with the one that started it."""

    def __init__(self) -> None:
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, __file__, str(other.fileno())]
        self._process = subprocess.Popen(command, pass_fds=(other.fileno(),))
        other.close()
        atexit.register(self._close)
        self._running: dict[int, Forked] = {}  # by process id, which Linux uses again later

    def fork(
        self, command: list[str], folder: Path, environment: dict[str, str], log: Path
    ) -> Forked:
        """Start what `python -m MODULE ARGUMENT...` or `python -c SCRIPT ARGUMENT...` starts.

        Args:
            command: These words.
            folder: Working directory.
            environment: Environment variables.
            log: File for its output.
        """
        words = command[1:] if command[1] == "-c" else command[2:]
        request = [words, str(folder), environment, str(log)]
        self._socket.send(json.dumps(request).encode())
        while (message := self.receive(None)) is None or message[1] is not None:
            pass
        pid = message[0]
        self._running[pid] = forked = Forked(self, command, pid)
        return forked

    def receive(self, timeout: float | None) -> tuple[int, int | None] | None:
        """Process id of one that has begun (None) or ended, and its exit status, which is noted.

        Returns None if nothing comes within `timeout` [s].
        """
        if not select.select([self._socket], [], [], timeout)[0]:
            return None
        received = self._socket.recv(REQUEST_MAX)
        if not received:
            raise RuntimeError(f"the process that forks has ended: {self._process.wait()}")
        pid, status = json.loads(received)
        if status is not None:
            self._running.pop(pid).returncode = status
        return pid, status

    def _close(self) -> None:
        self._socket.close()
        self._process.wait()


def serve(requests: socket.socket) -> int:
    """Fork on request until nobody is there to ask; in a forked process, run its `main`."""
    interrupt = signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the forked
    for module in (*MODULES, *LATER):
        importlib.import_module(module)
    gc.freeze()
    running: dict[int, int] = {}  # descriptor -> process id
    while True:
        for ready in select.select([requests, *running], [], [])[0]:
            if ready is not requests:
                pid = running.pop(ready)
                os.close(ready)
                _, status = os.waitpid(pid, 0)
                requests.send(json.dumps([pid, os.waitstatus_to_exitcode(status)]).encode())
                continue
            request = requests.recv(REQUEST_MAX)
            if not request:
                return 0
            pid = os.fork()
            if pid == 0:
                requests.close()
                for descriptor in running:
                    os.close(descriptor)
                signal.signal(signal.SIGINT, interrupt)
                return become(*json.loads(request))
            running[os.pidfd_open(pid)] = pid
            requests.send(json.dumps([pid, None]).encode())


def become(words: list[str], folder: str, environment: dict[str, str], log: str) -> int:
    """Run the `main` of a module, or a script, with arguments; returns its exit status."""
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for source, target in ((nothing, 0), (output, 1), (output, 2)):
        os.dup2(source, target)
    os.close(output)
    os.close(nothing)
    sys.stdout.reconfigure(write_through=True)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    if words[0] == "-c":
        sys.argv = [words[0], *words[2:]]
        exec(words[1], {"__name__": "__main__"})
        return 0
    sys.argv = words
    status: int = importlib.import_module(words[0]).main()
    return status


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    raise SystemExit(serve(socket.socket(fileno=int(sys.argv[1]))))
