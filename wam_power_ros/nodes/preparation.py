# SPDX-License-Identifier: Apache-2.0
"""The torque controller's side of its preparation process.

What takes long is done in a process beside the 500 Hz loop (`preparation_worker`): it receives the
policies and the movements to replay, reads, checks and tabulates them, and publishes and logs what
the loop hands it. A thread would not do: C code that parses keeps the interpreter's lock. Nor would
receiving the bytes here: taking a message of 17 MB from the middleware holds the loop up for 30 ms.
"""

from __future__ import annotations

import dataclasses
import os
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_references import Sampled
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.prepared_policy import PreparedPolicy
from wam_power_ros.control.safety import Limits
from wam_power_ros.learning.dmp import Tables
from wam_power_ros.learning.rollout import EndEffectorPath, Fault
from wam_power_ros.ros.process_channel import Channel, Message, pair

NAME = "torque_controller_preparation"  # node of the process
MODULE = "wam_power_ros.nodes.preparation_worker"
CHANNEL = 3  # file descriptor of its end of the channel
POLICY, MOVEMENT = "policy", "replay trajectory"  # what is read, as refusals name it
READ_TIMEOUT = 5.0  # after which a request does not wait any longer for what came before it [s]
RESTART_PERIOD = 1.0  # [s] between two starts of the process
SEEN = 16  # messages that a process started again does not read a second time
UNSENT = 200  # messages that wait for the process at most; the oldest are dropped
LOG_PERIOD_NS = 1_000_000_000  # [ns] between two warnings


