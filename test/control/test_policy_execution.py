# SPDX-License-Identifier: Apache-2.0
"""One rollout: its end, its path, the guarded region."""

import numpy as np
import pytest
from rigid_arm import HOME, LIMITS, PERIOD_NS
from rigid_arm import MODEL as ARM

from wam_power_ros import rotations
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_control import TrackingLost
from wam_power_ros.control.policy_execution import Execution
from wam_power_ros.control.policy_preparation import prepare
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.learning.policy import Basis, Policy
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.regions import Region

SETTINGS = ControllerSettings(settle_time=0.1)
STILL = np.zeros(7)
POSITION, ROTATION = ARM.tool_pose(HOME)
REGION = Region("box", tuple(POSITION), 0.05)
POLICY = Policy(
    id="trial-0001",
    basis=Basis(4, 0.4, 0.0025),
    stiffness=np.tile(300.0 * np.eye(3), (4, 1, 1)),
    attractors=np.tile(POSITION, (4, 1)),
    damping=32.0,
    orientation_reference=rotations.quat_xyzw(ROTATION),
    rotation_attractors=np.zeros((4, 3)),
    rotation_stiffness=400.0,
    rotation_damping=36.0,
    q_start=HOME,
)
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


@pytest.mark.parametrize(
    ("outside", "inside", "path"),
    [
        ((0, 1, 2, 3, 4, 5, 6), 7, [0.0, 0.01, 0.014]),
        ((0,), 0.4, [0.0]),  # still the tick of a sample
        ((0, 5, 10), 10.4, [0.0, 0.01, 0.02]),
    ],
)
def test_the_tool_in_the_region_ends_the_rollout_with_a_sample_of_that_state(
    outside: tuple[int, ...], inside: float, path: list[float]
) -> None:
    rollout = execution(settings=SETTINGS.model_copy(update={"region": REGION}))
    for tick in outside:
        assert answer(rollout, tick, HOME + 0.2 * np.eye(7)[0]) is not None
    assert answer(rollout, inside) is None
    assert not rollout.complete and rollout.stopped_in == REGION.name
    found = path_of(rollout)
    np.testing.assert_allclose(found.t, path, atol=1e-12)
    if inside == 7:
        np.testing.assert_allclose(found.position[-1], POSITION)


def test_the_path_is_that_of_the_first_end() -> None:
    rollout = execution()
    assert rollout.under_way and rollout.take_path() is None
    answer(rollout, 0)
    path_of(rollout)
    rollout.end(JointState(START_NS, HOME + 0.1, STILL, 0.002, 0.002))
    assert not rollout.under_way and rollout.take_path() is None


def test_a_tool_that_is_rotated_too_far_loses_tracking() -> None:
    rollout, turned = execution(), HOME.copy()
    turned[6] += 1.99
    assert answer(rollout, 0, turned) is not None
    turned[6] += 0.02
    with pytest.raises(TrackingLost, match="rotated by"):
        answer(rollout, 1, turned)


def test_a_loop_slower_than_the_path_samples_every_tick() -> None:
    rollout = execution(settings=SETTINGS.model_copy(update={"period": 0.02}))
    for tick in range(0, 250, 10):
        answer(rollout, tick)
    np.testing.assert_allclose(path_of(rollout).t, np.arange(25) * 0.02)
