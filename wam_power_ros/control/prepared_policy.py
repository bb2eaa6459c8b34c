# SPDX-License-Identifier: Apache-2.0
"""Check a policy against the arm, and compute the tables that its rollouts need."""

import hashlib
from dataclasses import dataclass

import numpy as np

from wam_power_ros.arm_identity import refusal
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.safety import Limits
from wam_power_ros.learning import dmp
from wam_power_ros.learning.policy import Policy, to_json, with_id


@dataclass(frozen=True, eq=False)
class PreparedPolicy:
    """A policy that was checked for the arm, with the tables that a rollout needs.

    Attributes:
        id: Id of the policy.
        duration: Duration of the movement [s].
        q_start: Joint angles at the start [rad]. Shape (n,).
        orientation_reference: R_ref as a unit quaternion xyzw. Shape (4,).
        tables: Tables of Eq. 1, sampled at the control period.
        content: Digest of the policy without its id; empty without `hold_to_run`.
    """

    id: str
    duration: float
    q_start: np.ndarray
    orientation_reference: np.ndarray
    tables: dmp.Tables
    content: str


def prepare(policy: Policy, n: int, limits: Limits, settings: ControllerSettings) -> PreparedPolicy:
    """Check a policy and compute its tables.

    Args:
        policy: Policy to execute.
        n: Number of joints of the arm.
        limits: Limits of the arm.
        settings: Settings of the controller.

    Raises:
        ControllerError: The policy does not fit the arm.
    """
    start, name = policy.q_start, f"policy {policy.id}"
    stiffness = max(float(np.linalg.norm(k, 2)) for k in policy.stiffness)
    stiffness = max(stiffness, policy.rotation_stiffness)
    damping = max(policy.damping, policy.rotation_damping)
    text = ""
    if start.shape != (n,):
        text = f"{name} is for {start.size} joints, the arm has {n}"
    elif np.any(start < limits.q_min) or np.any(start > limits.q_max):
        allowed = f"{limits.q_min.tolist()} to {limits.q_max.tolist()}"
        text = f"q_start {start.round(3).tolist()} of {name} is outside the limits {allowed}"
    elif stiffness > (limit := settings.stiffness_max):
        text = f"stiffness {stiffness:.0f} of {name} is above the limit {limit:.0f} 1/s^2"
    elif damping > (limit := settings.damping_max):
        text = f"damping {damping:.0f} of {name} is above the limit {limit:.0f} 1/s"
    elif reason := refusal(policy.arm, settings.arm):
        text = f"{name} {reason}"
    if text:
        raise ControllerError(Refusal.REFUSED, text)
    content = ""
    if settings.hold_to_run:
        content = hashlib.sha256(to_json(with_id(policy, "content")).encode()).hexdigest()
    return PreparedPolicy(
        id=policy.id,
        duration=policy.basis.duration,
        q_start=start,
        orientation_reference=policy.orientation_reference,
        tables=dmp.tabulate(policy, settings.period),
        content=content,
    )
