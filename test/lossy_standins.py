# SPDX-License-Identifier: Apache-2.0
"""The stand-ins over two links that delay, jitter and lose: states out, torques in."""

from __future__ import annotations

import copy
import sys
import time
from collections import deque
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from hardware_sim import arm_node, main
from wam_power_ros.ros.joint_messages import TorqueReading

LATENCY, JITTER = 0.001, 0.0003  # [s] mean delay, and its standard deviation
LOSS = 0.02  # share of lost messages


class Link:
    """Queue whose items arrive in order after random delays, except those that are lost."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._in_transit: deque[tuple[float, Any]] = deque()

    def put(self, item: object) -> None:
        """Send an item."""
        if self._rng.random() >= LOSS:
            delay = max(0.0, LATENCY + JITTER * self._rng.standard_normal())
            self._in_transit.append((time.monotonic() + delay, item))

    def take(self) -> list[Any]:
        """Remove and return the items that have arrived, in order."""
        arrived = []
        while self._in_transit and self._in_transit[0][0] <= time.monotonic():
            arrived.append(self._in_transit.popleft()[1])
        return arrived


class FarArm(arm_node.ArmSim):
    """An arm at the end of these links."""

    def __init__(self) -> None:
        super().__init__()
        self._outward, self._inward = Link(0), Link(1)

    def publish(self, message: JointState) -> None:
        """Send a state, and publish those that have arrived."""
        self._outward.put(copy.deepcopy(message))
        for arrived in self._outward.take():
            super().publish(arrived)

    def tick(self, reading: TorqueReading | None) -> JointState:
        """Send a torque, and step with the last that has arrived."""
        if reading is not None:
            self._inward.put(reading)
        arrived = self._inward.take()
        return super().tick(arrived[-1] if arrived else None)


if __name__ == "__main__":
    main.ArmSim = FarArm
    sys.exit(main.main())
