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
from wam_power_ros.learning.policy import Policy, from_json
from wam_power_ros.params.resources import share
from wam_power_ros.view.skeleton import Skeleton

DESCRIPTION, POLICY = "/robot_description", "/policy"  # topics below the arm's namespace
POLICY_TYPE = "wam_power_interfaces/msg/Policy"
STATE, ODOMETRY = "/state", "nav_msgs/msg/Odometry"  # topic of a body below its name; its type
URDFS = ("urdf/wam7.urdf", "urdf/cobot7.urdf")  # tried for a bag without a robot description
BODY_LEAD_MAX = 0.05  # [s] before the first joint state; earlier body states are dropped


@dataclass(frozen=True, eq=False)
class Movement:
    """A recorded movement.

    Attributes:
        t: Time since the first state [s], strictly increasing. Shape (T,).
        q: Joint angles [rad]. Shape (T, n).
        body: Name of the tracked body, "" for none.
        body_t: Times of the body states [s]. Shape (M,).
        body_position: Positions of the body [m]. Shape (M, 3).
        body_quat_wxyz: Orientations of the body. Shape (M, 4).
        policy: Executed policy, None for a demonstration.
    """

    name: str
    urdf: str
    joint_names: tuple[str, ...]
    t: np.ndarray
    q: np.ndarray
    body: str
    body_t: np.ndarray
    body_position: np.ndarray
    body_quat_wxyz: np.ndarray
    policy: Policy | None

    @property
    def duration(self) -> float:
        """Time from the first state to the last [s]."""
        return float(self.t[-1])

    def joints_at(self, t: float) -> np.ndarray:
        """Interpolated joint angles at time t [s] in rad. Shape (n,)."""
        return np.array([np.interp(t, self.t, column) for column in self.q.T])

    def body_at(self, t: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Position (3,) [m] and quaternion wxyz (4,) in the last body state before time t [s]."""
        index = int(np.searchsorted(self.body_t, t, side="right")) - 1
        return None if index < 0 else (self.body_position[index], self.body_quat_wxyz[index])


def read(path: Path) -> Movement:
    """Read the movement of a bag.

    Raises:
        ValueError: It is no bag, has no joint states, or only those of an unknown arm.
    """
    bag = Bag(path)
    urdf, skeleton = _description(bag)
    names = bag.arm.joint_names if bag.arm is not None else skeleton.joint_names
    states = read_states(bag, names)
    stamps, q = states.stamps, states.q
    body_topic = next(
        (n for n, t in bag.topics.items() if n.endswith(STATE) and t.msgtype == ODOMETRY), ""
    )
    body = np.array(list(_body_states(bag, body_topic, int(stamps[0])))).reshape(-1, 8)
    body = body[np.r_[True, np.diff(body[:, 0]) > 0.0]] if len(body) else body
    return Movement(
        name=path.name,
        urdf=urdf,
        joint_names=names,
        t=(stamps - stamps[0]) / 1e9,
        q=q,
        body=body_topic.removesuffix(STATE).rpartition("/")[2],
        body_t=body[:, 0],
        body_position=body[:, 1:4],
        body_quat_wxyz=body[:, 4:],
        policy=_policy(bag),
    )


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


def _found(bag: Bag, name: str, msgtype: str) -> Iterator[Any]:
    """Messages of the first topic of this type and name, in any namespace."""
    topics = [n for n, of in bag.topics.items() if n.endswith(name) and of.msgtype == msgtype]
    yield from _decoded(bag, topics[0], msgtype) if topics else ()


def _policy(bag: Bag) -> Policy | None:
    texts = [message.text for message in _found(bag, POLICY, POLICY_TYPE)]
    return from_json(texts[-1]) if texts else None


def _body_states(bag: Bag, topic: str, start_ns: int) -> Iterator[tuple[float, ...]]:
    """Time since the start [s], position [m] and quaternion wxyz of each state."""
    for message in _decoded(bag, topic, ODOMETRY) if topic else ():
        stamp, pose = message.header.stamp, message.pose.pose
        t = (stamp.sec * 1_000_000_000 + stamp.nanosec - start_ns) / 1e9
        p, o = pose.position, pose.orientation
        state = (t, p.x, p.y, p.z, o.w, o.x, o.y, o.z)
        if t >= -BODY_LEAD_MAX and np.isfinite(state).all():
            yield state


def _decoded(bag: Bag, topic: str, msgtype: str) -> Iterator[Any]:
    for _, _, cdr in bag.messages([topic]):
        yield decoded(cdr, msgtype)
