# SPDX-License-Identifier: Apache-2.0
"""Bags and messages of the tests."""

import json
from pathlib import Path

import numpy as np

from wam_power_ros.bags import layout
from wam_power_ros.bags.layout import TYPES
from wam_power_ros.bags.writer import BagWriter

NAMES = ("wam_j1", "wam_j2", "wam_j3")
START = 1_700_000_000_123_456_789
QOS = [layout.qos(reliable=True, latched=False)]
LATCHED = [layout.qos(reliable=True, latched=True, depth=1)]
make = TYPES.types


def joint_state(stamp_ns: int, names: tuple[str, ...], q: np.ndarray) -> bytes:
    time_type = make["builtin_interfaces/msg/Time"]
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    header = make["std_msgs/msg/Header"](stamp=time_type(sec=sec, nanosec=nanosec), frame_id="")
    empty = np.zeros(0)
    message = make[layout.JOINT_STATE](
        header=header, name=list(names), position=np.array(q), velocity=empty, effort=empty
    )
    return bytes(TYPES.serialize_cdr(message, layout.JOINT_STATE))


def string(text: str) -> bytes:
    return bytes(TYPES.serialize_cdr(make[layout.STRING](data=text), layout.STRING))


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
    return np.random.default_rng(seed).normal(size=(count, len(NAMES)))
