# SPDX-License-Identifier: Apache-2.0
"""A policy before its execution: checked against the arm, and tabulated."""

import hashlib
from dataclasses import replace

import numpy as np

from wam_power_ros.arm_identity import refusal
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.safety import Limits
from wam_power_ros.learning import dmp
from wam_power_ros.learning.dmp import TabulatedPolicy
from wam_power_ros.learning.policy import Policy, to_json, with_id


def prepare(policy: Policy, limits: Limits, settings: ControllerSettings) -> TabulatedPolicy:
    """Check that a policy fits the arm, and tabulate it.

    Its `content` is given with `hold_to_run` alone.

    Raises:
        ControllerError: The policy does not fit the arm.
    """
    start, name, n = policy.q_start, f"policy {policy.id}", len(limits.q_min)
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
    tabulated = dmp.tabulate(policy, settings.period)
    if not settings.hold_to_run:
        return tabulated
    content = hashlib.sha256(to_json(with_id(policy, "content")).encode()).hexdigest()
    return replace(tabulated, content=content)
