# SPDX-License-Identifier: Apache-2.0
"""The loaded policy and its rollouts."""

import dataclasses

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, MODEL, PERIOD_NS, POLICY

from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.modes import ControllerError, Refusal
from wam_power_ros.control.policy_execution import Rollouts
from wam_power_ros.control.prepared_policy import prepare
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.learning.policy import with_id
from wam_power_ros.regions import Region

SETTINGS = ControllerSettings(hold_to_run=True, settle_time=0.1)
STILL = np.zeros(7)
MOTION = MODEL.motion(HOME, STILL)


def rollouts(settings: ControllerSettings = SETTINGS) -> Rollouts:
    found = Rollouts(MODEL, settings)
    found.policy = prepare(POLICY, MODEL.n, LIMITS, settings)
    return found


def state(tick: int) -> JointState:
    return JointState(10**12 + tick * PERIOD_NS, HOME, STILL, 0.002, 0.002)


def run(them: Rollouts, ticks: int) -> int:
    """Number of states, up to `ticks`, that got a torque before the rollout was over."""
    them.begin()
    for tick in range(ticks):
        if them.torque(state(tick), MOTION) is None:
            return tick
    return ticks


def test_nothing_can_begin_without_a_policy() -> None:
    them = Rollouts(MODEL, SETTINGS)
    for request in (them.begin, lambda: them.require_start(HOME)):
        with pytest.raises(ControllerError, match="no policy is loaded") as refused:
            request()
        assert refused.value.refusal is Refusal.NOTHING
    assert not them.completed_before and them.active_id is None


def test_a_rollout_begins_only_at_the_start_of_its_policy() -> None:
    them = rollouts()
    near = HOME.copy()
    near[3] += 0.9 * SETTINGS.start_tolerance
    them.require_start(near)
    near[3] = HOME[3] - 1.1 * SETTINGS.start_tolerance
    with pytest.raises(ControllerError, match=r"wam_j4 is 0\.055 rad from the start") as refused:
        them.require_start(near)
    assert refused.value.refusal is Refusal.NOT_AT_START
    assert refused.value.values == {"policy": POLICY.id}


def test_a_policy_counts_as_completed_only_after_a_whole_rollout_whatever_its_id() -> None:
    them = rollouts()
    run(them, 100)
    them.end(state(100))
    assert not them.completed_before
    assert run(them, 1000) < 1000
    them.end(state(1000))
    assert them.completed_before
    same = with_id(POLICY, "another-id")
    them.policy = prepare(same, MODEL.n, LIMITS, SETTINGS)
    assert them.completed_before
    other = dataclasses.replace(same, damping=POLICY.damping + 1.0)
    them.policy = prepare(other, MODEL.n, LIMITS, SETTINGS)
    assert not them.completed_before


def test_a_rollout_that_ends_in_a_region_does_not_count_as_completed() -> None:
    region = Region("box", tuple(MOTION.position), 0.01)
    them = rollouts(SETTINGS.model_copy(update={"region": region}))
    assert run(them, 1000) == 0 and them.stopped_in == ""
    them.end(state(0))
    assert not them.completed_before and them.stopped_in == "box"
    them.begin()
    them.end(state(0))
    assert them.stopped_in == ""  # of the last one


def test_a_path_is_returned_once_and_dropped_when_the_next_rollout_begins() -> None:
    them = rollouts()
    run(them, 100)
    assert them.active_id == POLICY.id and them.take_path() is None
    them.end(state(100))
    assert them.active_id is None and them.start_ns == 10**12
    path = them.take_path()
    assert path is not None and path.id == POLICY.id and them.take_path() is None
    run(them, 100)
    them.end(state(100))
    them.begin()
    assert them.take_path() is None and them.start_ns is None


def test_the_end_of_a_rollout_without_a_state_or_without_a_rollout_leaves_no_path() -> None:
    them = rollouts()
    them.end(state(0))
    assert them.take_path() is None
    them.begin()
    them.end(None)
    assert them.take_path() is None and them.active_id is None
