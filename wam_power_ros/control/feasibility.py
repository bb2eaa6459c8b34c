# SPDX-License-Identifier: Apache-2.0
"""Simulate a policy on the rigid-body model of the arm before executing it.

The controller's rollout drives the model, friction included, so that a motion limit that would end
it is found without moving the arm; whether states are plausible is no question there. Torques act
with the delay of the arm, and speeds are reported through a low-pass as drivers have: both lags can
drive a fast policy beyond a limit. A tracked body is left out: its weight is negligible.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_control import TrackingLost
from wam_power_ros.control.model_arm import ModelArm
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.policy_execution import Execution
from wam_power_ros.control.policy_preparation import prepare
from wam_power_ros.control.safety import Limits, LimitSprings, MotionCheck, limits_of
from wam_power_ros.control.servo_response import followed
from wam_power_ros.control.state_checks import JointState
from wam_power_ros.control.torque_output import TorqueOutput
from wam_power_ros.control.urdf_checks import Approach
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import EndEffectorPath, SimulatedRollout

POSITION_MARGIN = 0.05  # [rad] smallest distance from a position limit
SPEED_SHARE = 0.9  # usable share of the speed limits: the arm differs from the model
# In `simulate`, which tells how far beyond a limit a policy is, not only that it is:
FORESEEN_SHARE = 2.0  # usable share of the speed limits
FORESEEN_BEYOND = 0.5  # [rad] usable beyond the position limits
OVERRUN_SHARE = 0.98  # factor on it for each rollout in which the arm was faster than the model


@dataclass(frozen=True)
class Feasibility:
    """Result of a simulated rollout.

    Attributes:
        fault: Fault that would end the rollout, None without one. For a policy that the controller
            refuses it holds the refusal.
        qd_peak: Highest joint speeds, as reported [rad/s]. Shape (n,).
        guarded_peak: Highest speed of the guarded points, elbow and forearm [m/s].
        tool_peak: Highest speed of the tool [m/s].
        q: Joint positions in every control period of the rollout [rad]. Shape (T, n).
    """

    fault: Fault | None
    qd_peak: np.ndarray
    guarded_peak: float
    tool_peak: float
    q: np.ndarray

    def __str__(self) -> str:
        """Return one line; the arm's safety board must allow the peak speed of the elbow."""
        peaks = f"elbow at most {self.guarded_peak:.2f} m/s, tool {self.tool_peak:.2f} m/s"
        return peaks if self.fault is None else f"{peaks}; would end in a fault: {self.fault.text}"


def speed_margin(limit_stops: int) -> float:
    """Share of the speed limits that a policy may use on the model.

    Args:
        limit_stops: Number of rollouts that a motion limit ended although the model had kept it: it
            underestimates the speed, because of a payload for instance.
    """
    return SPEED_SHARE * OVERRUN_SHARE**limit_stops


