# SPDX-License-Identifier: Apache-2.0
"""Policies that are fitted to demonstrations."""

from __future__ import annotations

import pytest
from reach_task import START
from toss_task import ANY_ARM, AnyArm

from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.learning.demonstration import Demonstration, from_positions
from wam_power_ros.practice.candidates import fitted
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.rated import Rated
from wam_power_ros.tasks.reach.task import Reach
from wam_power_ros.tasks.task import Task

ARM = ArmIdentity("wam", ("j1",), "0" * 64, "1" * 64)


def shown(far: float) -> Demonstration:
    t = [k / 299 for k in range(300)]
    s = [u**3 * (10.0 - 15.0 * u + 6.0 * u**2) for u in t]
    return from_positions(START + [[0.0, far * u, 0.0] for u in s], 0.004)


SHOWN = {1: shown(0.4), 3: shown(0.5)}  # the second recording was refused


@pytest.mark.parametrize(("kind", "groups"), [(Rated, [(1,), (3,)]), (Reach, [(1, 3)])])
def test_each_demonstration_has_a_policy_unless_the_task_fits_one_to_all(
    kind: type[Task], groups: list[tuple[int, ...]]
) -> None:
    policies, refused = fitted(kind, preset(kind.name), SHOWN, ANY_ARM, ARM, None)
    assert list(policies) == groups
    assert refused == {}
    assert [policy.id for policy in policies.values()] == [f"demonstration-{g[0]}" for g in groups]
    assert {policy.arm for policy in policies.values()} == {ARM}


def test_a_policy_that_would_end_in_a_fault_is_none_and_the_others_stay() -> None:
    arm = AnyArm(lambda policy: "too fast" if policy.id == "demonstration-1" else "")
    policies, refused = fitted(Rated, preset("rated"), SHOWN, arm, ARM, None)
    assert list(policies) == [(3,)]
    assert refused == {(1,): "would end in a fault: too fast"}
