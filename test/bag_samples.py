# SPDX-License-Identifier: Apache-2.0
"""Bags and messages of the tests; messages are bytes of ROS, not of the library that reads them."""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from wam_power_ros.bags import layout
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.ros.joint_messages import JointStateWriter

NAMES = ("wam_j1", "wam_j2", "wam_j3")
START = 1_700_000_000_123_456_789
WAM = tuple(f"wam_j{joint}" for joint in range(1, 8))
BAGS = Path(__file__).resolve().parents[1] / "bags"
REACH, DEMO = (min(BAGS.glob(f"{stem}_*")) for stem in ("reach", "demo"))  # shipped ones
QOS = [layout.qos(reliable=True, latched=False)]
LATCHED = [layout.qos(reliable=True, latched=True, depth=1)]


def joint_state(stamp_ns: int, names: tuple[str, ...], q: np.ndarray) -> bytes:
    return serialize_message(JointStateWriter(names)(stamp_ns, q, (), ()))


def string(text: str) -> bytes:
    return serialize_message(String(data=text))


def demonstration(path: Path, q: np.ndarray, names: tuple[str, ...] = NAMES) -> Path:
    """A bag of joint states 2 ms apart, with a robot description and a foreign device's states."""
    writer = BagWriter(path)
    writer.add("/robot_description", layout.STRING, LATCHED)
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    writer.write("/robot_description", START, string("<robot/>"))
    for index, row in enumerate(q):
        stamp_ns = START + 2_000_000 * index
        writer.write("/joint_states", stamp_ns + 500_000, joint_state(stamp_ns, names, row))
        writer.write("/joint_states", stamp_ns + 600_000, joint_state(stamp_ns, ("hand",), [0.0]))
    return writer.close({"joint_names": json.dumps(names), "state_topic": "/joint_states"})


def random_q(count: int = 500, seed: int = 0) -> np.ndarray:
    """A movement without a jump: steps of about 0.01 rad."""
    return 0.01 * np.random.default_rng(seed).normal(size=(count, len(NAMES))).cumsum(axis=0)


def of_states(path: Path, states: Iterable[tuple[int, int, tuple[str, ...], object]]) -> Path:
    """A bag of joint states: time of reception, stamp, names and positions of each."""
    writer = BagWriter(path)
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    for received_ns, stamp_ns, names, q in states:
        writer.write("/joint_states", received_ns, joint_state(stamp_ns, names, np.asarray(q)))
    return writer.close({})
