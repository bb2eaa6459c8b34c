# SPDX-License-Identifier: Apache-2.0
"""Policy for a goal that was never tried, predicted from the rollouts of a session.

A goal states targets of the task. `Task.carried` changes the session's answer as physics says. What
the rollouts without exploration missed, measured from the new targets, the task's effects correct.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.learning_run import ArmModel, feasibility, shrink
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.tasks.task import Task


def context_for(
    settings: SessionSettings, context: Mapping[str, Any], goal: Mapping[str, float]
) -> dict[str, Any]:
    """Context of a session's task with new values of some of its `targets`; the others stay.

    Raises:
        ValueError: The task has no such targets, or they cannot have these values.
    """
    targets = settings.make_task(context).targets
    if unknown := goal.keys() - targets.keys():
        known = ", ".join(targets) or "nothing that can be changed"
        raise ValueError(f"a goal of {settings.task} is {known}, not {min(unknown)!r}")
    moved = {**context, "goal": {**context.get("goal", {}), **goal}}
    settings.make_task(moved)  # refuses values
    return moved


def policy_for(
    task: Task,
    known: Task,
    candidates: Sequence[Policy],
    records: Sequence[Record],
    arm: ArmModel,
    policy_id: str,
) -> tuple[Policy, str]:
    """Predict the policy that attains the goal of `task`, and say in a remark what it follows from.

    `known` is the task of the session, with the candidates and rollouts that it has, oldest first.
    If the arm's model cannot follow, the goal is approached as far as it can.

    Raises:
        ValueError: No rollout without exploration tells all errors, or nothing learnt moves them.
    """
    runs = [record for record in records if record.kind != "explore" and not record.fault]
    errors = [(record, task.error(record.observation)) for record in runs]
    told = [(r, error) for r, error in errors if error is not None and np.isfinite(error).all()]
    if not told:
        raise ValueError("no rollout without exploration tells what goal it attained")
    last, _ = told[-1]
    same = [error for r, error in told if (r.demonstration, r.z) == (last.demonstration, last.z)]
    demonstrated = next(p for p in candidates if p.id == last.demonstration)
    answer, _ = known.parametrization(demonstrated).policy(np.array(last.z), policy_id)
    parametrization = task.parametrization(task.carried(answer, known.targets))
    if (rough := task.rough_errors(parametrization)) is None:
        raise ValueError(f"these settings of {task.name} learn nothing that moves its errors")
    zero = np.zeros(parametrization.size)
    corrected = sum(rough.correction(np.mean(same, axis=0), 1.0), zero)
    is_feasible = feasibility(parametrization, arm, 0, policy_id)
    z, halvings = shrink(corrected, zero, is_feasible)
    remark = f"predicted from {len(same)} rollouts of {last.id}"
    remark += f", {0.5**halvings:.2g} of the way" if halvings else ""
    return parametrization.policy(z, policy_id)[0], remark
