# SPDX-License-Identifier: Apache-2.0
"""The torque controller's side of its preparation process.

Slow work is done in a process beside the 500 Hz loop (`preparation_worker`): it receives requests,
reads, checks and tabulates their policies and movements, and answers, publishes and logs.
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
from wam_power_ros.control.safety import Limits
from wam_power_ros.learning.dmp import TabulatedPolicy
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.regions import Region
from wam_power_ros.ros.outcomes import Answer, Ended
from wam_power_ros.ros.process_channel import Channel, Message, pair

NAME = "torque_controller_preparation"  # node of the process
MODULE = "wam_power_ros.nodes.preparation_worker"
CHANNEL = 3  # file descriptor of its end of the channel
RESTART_PERIOD = 1.0  # [s] between two starts of the process
UNSENT_MAX = 200  # messages that wait for the process; the oldest are dropped
LOG_PERIOD_NS = 1_000_000_000  # [ns] between two warnings
Arrays = dict[str, np.ndarray] | None


class Preparation:
    """Starts the process, restarts it when it has ended, and never waits for it.

    `poll` calls `on_request` with the id of a request, what to do, the policy or movement that it
    is about, when it was sent [ns], and the last stop that its sender knows; `on_cancel` with the
    id of one that is cancelled; `on_refusal` with the reason why one was refused; `on_lost` with
    the id of one that the process had not read when it ended, and the reason.

    Attributes:
        starts: Number of processes started so far.
        pid: Id of the process started last.
    """

    def __init__(
        self,
        domain: int,
        on_request: Callable[[str, str, TabulatedPolicy | Sampled, int, str], None],
        on_cancel: Callable[[str], None],
        on_refusal: Callable[[str], None],
        on_lost: Callable[[str, str], None],
    ) -> None:
        self._domain = domain
        self._on_request, self._on_cancel = on_request, on_cancel
        self._on_refusal, self._on_lost = on_refusal, on_lost
        self.starts, self.logger = 0, "torque_controller"
        self.pid: int | None = None
        self._reading = ""  # id of the request that the process is reading; "" for none
        self._started = -RESTART_PERIOD  # [s, steady clock]
        self._channel: Channel | None = None
        self._settings: dict[str, object] | None = None
        self._configuration = 0  # count of `configure`; results of earlier ones are dropped
        self._path: tuple[dict[str, object], Arrays] | None = None  # the last
        self._unsent: deque[tuple[dict[str, object], Arrays]] = deque(maxlen=UNSENT_MAX)
        self._warned_ns = -LOG_PERIOD_NS
        self.restart_if_ended()

    # To the process

    def configure(self, settings: ControllerSettings | None, joint_names: Sequence[str]) -> None:
        """Set the arm for which policies and movements are prepared.

        With None for the settings, which have limits, all messages are refused.
        """
        self._configuration += 1
        self._settings = {
            "what": "configure",
            "number": self._configuration,
            "settings": None if settings is None else settings_values(settings),
            "joint_names": list(joint_names),
        }
        if self._channel is not None:
            self._send(self._settings)

    def begun(self, id: str) -> None:
        """Say that the movement of a request has begun."""
        self._send({"what": "begun", "id": id})

    def ended(self, id: str, answer: Answer, end: Ended | None = None) -> None:
        """End a request; with the end of a rollout that has run."""
        ended = end and {**vars(end), "fault": end.fault and vars(end.fault)}
        self._send({"what": "ended", "id": id, "answer": vars(answer), "end": ended})

    def publish_path(self, path: EndEffectorPath, start_ns: int, frame: str) -> None:
        """Publish the path of a rollout that began at a stamp [ns], in a frame."""
        values = {"what": "path", "id": path.id, "start_ns": start_ns, "frame": frame}
        self._path = (values, {"t": path.t, "position": path.position, "quat_xyzw": path.quat_xyzw})
        self._send(*self._path)

    def report(self, stamp_ns: int, values: Mapping[str, object], **status: str) -> None:
        """Publish diagnostics of the loop, as `diagnostics_message`; dropped without a process."""
        if self._channel is not None:
            texts = {key: str(value) for key, value in values.items()}
            self._send({"what": "report", "stamp_ns": stamp_ns, "values": texts, **status})

    def log(self, severity: str, text: str) -> None:
        """Log a text as "info" or "error", or at most once a second as "warning"."""
        now = time.monotonic_ns()
        if severity == "warning":
            if now - self._warned_ns < LOG_PERIOD_NS:
                return
            self._warned_ns = now
        named = {"name": self.logger, "severity": severity, "text": text[:8000]}
        self._send({"what": "log", **named})

    def _send(self, values: dict[str, object], arrays: Arrays = None) -> None:
        self._unsent.append((values, arrays))
        self._flush()

    def _flush(self) -> None:
        while self._unsent and self._channel is not None:
            unsent = self._unsent.popleft()
            try:
                self._channel.send(*unsent)
            except (BlockingIOError, ConnectionError):  # busy, or ended: see `poll`
                return self._unsent.appendleft(unsent)
            except (OSError, ValueError) as error:
                self.log("error", f"message not sent to {NAME}: {error}")
        return None

    # From the process

    def poll(self) -> None:
        """Handle at most one message from the process; called between two states."""
        if self._channel is None:
            return None
        self._flush()
        try:
            message = self._channel.receive()
        except MemoryError as error:
            return self._lose(str(error))
        except EOFError:
            self.close()
            reason = "the process that reads policies and trajectories has ended and is restarted"
            self._lose(reason)
            return self.log("warning", reason)
        return None if message is None else self._take(message)

    def _lose(self, reason: str) -> None:
        """Refuse the request that the process was reading."""
        id, self._reading = self._reading, ""
        if id:
            self._on_lost(id, reason)

    def _take(self, message: Message) -> None:
        values, arrays = message
        what = values["what"]
        if what == "reading":
            self._reading = values["id"]
            return
        self._reading = ""
        if what == "cancel":
            self._on_cancel(values["id"])
        elif what == "refused":
            self._on_refusal(values["text"])
        elif values["configuration"] != self._configuration:
            self._on_lost(values["id"], "the controller was configured anew")
        else:
            kind = Sampled if values["action"] == "replay" else TabulatedPolicy
            payload = kind(**values["payload"], **arrays)
            asked = values["sent_ns"], values["known_stop"]
            self._on_request(values["id"], values["action"], payload, *asked)

    # Start and end of the process

    def restart_if_ended(self) -> None:
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
            self._unsent.appendleft((self._settings, None))
        self._flush()

    def close(self) -> None:
        """Close the channel; the process handles the messages already sent, then ends."""
        if self._channel is not None:
            self._channel.close()
        self._channel = None


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
    """Channel of this process, which `restart_if_ended` has started, to the torque controller."""
    return Channel(socket.socket(fileno=CHANNEL))