def simulate_policy(
    arm: Arm,
    settings: ControllerSettings,
    policy: Policy,
    margin: float = SPEED_SHARE,
    beyond: float = 0.0,
) -> Feasibility:
    """Execute a policy on the rigid-body model, from its start until the arm has settled.

    Args:
        arm: Model of the arm; its buffers are used.
        margin: Share of the speed limits that the policy may use, see `speed_margin`.
        beyond: Distance by which every position limit is widened [rad]; the joints must stay
            `POSITION_MARGIN` within the widened ones.
    """
    limits = settings.limits or limits_of(arm)
    limited = ("qd_max", "guarded_speed", "tool_speed")
    allowed = {name: margin * getattr(limits, name) for name in limited}
    allowed |= {"q_min": limits.q_min - beyond, "q_max": limits.q_max + beyond}
    near = tuple(Approach(margin * o, margin**2 * d) for o, d in limits.approach)
    tight = replace(limits, **allowed, approach=near)
    # The whole movement must be feasible.
    settings = settings.model_copy(update={"limits": tight, "region": None})
    try:
        prepared = prepare(policy, tight, settings)
    except ControllerError as error:
        refusal = Fault(FaultKind.COMPUTATION, str(error))
        return Feasibility(refusal, np.zeros(arm.n), 0.0, 0.0, np.empty((0, arm.n)))
    execution = Execution(prepared, arm, settings)
    output = TorqueOutput(arm, tight, False, Counter())
    check, springs = MotionCheck(tight, arm.guarded, settings.period), LimitSprings(limits)
    period, period_ns = settings.period, round(settings.period * 1e9)
    start = policy.q_start
    model = ModelArm(arm, settings, start, output.send(arm.gravity(start), start, None))
    guarded_peak = tool_peak = 0.0
    positions, speeds = [], []  # of the joints
    fault: Fault | None = None
    for tick in count():
        q, seen = model.q, model.seen
        state = JointState(tick * period_ns, q, seen, period, period)
        motion = arm.motion(q, seen)
        positions.append(q)
        speeds.append(seen)
        guarded_peak = max(guarded_peak, *motion.guarded_speeds)
        tool_peak = max(tool_peak, motion.tool_speed)
        if (fault := check.fault(Mode.ROLLOUT, state, motion)) is not None:
            break
        try:
            tau = execution.torque(state, motion)
        except TrackingLost as error:
            fault = Fault(error.kind, str(error))
            break
        if tau is None:
            break
        if not math.isfinite(sum(tau.tolist())):
            fault = Fault(FaultKind.COMPUTATION, "the torque was not finite")
            break
        spring = springs.torque(q, period)
        model.advance(output.send(tau if spring is None else tau + spring, q, period))
    path = np.array(positions)
    fault = fault or _margin_fault(path.min(axis=0), path.max(axis=0), tight)
    qd_peak = np.abs(speeds).max(axis=0)
    return Feasibility(fault, qd_peak, guarded_peak, tool_peak, path[:-1])


def simulate(arm: Arm, settings: ControllerSettings, policy: Policy) -> SimulatedRollout | None:
    """Path of the tool in a simulated execution of a policy, and its excesses.

    An arm that takes positions follows with the delay and lag of its servo. None if it ends in a
    fault though the limits are so much wider.
    """
    simulated = simulate_policy(arm, settings, policy, FORESEEN_SHARE, FORESEEN_BEYOND)
    if simulated.fault is not None:
        return None
    limits = settings.limits or limits_of(arm)
    points = simulated.guarded_peak / limits.guarded_speed, simulated.tool_peak / limits.tool_speed
    q, middle = simulated.q, 0.5 * (limits.q_min + limits.q_max)
    ranges = np.abs(q - middle).max(axis=0) / (limits.q_max - middle - POSITION_MARGIN)
    speeds = np.array([*(simulated.qd_peak / limits.qd_max), *points])
    limit_excess = np.array([*ranges, *(speeds / SPEED_SHARE)]) - 1.0
    if settings.set_point_period:
        q = followed(q, settings.period, settings.servo_delay, settings.servo_lag)
    poses = [arm.tool_pose(posture) for posture in q]
    t = settings.period * np.arange(len(poses))
    position = np.stack([place for place, _ in poses])
    quat_xyzw = np.stack([rotations.quat_xyzw(matrix) for _, matrix in poses])
    path = EndEffectorPath(policy.id, t, position, quat_xyzw)
    return SimulatedRollout(path, limit_excess)


def _margin_fault(lowest: np.ndarray, highest: np.ndarray, limits: Limits) -> Fault | None:
    """Fault of the first joint that came too near to a position limit [rad], or None."""
    margins = np.minimum(lowest - limits.q_min, limits.q_max - highest)
    if not (near := np.flatnonzero(margins < POSITION_MARGIN)).size:
        return None
    i = int(near[0])
    text = f"joint {i + 1} comes within {margins[i]:.3f} rad of a limit; "
    return Fault(FaultKind.JOINT_POSITION, f"{text}{POSITION_MARGIN} must remain")
