# SPDX-License-Identifier: Apache-2.0
"""Read movements from bags for drawing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.layout import STRING, decoded
from wam_power_ros.bags.reader import read_states
from wam_power_ros.bags.table import ODOMETRY, STATE, body_poses
from wam_power_ros.learning.policy import Policy, from_json
from wam_power_ros.params.resources import share
from wam_power_ros.view.skeleton import Skeleton

DESCRIPTION, POLICY = "/robot_description", "/policy"  # topics below the arm's namespace
POLICY_TYPE = "wam_power_interfaces/msg/Policy"
URDFS = ("urdf/wam7.urdf", "urdf/cobot7.urdf")  # tried for a bag without a robot description
BODY_LEAD_MAX = 0.05  # [s] before the first joint state; earlier body states are dropped


@dataclass(frozen=True, eq=False)
class Movement:
    """A recorded movement."""

    urdf: str
    joint_names: tuple[str, ...]
    t: np.ndarray  # time since the first state [s], strictly increasing (T,)
    q: np.ndarray  # joint angles [rad] (T, n)
    body: str
    body_states: np.ndarray  # time [s], position [m] and quaternion wxyz of the body (M, 8)
    policy: Policy | None  # executed policy, None for a demonstration

    @property
    def duration(self) -> float:
        """Time from the first state to the last [s]."""
        return float(self.t[-1])

    def joints_at(self, t: float) -> np.ndarray:
        """Interpolated joint angles at time t [s] in rad. Shape (n,)."""
        return np.array([np.interp(t, self.t, column) for column in self.q.T])

    def body_at(self, t: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Position (3,) [m] and quaternion wxyz (4,) in the last body state before time t [s]."""
        index = int(np.searchsorted(self.body_states[:, 0], t, side="right")) - 1
        return None if index < 0 else np.split(self.body_states[index, 1:], [3])


def read(path: Path) -> Movement:
    """Read the movement of a bag.

    Raises:
        ValueError: It is no bag, has no joint states, or only those of an unknown arm.
    """
    bag = Bag(path)
    urdf, skeleton = _description(bag)
    names = bag.arm.joint_names if bag.arm is not None else skeleton.joint_names
    states = read_states(bag, names)
    t = (states.stamps - states.stamps[0]) / 1e9
    topic = _topic(bag, STATE, ODOMETRY)
    seen = sorted(dict(body_poses(bag, topic)).items()) if topic else []
    body = np.array([((at - states.stamps[0]) / 1e9, *pose) for at, pose in seen]).reshape(-1, 8)
    body = body[:, [0, 1, 2, 3, 7, 4, 5, 6]]  # quaternion wxyz
    body = body[np.isfinite(body).all(axis=1) & (body[:, :1] >= -BODY_LEAD_MAX).all(axis=1)]
    name = topic.removesuffix(STATE).rpartition("/")[2]
    texts = [message.text for message in _found(bag, POLICY, POLICY_TYPE)]
    policy = from_json(texts[-1]) if texts else None
    return Movement(urdf, tuple(names), t, states.q, name, body, policy)


def _description(bag: Bag) -> tuple[str, Skeleton]:
    """URDF and skeleton of the arm: from the bag, else the first of `URDFS` with its joints."""
    for message in _found(bag, DESCRIPTION, STRING):
        return message.data, Skeleton(message.data)
    texts = [share(urdf).read_text() for urdf in URDFS]
    for text in texts:
        skeleton = Skeleton(text)
        try:
            read_states(bag, skeleton.joint_names)
        except ValueError:
            continue
        return text, skeleton
    raise ValueError(
        f"{bag.path} has no {DESCRIPTION}, and its joints are not those of {list(URDFS)}"
    )


def _topic(bag: Bag, name: str, msgtype: str) -> str:
    """First topic of this type and name, in any namespace; "" for none."""
    topics = (n for n, of in bag.topics.items() if n.endswith(name) and of.msgtype == msgtype)
    return next(topics, "")


def _found(bag: Bag, name: str, msgtype: str) -> Iterator[Any]:
    topic = _topic(bag, name, msgtype)
    for _, _, cdr in bag.messages([topic]) if topic else ():
        yield decoded(cdr, msgtype)
