# SPDX-License-Identifier: Apache-2.0
"""Torques or positions of a bag that a controller sent to the driver, by the states they answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import JOINT_STATE, decoded
from wam_power_ros.bags.writer import header_stamp

ARRAY = "std_msgs/msg/Float64MultiArray"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
ANSWERED_MIN = 0.9  # share of the states without whose torques a recording is not usable


def read_commands(
    bag: Bag, topic: str, stamps: np.ndarray, joint_names: Sequence[str]
) -> np.ndarray:
    """Torque sent for each state, that of the state before where none was sent [N m]. (M, n).

    The states are given by their stamps [ns], shape (M,); `joint_names` go base to tip.

    Raises:
        ValueError: The topic is missing, its messages are malformed, or most states have no torque.
    """
    sent = _sent(bag, topic, joint_names)
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


def read_set_points(
    bag: Bag, topic: str, joint_names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (M,) [ns] of the states that positions answer, in order, and positions (M, n) [rad].

    Raises:
        ValueError: The topic is missing or empty, or its messages are malformed.
    """
    if not (sent := _sent(bag, topic, joint_names)):
        raise ValueError(f"{bag.path}: no positions on {topic}")
    stamps = sorted(sent)
    return np.array(stamps), np.array([sent[stamp] for stamp in stamps])


def _sent(bag: Bag, topic: str, joint_names: Sequence[str]) -> dict[int, list[float]]:
    """Torques or positions by the stamp of the state that they answer [ns]; see above."""
    kind = bag.type_of(topic, ARRAY, JOINT_STATE, TRAJECTORY)
    sent: dict[int, list[float]] = {}
    for _, _, cdr in bag.messages([topic]):
        message = decoded(cdr, kind)
        if kind == JOINT_STATE:
            given = message.effort if len(message.effort) else message.position
            by_name = dict(zip(message.name, given.tolist(), strict=True))
            stamp, values = header_stamp(cdr), [by_name[name] for name in joint_names]
        else:
            of_array = kind == ARRAY
            label = message.layout.dim[0].label if of_array else message.header.frame_id
            stamp = int(label.partition(" ")[0])
            values = (message.data if of_array else message.points[-1].positions).tolist()
        if len(values) != len(joint_names):
            text = f"{len(values)} values on {topic}, one for each of {list(joint_names)} needed"
            raise ValueError(f"{bag.path}: {text}")
        sent[stamp] = values
    return sent
