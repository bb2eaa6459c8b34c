# SPDX-License-Identifier: Apache-2.0
"""The torque controller's side of its preparation process.

Slow work is done in a process beside the 500 Hz loop (`preparation_worker`): it receives policies
and movements to replay, reads, checks and tabulates them, and publishes and logs for the loop.
docs/architecture.md says why this is a process and not a thread.
"""

from __future__ import annotations

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
from wam_power_ros.faults import Fault
from wam_power_ros.learning.dmp import Tables
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.regions import Region
from wam_power_ros.ros.process_channel import Channel, Message, pair

NAME = "torque_controller_preparation"  # node of the process
MODULE = "wam_power_ros.nodes.preparation_worker"
CHANNEL = 3  # file descriptor of its end of the channel
POLICY, MOVEMENT = "policy", "replay trajectory"  # kinds of messages, as refusals name them
READ_TIMEOUT = 5.0  # longest wait of a request until earlier messages are read [s]
RESTART_PERIOD = 1.0  # [s] between two starts of the process
SEEN_MAX = 16  # last messages, which a restarted process must not read again
UNSENT_MAX = 200  # messages that wait for the process; the oldest are dropped
LOG_PERIOD_NS = 1_000_000_000  # [ns] between two warnings


class Preparation:
    """Starts the process, restarts it when it has ended, and never waits for it.

    Attributes:
        starts: Number of processes started so far.
        pid: Id of the process started last.

    Args:
        domain: DDS domain of the node.
        on_policy: Called by `poll` with every policy that fits the arm.
        on_movement: Called by `poll` with every movement to replay, or the error if it cannot be.
        on_refusal: Called by `poll` with the kind of a refused message, POLICY or MOVEMENT, and the
            reason.
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
        self._configuration = 0  # count of `configure`; results of earlier ones are dropped
        self._path: tuple[dict[str, object], dict[str, np.ndarray]] | None = None  # the last
        self._unsent: deque[tuple[dict[str, object], dict[str, np.ndarray] | None]] = deque(
            maxlen=UNSENT_MAX
        )
        self._reading: tuple[str, int] | None = None  # the message being read: kind, stamp
        self._seen: deque[tuple[str, int]] = deque(maxlen=SEEN_MAX)
        self._waiting: dict[int, tuple[Callable[[str | None], None], float]] = {}  # by mark
        self._marks = 0
        self._warned_ns = -LOG_PERIOD_NS
        self.tend()

    # To the process

    def configure(self, settings: ControllerSettings | None, joint_names: Sequence[str]) -> None:
        """Set the arm for which policies and movements are prepared.

        Args:
            settings: Settings of the controller, with limits; None to refuse all messages.
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
        """Call `then` from `poll` once all messages published before have been read.

        Args:
            then: Called with None, or with the reason why this is not known.
        """
        self._marks += 1
        self._waiting[self._marks] = then, time.monotonic() + READ_TIMEOUT
        self._send({"what": "mark", "number": self._marks})

    def forget_requests(self) -> None:
        """Drop all pending calls of `when_read`."""
        self._waiting.clear()

    def publish_path(
        self,
        path: EndEffectorPath,
        start_ns: int,
        frame: str,
        fault: Fault | None = None,
        digest: str = "",
        stopped_in: str = "",
    ) -> None:
        """Publish the path of a rollout.

        Args:
            path: Path of the tool.
            start_ns: Stamp of its begin [ns].
            frame: Frame of the path.
            fault: Fault at its end, None without one.
            digest: Digest of the executed policy, see `policy.digest`.
            stopped_in: Name of the guarded region that ended it, "" if none did.
        """
        values: dict[str, object] = {"what": "path", "id": path.id, "start_ns": start_ns}
        values |= {"frame": frame, "fault": fault and [fault.kind.value, fault.text]}
        values |= {"digest": digest, "stopped_in": stopped_in}
        self._path = (values, {"t": path.t, "position": path.position, "quat_xyzw": path.quat_xyzw})
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
        """Log a text as "info" or "error", or at most once a second as "warning"."""
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
            except (BlockingIOError, ConnectionError):  # busy, or ended: see `poll`
                return
            except (OSError, ValueError) as error:
                self._unsent.popleft()
                self.log("error", f"message not sent to {NAME}: {error}")
            else:
                self._unsent.popleft()

    # From the process

    @property
    def waiting(self) -> bool:
        """True while calls of `when_read` are pending."""
        return bool(self._waiting)

    def poll(self) -> None:
        """Handle at most one message from the process; called between two states."""
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
            now = time.monotonic()
            reason = f"messages published before were not read within {READ_TIMEOUT:.0f} s"
            for mark in [mark for mark, (_, late) in self._waiting.items() if now > late]:
                self._waiting.pop(mark)[0](reason)

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
            self._finish_reading()
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
        self._finish_reading()
        self._on_refusal(kind, text)

    def _finish_reading(self) -> None:
        if self._reading is not None:
            self._seen.append(self._reading)
        self._reading = None

    def _ended(self) -> None:
        """Refuse the message that the process was reading, and let `tend` start another."""
        self.close()
        reason = "the process that reads policies and trajectories has ended and is restarted"
        if self._reading is not None:
            self._refused(self._reading[0], reason)
        self.log("warning", reason)
        waiting, self._waiting = self._waiting, {}
        for then, _ in waiting.values():
            then(reason)

    # Start and end of the process

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
            setsigmask=(signal.SIGINT, signal.SIGTERM),  # only the controller acts on them
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
        """Close the channel; the process handles the messages already sent, then ends."""
        if self._channel is not None:
            self._channel.close()
        self._channel = None


TABLES = ("a", "b", "rotation_b")  # arrays of `dmp.Tables`


def settings_values(settings: ControllerSettings) -> dict[str, Any]:
    """Settings, with limits, as JSON values, which keep floats bit for bit."""
    if settings.limits is None:
        raise ValueError("settings without limits")
    limits = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in vars(settings.limits).items()
        if not name.startswith("_")
    }
    region = settings.region and [*vars(settings.region).values()]
    return {**vars(settings), "limits": limits, "region": region}


def settings_of(values: Mapping[str, Any]) -> ControllerSettings:
    """Inverse of `settings_values`."""
    arm = values["arm"]
    if arm is not None:  # a list of lists in JSON
        name, joint_names, *digests = arm
        arm = ArmIdentity(name, tuple(joint_names), *digests)
    region = values["region"] and Region(*values["region"])
    limits = Limits(**values["limits"])
    return ControllerSettings(**{**values, "limits": limits, "arm": arm, "region": region})


def channel_of_process() -> Channel:
    """Channel of this process, which `tend` has started, to the torque controller."""
    return Channel(socket.socket(fileno=CHANNEL))
