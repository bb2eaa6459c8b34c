# SPDX-License-Identifier: Apache-2.0
"""Client of Motive: frames of NatNet in, pose of a rigid body out, stamped at the exposure.

The stamp is the time of receipt less the time from the middle of the exposure to the transmission,
which NatNet 3 and later state in ticks of the server's clock. What remains is the network's delay.
"""

from __future__ import annotations

import socket
from collections import deque

import numpy as np
from geometry_msgs.msg import PoseStamped
from natnet import DataDescriptions, DataFrame, NatNetClient
from natnet.exceptions import NatNetError
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from wam_power_ros.params.driver_params import NatNetClientParams
from wam_power_ros.ros import interface, node_runner, pose_messages
from wam_power_ros.ros.diagnostics import Diagnostics

PING = b"\0\0\5\0Ping\0"  # NAT_CONNECT
FREQUENCY_AT = 4 + 256 + 4 + 4  # in the answer: head, name, versions of Motive and NatNet
ANSWER_MAX = 1.0  # time for an answer [s]
LATENCY_MAX = 0.5  # of Motive; more is no latency [s]


def clock_frequency(server: str, port: int) -> float:
    """Ticks per second of the server's clock, 0 before NatNet 3; an OSError if none answers."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.settimeout(ANSWER_MAX)
        asking.sendto(PING, (server, port))
        answer = asking.recv(1024)
    return float(int.from_bytes(answer[FREQUENCY_AT : FREQUENCY_AT + 8], "little"))


class NatNet(Node):
    """Publishes a pose for each frame in which Motive sees the rigid body."""

    def __init__(self) -> None:
        super().__init__("natnet_client", automatically_declare_parameters_from_overrides=True)
        self._params = params = NatNetClientParams.from_node(self)
        self._names: dict[int, str] = {}  # of the rigid bodies
        self._problem, self._frequency = "no answer yet", 0.0
        self._recent: deque[float] = deque(maxlen=1000)  # latency of Motive, NaN: no pose [s]
        addresses = params.server, params.local, params.group
        ports = params.command_port, params.data_port
        self._client = NatNetClient(*addresses, *ports, params.multicast)
        self._client.on_data_frame_received_event.handlers.append(self._on_frame)
        self._client.on_data_description_received_event.handlers.append(self._on_names)
        topic = interface.body_topic(params.body, "pose")
        self._poses = self.create_publisher(PoseStamped, topic, interface.STATE_OUT)
        self._diagnostics = Diagnostics(self, "NatNet", params.body)
        self.create_timer(1.0, self._supervise, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_names(self, described: DataDescriptions) -> None:
        self._names = {body.id_num: body.name for body in described.rigid_bodies}

    def _on_frame(self, frame: DataFrame) -> None:
        """Publish the pose, in the thread of the library, which an exception would end."""
        received, late = self.get_clock().now().nanoseconds, np.nan
        try:
            for body in frame.rigid_bodies:
                if self._names.get(body.id_num) == self._params.body and body.tracking_valid:
                    late = self._latency(frame)
                    head = received - round(1e9 * late), self._params.frame
                    place, quat = np.array(body.pos), np.array(body.rot)
                    self._poses.publish(pose_messages.pose_message(*head, place, quat))
        except ValueError as error:
            self._problem = str(error)
        self._recent.append(late)

    def _latency(self, frame: DataFrame) -> float:
        """Time from exposure, or from the cameras' data if that is not known, to sending [s]."""
        sent, begun = frame.suffix.stamp_transmit, frame.suffix.stamp_camera_mid_exposure
        begun = begun or frame.suffix.stamp_data_received
        latency = (sent - begun) / self._frequency if self._frequency and begun and sent else 0.0
        if not 0.0 <= latency <= LATENCY_MAX:
            raise ValueError(f"Motive states a latency of {latency:.3f} s: no pose is published")
        return latency

    def _supervise(self) -> None:
        """Connect again if nothing was received for a second, ask for the names, and report."""
        recent, self._recent = np.array(self._recent), deque(maxlen=1000)
        try:
            if not len(recent):
                self._client.shutdown()
                self._frequency = clock_frequency(self._params.server, self._params.command_port)
                self._client.connect(ANSWER_MAX)
                self._client.run_async()
            self._client.request_modeldef()
        except (OSError, NatNetError) as error:
            self._problem = f"{self._params.server}: {error or 'no answer'}"
        seen = recent[np.isfinite(recent)]
        share = f"{len(seen)} of {len(recent)} frames"
        names = ", ".join(self._names.values()) or "none"
        values = {"frames with a pose": share, "rigid bodies": names, "last problem": self._problem}
        if len(seen):
            values["latency of Motive [s]"] = f"{np.median(seen):.4f}"
        level = "ok" if len(seen) > 0.5 * len(recent) else "warn" if len(recent) else "stale"
        self._diagnostics.publish(level, share if len(recent) else self._problem, values)

    def close(self) -> None:
        """End the library's threads."""
        self._client.shutdown()


def main() -> int:
    """Entry point of `ros2 run wam_power_ros natnet_client`."""
    return node_runner.run(NatNet)
