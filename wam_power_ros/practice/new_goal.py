# SPDX-License-Identifier: Apache-2.0
"""Policy for a goal that was never tried, predicted from the rollouts of a session.

The rollouts without exploration tell what the session's answer attains. The task knows roughly how
the attained goal changes with some of the coordinates z (`Task.goal_slope`); they move to where the
new goal is attained, all others stay: what made the answer succeed is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.improvement import ArmModel, feasibility, shrink
from wam_power_ros.practice.session_log import Record
from wam_power_ros.tasks.task import Task


def policy_for(
    task: Task,
    candidates: Sequence[Policy],
    records: Sequence[Record],
    goal: Mapping[str, float],
    arm: ArmModel,
    policy_id: str,
) -> tuple[Policy, str]:
    """Predict the policy that attains a goal.

    Args:
        task: Task of the session, with its own goal.
        candidates: Policies of the demonstrations of the session.
        records: Rollouts of the session, oldest first.
        goal: New values of the goal, by name; the others stay.
        arm: Model of the arm. If it cannot follow, the goal is approached as far as it can.
        policy_id: Id of the new policy.

    Returns:
        The policy, and a remark on what it was predicted from.

    Raises:
        ValueError: No rollout without exploration tells what it attained.
    """
    names = list(task.goal_values)
    runs = [(r, point) for r in records if r.kind != "explore" and (point := task.attained(r))]
    if not runs:
        raise ValueError("no rollout without exploration tells what goal it attained")
    last, _ = runs[-1]
    same = [point for r, point in runs if (r.demonstration, r.z) == (last.demonstration, last.z)]
    attained = np.mean([[point[name] for name in names] for point in same], axis=0)
    wanted = np.array([{**task.goal_values, **goal}[name] for name in names])
    demonstrated = next(p for p in candidates if p.id == last.demonstration)
    parametrization = task.parametrization(demonstrated)
    z = np.array(last.z)
    moved = z + np.linalg.pinv(task.goal_slope(parametrization)) @ (wanted - attained)
    is_feasible = feasibility(parametrization, arm, 0, policy_id)
    moved, halvings = shrink(moved, z, is_feasible)
    policy, _ = parametrization.policy(moved, policy_id)
    remark = f"predicted from {len(same)} rollouts of {last.id}"
    return policy, remark + (f", {0.5**halvings:.2g} of the way" if halvings else "")
