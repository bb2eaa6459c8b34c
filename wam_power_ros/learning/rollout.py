# SPDX-License-Identifier: Apache-2.0
"""Finished rollouts: path of the tool, path of the tracked body, fault that ended the rollout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wam_power_ros.faults import Fault
from wam_power_ros.learning.policy import check_id, read_only

LEAD_TIME = 300_000_000  # before a rollout, of which the path of its body has frames, too [ns]


@dataclass(frozen=True, eq=False)
class _Path:
    """Path of a frame in the base frame during one rollout; arrays are copied and read-only.

    Attributes:
        t: Time since the start of the rollout, strictly increasing [s]. Shape (T,).
        position: Origin of the frame [m]. Shape (T, 3).
        quat_xyzw: Orientation, unit quaternions. Shape (T, 4).

    Raises:
        ValueError: If a shape is wrong, a value is not finite, time does not increase or a
            quaternion is not of unit length.
    """

    id: str
    t: np.ndarray
    position: np.ndarray
    quat_xyzw: np.ndarray

    def __post_init__(self) -> None:
        check_id(self.id)
        name = f"path {self.id}"
        count = np.size(self.t)
        for field, shape in (("t", (count,)), ("position", (count, 3)), ("quat_xyzw", (count, 4))):
            array = read_only(f"{name}: {field}", getattr(self, field), shape)
            object.__setattr__(self, field, array)
        steps = np.diff(self.t)
        if np.any(steps <= 0.0):
            at = int(np.argmax(steps <= 0.0))
            raise ValueError(
                f"{name}: t[{at + 1}] = {self.t[at + 1]} follows {self.t[at]}; it must increase"
            )
        norms = np.linalg.norm(self.quat_xyzw, axis=1)
        wrong = np.abs(norms - 1.0) > 1e-3
        if np.any(wrong):
            at = int(np.argmax(wrong))
            raise ValueError(f"{name}: quat_xyzw[{at}] has length {norms[at]}; it must be 1")


class EndEffectorPath(_Path):
    """Path of the tool frame, with at least one pose."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.t) == 0:
            raise ValueError(f"end-effector path {self.id} is empty; at least one pose is needed")


class BodyPath(_Path):
    """Measured path of the tracked body, with gaps where it was hidden; may be empty."""

    def part(self, kept: np.ndarray) -> BodyPath:
        """Path of the frames that are `kept` (T,)."""
        return BodyPath(self.id, self.t[kept], self.position[kept], self.quat_xyzw[kept])


class SimulatedRollout(NamedTuple):
    """Execution of a policy on a model of the arm.

    Attributes:
        limit_excess: Share by which each joint's range and each highest speed exceeds what is
            allowed; below 0 if it does not. Shape (c,).
    """

    tool: EndEffectorPath
    limit_excess: np.ndarray


@dataclass(frozen=True, eq=False)
class Rollout:
    """A finished rollout.

    Attributes:
        body: Path of the tracked body from the start on, None for a task that tracks none. Frames
            before it, at t < 0, are moved to `before`.
        stopped_in: Name of the guarded region that ended the rollout, "" if none did.
        before: Path of the body just before the start, while the arm held it at rest; None if it
            was not seen.

    Raises:
        ValueError: If the two paths belong to different policies.
    """

    tool: EndEffectorPath
    body: BodyPath | None = None
    fault: Fault | None = None
    stopped_in: str = ""
    before: BodyPath | None = None

    def __post_init__(self) -> None:
        if self.body is not None and self.body.id != self.tool.id:
            raise ValueError(
                f"body path of rollout {self.body.id!r}, but tool path of {self.tool.id!r}"
            )
        if self.body is not None and len(self.body.t) and self.body.t[0] < 0.0:
            early = self.body.t < 0.0
            object.__setattr__(self, "before", self.body.part(early))
            object.__setattr__(self, "body", self.body.part(~early))
