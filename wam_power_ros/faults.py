# SPDX-License-Identifier: Apache-2.0
"""Faults of the controller: their kinds, and which of them a policy causes."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class FaultKind(str, enum.Enum):
    """Kind of a controller fault; decisions depend on the kind, never on the fault's text."""

    # Caused by the policy: the return of the rollout is 0 and the policy is not retried.
    JOINT_POSITION = "joint_position"  # joint position limit exceeded
    JOINT_SPEED = "joint_speed"
    GUARDED_SPEED = "guarded_speed"  # speed of a guarded point, such as the elbow or the forearm
    TOOL_SPEED = "tool_speed"
    WORKSPACE = "workspace"  # the tool left its box
    PLANE = "plane"  # a guarded point or the tool is behind the keep-out plane
    # Not known to be caused by the policy: the rollout is not learnt from, see `Practice`.
    TRACKING = "tracking"  # a joint is far from its reference
    COMPUTATION = "computation"  # computed torque missing or not finite
    STATES_LOST = "states_lost"  # no joint state for too long
    STATES_REFUSED = "states_refused"  # too many invalid joint states
    JUMP = "jump"  # joint position jumped from one state to the next
    VELOCITY = "velocity"  # positions and velocities contradict each other
    DRIFT = "drift"  # the torque that holds an arm which reports rest has changed
    STANDSTILL = "standstill"  # a joint reports rest under a torque that friction cannot hold
    EXTERNAL_TORQUE = "external_torque"  # motion not explained by the commanded torques
    STAMPS = "stamps"  # the stamps do not advance with real time
    RELEASED = "released"  # the enabling switch was released
    SECOND_COMMANDER = "second_commander"  # another node publishes torques
    SECOND_PUBLISHER = "second_publisher"  # another node publishes states of these joints
    OVERLOAD = "overload"  # too many control periods missed
    SOFTWARE = "software"  # a callback raised an exception

    @property
    def of_policy(self) -> bool:
        """Whether the policy caused the fault by exceeding a motion limit."""
        return self in _OF_POLICY

    @property
    def of_person(self) -> bool:
        """Whether a person ended the movement: a refusal of its policy."""
        return self is FaultKind.RELEASED

    @property
    def of_states(self) -> bool:
        """Whether the joint states were false, whatever moved the arm."""
        return self in _OF_STATES


_OF_POLICY = frozenset(list(FaultKind)[:6])
_OF_STATES = frozenset((FaultKind.JUMP, FaultKind.VELOCITY, FaultKind.DRIFT, FaultKind.STANDSTILL))


@dataclass(frozen=True)
class Fault:
    """A latched fault of the controller."""

    kind: FaultKind
    text: str  # for the operator, with the value and the limit
