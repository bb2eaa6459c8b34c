# SPDX-License-Identifier: Apache-2.0
"""One rollout: its end, its path, the guarded region."""

from dataclasses import replace

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, PERIOD_NS, make_policy
from rigid_arm import MODEL as ARM

from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_control import TrackingLost
from wam_power_ros.control.policy_execution import Execution
from wam_power_ros.control.policy_preparation import prepare
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.learning.policy import Basis, Policy
from wam_power_ros.learning.rollout import EndEffectorPath

SETTINGS = ControllerSettings(settle_time=0.1)
STILL = np.zeros(7)
POSITION = ARM.tool_pose(HOME)[0]
POLICY = replace(make_policy(size=0.0), basis=Basis(8, 0.4, 0.0025))  # stays where it is
START_NS = 10**12


def execution(policy: Policy = POLICY, settings: ControllerSettings = SETTINGS) -> Execution:
    return Execution(prepare(policy, LIMITS, settings), ARM, settings)


def answer(rollout: Execution, tick: float, q: np.ndarray = HOME) -> np.ndarray | None:
    stamp_ns = START_NS + round(tick * PERIOD_NS)
    return rollout.torque(JointState(stamp_ns, q, STILL, 0.002, 0.002), ARM.motion(q, STILL))


def path_of(rollout: Execution, q: np.ndarray = HOME) -> EndEffectorPath:
    rollout.end(JointState(START_NS, q, STILL, 0.002, 0.002))
    path = rollout.take_path()
    assert path is not None and rollout.take_path() is None
    return path


def test_a_rollout_includes_the_settling_time_and_is_sampled_at_100_hz() -> None:
    rollout = execution()
    assert rollout.start_ns is None
    for tick in range(251):
        assert answer(rollout, tick) is not None and not rollout.complete
    assert answer(rollout, 251) is None and rollout.complete
    path = path_of(rollout)
    assert (path.id, rollout.start_ns) == ("trial-0001", START_NS)
    np.testing.assert_allclose(path.t, np.arange(51) * 0.01, atol=1e-12)


def test_a_gap_in_the_states_is_a_gap_in_the_path_and_does_not_stop_time() -> None:
    rollout = execution()
    for tick in (0, 1, 2, 40, 41, 240):
        np.testing.assert_allclose(answer(rollout, tick), ARM.gravity(HOME), atol=1e-9)
    assert answer(rollout, 300) is None and rollout.complete
    np.testing.assert_allclose(path_of(rollout).t, [0.0, 0.08, 0.48])


def test_stamps_with_jitter_count_as_the_nearest_tick_and_no_sample_comes_twice() -> None:
    rollout = execution()
    for tick in (0.0, 0.4, 1.1, 4.9, 5.3, 5.4, 9.6):
        answer(rollout, tick)
    np.testing.assert_allclose(path_of(rollout).t, [0.0, 0.01, 0.02])


def test_a_tool_that_is_rotated_too_far_loses_tracking() -> None:
    rollout, turned = execution(), HOME.copy()
    turned[6] += 1.99
    assert answer(rollout, 0, turned) is not None
    turned[6] += 0.02
    with pytest.raises(TrackingLost, match="rotated by"):
        answer(rollout, 1, turned)