class Preparation:
    """Starts the process, and again when it has ended; nothing here waits for it.

    Attributes:
        starts: Number of processes started so far.
        pid: Id of the process started last.

    Args:
        domain: DDS domain of the node.
        on_policy: Called by `poll` with every policy that fits the arm.
        on_movement: Called by `poll` with every movement that can be replayed, or why it cannot.
        on_refusal: Called by `poll` with what was refused, POLICY or MOVEMENT, and the reason.
    """

    def __init__(
        self,
        domain: int,
        on_policy: Callable[[PreparedPolicy], None],
        on_movement: Callable[[Sampled | ControllerError], None],
        on_refusal: Callable[[str, str], None],
    ) -> None:
        self._domain = domain
        self._on_policy, self._on_movement, self._on_refusal = on_policy, on_movement, on_refusal
        self.starts = 0
        self.pid: int | None = None
        self._started = -RESTART_PERIOD  # [s, steady clock]
        self._channel: Channel | None = None
        self._settings: dict[str, object] | None = None
        self._configuration = 0  # number of `configure`s: what was prepared before is dropped
        self._path: tuple[dict[str, object], dict[str, np.ndarray]] | None = None  # the last
        self._unsent: deque[tuple[dict[str, object], dict[str, np.ndarray] | None]] = deque(
            maxlen=UNSENT
        )
        self._reading: tuple[str, int] | None = None  # a message that is being read: kind, stamp
        self._seen: deque[tuple[str, int]] = deque(maxlen=SEEN)
        self._waiting: dict[int, tuple[Callable[[str | None], None], float]] = {}
        self._marks = 0
        self._warned_ns = -LOG_PERIOD_NS
        self.tend()

    # To the process

    def configure(self, settings: ControllerSettings | None, joint_names: Sequence[str]) -> None:
        """Let what comes be prepared for this arm.

        Args:
            settings: Settings of the controller, with limits; None to refuse what comes.
            joint_names: Names of the joints in trajectories.
        """
        self._configuration += 1
        self._settings = {
            "what": "configure",
            "number": self._configuration,
            "settings": None if settings is None else settings_values(settings),
            "joint_names": list(joint_names),
        }
        if self._channel is not None:
            self._send({**self._settings, "seen": list(self._seen)})

    def when_read(self, then: Callable[[str | None], None]) -> None:
        """Call `then` from `poll` once all that was published before has been read.

        Args:
            then: Function of None, or of the reason why that is not known.
        """
        self._marks += 1
        self._waiting[self._marks] = then, time.monotonic() + READ_TIMEOUT
        self._send({"what": "mark", "number": self._marks})

    def forget_requests(self) -> None:
        """Call none of those that wait for `when_read`."""
        self._waiting.clear()

    def publish_path(
        self, path: EndEffectorPath, start_ns: int, frame: str, fault: Fault | None = None
    ) -> None:
        """Publish the path of a rollout that began at `start_ns` [ns], and the fault at its end."""
        values: dict[str, object] = {"what": "path", "id": path.id, "start_ns": start_ns}
        values |= {"frame": frame, "fault": fault and [fault.kind.value, fault.text]}
        self._path = (
            values,
            {"t": path.t, "position": path.position, "quat_xyzw": path.quat_xyzw},
        )
        self._send(*self._path)

    def report(
        self,
        stamp_ns: int,
        name: str,
        hardware_id: str,
        level: str,
        text: str,
        values: Mapping[str, object],
    ) -> None:
        """Publish diagnostics of the loop; dropped while there is no process to do so."""
        if self._channel is not None:
            texts = {key: str(value) for key, value in values.items()}
            diagnosis = {"hardware_id": hardware_id, "level": level, "text": text, "values": texts}
            self._send({"what": "report", "stamp_ns": stamp_ns, "name": name, **diagnosis})

    def log(self, severity: str, text: str) -> None:
        """Log a text as "info" or "error", or as "warning" at most once a second."""
        now = time.monotonic_ns()
        if severity == "warning":
            if now - self._warned_ns < LOG_PERIOD_NS:
                return
            self._warned_ns = now
        self._send({"what": "log", "severity": severity, "text": text[:8000]})

    def _send(self, values: dict[str, object], arrays: dict[str, np.ndarray] | None = None) -> None:
        self._unsent.append((values, arrays))
        self._flush()

    def _flush(self) -> None:
        while self._unsent and self._channel is not None:
            try:
                self._channel.send(*self._unsent[0])
            except (BlockingIOError, ConnectionError):  # it is busy; or has ended: see `poll`
                return
            except (OSError, ValueError) as error:
                self._unsent.popleft()
                self.log("error", f"not handed to {NAME}: {error}")
            else:
                self._unsent.popleft()

    # From the process

    @property
    def waiting(self) -> bool:
        """Whether something is expected of the process."""
        return bool(self._waiting)

    def poll(self) -> None:
        """Take what the process has sent, a message at a time; between two states."""
        if self._channel is not None:
            self._flush()
            try:
                message = self._channel.receive()
            except MemoryError as error:
                self._refused(self._reading[0] if self._reading else POLICY, str(error))
            except EOFError:
                self._ended()
            else:
                if message is not None:
                    self._take(message)
        if self._waiting:
            now, reason = time.monotonic(), f"not read within {READ_TIMEOUT:.0f} s"
            for mark in [mark for mark, (_, late) in self._waiting.items() if now > late]:
                self._waiting.pop(mark)[0](f"what was published before was {reason}")

    def _take(self, message: Message) -> None:
        values, arrays = message
        what = values["what"]
        if what == "mark":
            if (waiting := self._waiting.pop(values["number"], None)) is not None:
                waiting[0](None)
        elif what == "reading":
            self._reading = values["kind"], values["stamp"]
        elif what == "refused":
            self._refused(values["kind"], values["text"])
        else:
            self._read()
            if values["configuration"] != self._configuration:
                return
            if what == "policy":
                scalars = values["tables"]
                tables = Tables(**{name: arrays.pop(name) for name in TABLES}, **scalars)
                self._on_policy(PreparedPolicy(**values["policy"], **arrays, tables=tables))
            elif what == "movement":
                self._on_movement(Sampled(**arrays, **values["movement"]))
            elif what == "no movement":
                refusal = Refusal(values["refusal"])
                self._on_movement(ControllerError(refusal, values["text"], values["values"]))

    def _refused(self, kind: str, text: str) -> None:
        self._read()
        self._on_refusal(kind, text)

    def _read(self) -> None:
        if self._reading is not None:
            self._seen.append(self._reading)
        self._reading = None

    def _ended(self) -> None:
        """Refuse what the process was reading, and let `tend` start another."""
        reading = self._reading
        if self._channel is not None:
            self._channel.close()
        self._channel = None
        reason = "the process that reads policies and trajectories has ended; it is started again"
        if reading is not None:
            self._refused(reading[0], reason)
        self.log("warning", reason)
        waiting, self._waiting = self._waiting, {}
        for then, _ in waiting.values():
            then(reason)

    # Its life

    def tend(self) -> None:
        """Start the process if it has ended; takes a few ms, so not while the arm moves."""
        if self._channel is not None or time.monotonic() - self._started < RESTART_PERIOD:
            return
        if self.pid is not None and os.waitpid(self.pid, os.WNOHANG)[0] == 0:
            return  # it is still ending
        self._started = time.monotonic()
        self._channel, theirs = pair()
        command = [sys.executable, "-m", MODULE, "--ros-args"]
        command += ["-r", f"{NAME}:__node:={NAME}", "--", *sys.argv[1:]]
        self.pid = os.posix_spawn(
            sys.executable,
            command,
            {**os.environ, "ROS_DOMAIN_ID": str(self._domain)},
            file_actions=[(os.POSIX_SPAWN_DUP2, theirs.fileno(), CHANNEL)],
            setsigmask=(signal.SIGINT, signal.SIGTERM),  # those of its group are the controller's
            scheduler=(os.SCHED_OTHER, os.sched_param(0)),
        )
        theirs.close()
        self.starts += 1
        if self._path is not None:
            self._unsent.appendleft(self._path)  # its topic is latched
        if self._settings is not None:
            self._unsent.appendleft(({**self._settings, "seen": list(self._seen)}, None))
        self._flush()

    def close(self) -> None:
        """Let the process log what it was handed, and end."""
        if self._channel is not None:
            self._channel.close()
        self._channel = None


TABLES = ("a", "b", "rotation_b")  # arrays of `dmp.Tables`


def settings_values(settings: ControllerSettings) -> dict[str, Any]:
    """Settings, with limits, as values that JSON has; floats survive it bit for bit."""

    def plain(of: ControllerSettings | Limits) -> dict[str, Any]:
        values = {each.name: getattr(of, each.name) for each in dataclasses.fields(of) if each.init}
        return {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in values.items()
        }

    if settings.limits is None:
        raise ValueError("settings without limits")
    return {**plain(settings), "limits": plain(settings.limits)}


def settings_of(values: Mapping[str, Any]) -> ControllerSettings:
    """The settings of which these are the values."""
    arm = values["arm"]
    if arm is not None:  # JSON makes lists of it
        name, joint_names, *digests = arm
        arm = ArmIdentity(name, tuple(joint_names), *digests)
    return ControllerSettings(**{**values, "limits": Limits(**values["limits"]), "arm": arm})


def channel_of_process() -> Channel:
    """The end of the channel that this process, started by `tend`, was given."""
    return Channel(socket.socket(fileno=CHANNEL))
