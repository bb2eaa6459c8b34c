# SPDX-License-Identifier: Apache-2.0
"""Torques of a bag that a controller sent to the driver, by the states that they answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import JOINT_STATE, decoded
from wam_power_ros.bags.writer import header_stamp

ARRAY = "std_msgs/msg/Float64MultiArray"
ANSWERED_MIN = 0.9  # share of the states without whose torques a recording is not usable


def read_commands(
    bag: Bag, topic: str, stamps: np.ndarray, joint_names: Sequence[str]
) -> np.ndarray:
    """Torque sent for each state, that of the state before where none was sent [N m]. (M, n).

    The states are given by their stamps [ns], shape (M,); `joint_names` go base to tip.

    Raises:
        ValueError: The topic is missing, its messages are malformed, or most states have no torque.
    """
    if topic not in bag.topics:
        raise ValueError(f"{bag.path}: no topic {topic}; it has {sorted(bag.topics)}")
    kind = bag.topics[topic].msgtype
    if kind not in (ARRAY, JOINT_STATE):
        raise ValueError(f"{bag.path}: {topic} is of type {kind}, not {ARRAY} or {JOINT_STATE}")
    sent: dict[int, list[float]] = {}
    for _, _, cdr in bag.messages([topic]):
        message = decoded(cdr, kind)
        if kind == ARRAY:
            stamp = int(message.layout.dim[0].label.partition(" ")[0])
            torques = message.data.tolist()
        else:
            by_name = dict(zip(message.name, message.effort.tolist(), strict=True))
            stamp, torques = header_stamp(cdr), [by_name[name] for name in joint_names]
        if len(torques) != len(joint_names):
            text = f"{len(torques)} torques on {topic}, one for each of {list(joint_names)} needed"
            raise ValueError(f"{bag.path}: {text}")
        sent[stamp] = torques
    answered = [stamp in sent for stamp in stamps.tolist()]
    if not np.mean(answered) >= ANSWERED_MIN:
        raise ValueError(
            f"{bag.path}: {sum(answered)} of {len(stamps)} states were answered on {topic}"
        )
    first = sent[next(stamp for stamp in stamps.tolist() if stamp in sent)]
    rows = []
    for stamp in stamps.tolist():
        first = sent.get(stamp, first)
        rows.append(first)
    return np.array(rows)
