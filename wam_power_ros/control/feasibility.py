# SPDX-License-Identifier: Apache-2.0
"""Simulate a policy on the rigid-body model of the arm before executing it.

The controller drives the model, friction included, so that a motion limit that would end the
rollout is found without moving the arm. Torques act with the delay of the arm, because the delay
can drive a fast policy beyond a limit. A tracked body is left out: its weight is negligible.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.estimate import TORQUE_DELAY
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.safety import Limits, limits_of
from wam_power_ros.control.state_checks import at_rate
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import EndEffectorPath, Foreseen

_REST_TICKS = 60  # periods at rest, at 500 Hz, until the controller reaches its fixed point
_STEP = 0.001  # [s] of the integration of the model
POSITION_MARGIN = 0.05  # [rad] smallest distance from a position limit
SPEED_SHARE = 0.9  # usable share of the speed limits: the arm differs from the model
FORESEEN_SHARE = 2.0  # in `foresee`: how far beyond a limit a policy is, not only that it is
OVERRUN_SHARE = 0.98  # factor on it for each rollout in which the arm was faster than the model
_FILTER_STATES = 2  # by which the filter of the velocities adds to a measured delay
_FRICTION_SPEED = 0.01  # [rad/s] below it Coulomb friction falls to zero with the speed


@dataclass(frozen=True)
class Feasibility:
    """Result of a simulated rollout.

    Attributes:
        fault: Fault that would end the rollout, None without one. For a policy that the controller
            refuses it holds the refusal.
        qd_peak: Highest joint speeds [rad/s]. Shape (n,).
        elbow_peak: Highest speed of the guarded points, elbow and forearm [m/s].
        tool_peak: Highest speed of the tool [m/s].
        q: Joint positions in every control period of the rollout [rad]. Shape (T, n).
    """

    fault: Fault | None
    qd_peak: np.ndarray
    elbow_peak: float
    tool_peak: float
    q: np.ndarray

    def __str__(self) -> str:
        """Return one line; the arm's safety board must allow the peak speed of the elbow."""
        peaks = f"elbow at most {self.elbow_peak:.2f} m/s, tool {self.tool_peak:.2f} m/s"
        return peaks if self.fault is None else f"{peaks}; would end in a fault: {self.fault.text}"


def speed_margin(overruns: int) -> float:
    """Share of the speed limits that a policy may use on the model.

    Args:
        overruns: Number of rollouts that a motion limit ended although the model had kept it: the
            model underestimates the speed, because of a payload for instance.
    """
    return SPEED_SHARE * OVERRUN_SHARE**overruns


def simulate_policy(
    arm: Arm, settings: ControllerSettings, policy: Policy, margin: float = SPEED_SHARE
) -> Feasibility:
    """Execute a policy on the rigid-body model, from its start until the arm has settled.

    Args:
        arm: Model of the arm; its buffers are used.
        settings: Settings of the controller.
        policy: Policy to simulate.
        margin: Share of the speed limits that the policy may use, see `speed_margin`. It must stay
            `POSITION_MARGIN` within the position limits.
    """
    limits = settings.limits or limits_of(arm)
    speeds = ("qd_max", "elbow_speed", "tool_speed")
    tight = replace(limits, **{name: margin * getattr(limits, name) for name in speeds})
    model = {"limits": tight, "driver_compensates_gravity": False, "hold_to_run": False}
    whole = {"region": None}  # the whole movement must be feasible
    controller = Controller(arm, settings.model_copy(update=model | whole))
    period_ns = round(settings.period * 1e9)
    substeps = max(1, round(settings.period / _STEP))
    dt = settings.period / substeps
    q, qd, stamp_ns = policy.q_start.copy(), np.zeros(arm.n), period_ns

    def rest() -> np.ndarray:
        """Step the controller with the arm at rest; returns the torque."""
        nonlocal stamp_ns
        tau = controller.step(stamp_ns, q, qd)
        stamp_ns += period_ns
        return tau

    rest()
    controller.hold()
    try:
        controller.load(policy)
        controller.move_to_start()
    except ControllerError as error:
        refusal = Fault(FaultKind.COMPUTATION, str(error))
        return Feasibility(refusal, np.zeros(arm.n), 0.0, 0.0, np.empty((0, arm.n)))
    while not controller.ready:
        rest()
    rests, delay = (at_rate(count, settings.period) for count in (_REST_TICKS, TORQUE_DELAY))
    if settings.loop_delay:
        delay = round(settings.loop_delay / settings.period) + _FILTER_STATES
    # What the motors of this arm give for the torques that they are sent.
    scales = 1.0 if arm.torque_scales is None else arm.torque_scales
    acting = deque((scales * rest() for _ in range(rests)), maxlen=delay + 1)
    controller.execute()
    qd_peak, elbow_peak, tool_peak = np.zeros(arm.n), 0.0, 0.0
    lowest, highest, path = q, q, []
    change = np.zeros(arm.n)  # of the speeds in the last step, expected again in the next
    while True:
        tau = controller.step(stamp_ns, q, qd)
        if controller.mode is not Mode.ROLLOUT:
            break
        acting.append(scales * tau)
        path.append(q)
        for _ in range(substeps):
            # Implicit: explicit friction would shake joints of less than 0.0015 kg m^2.
            speed = np.maximum(np.abs(qd + change), _FRICTION_SPEED)
            resistance = arm.friction / speed + arm.damping
            change = dt * arm.resisted_dynamics(q, qd, acting[0], resistance, dt)
            qd = qd + change
            q = q + dt * qd
        stamp_ns += period_ns
        lowest, highest = np.minimum(lowest, q), np.maximum(highest, q)
        guarded, tool = arm.speeds(q, qd)
        np.maximum(qd_peak, np.abs(qd), out=qd_peak)
        elbow_peak, tool_peak = max(elbow_peak, *guarded), max(tool_peak, tool)
    fault = controller.latched or _margin_fault(lowest, highest, limits)
    return Feasibility(fault, qd_peak, elbow_peak, tool_peak, np.array(path))


def foresee(arm: Arm, settings: ControllerSettings, policy: Policy) -> Foreseen | None:
    """Path of the tool in a simulated execution of a policy, and its excesses of speed.

    None if it ends in a fault though the speed limits are `FORESEEN_SHARE` of the real ones.
    """
    simulated = simulate_policy(arm, settings, policy, FORESEEN_SHARE)
    if simulated.fault is not None:
        return None
    limits = settings.limits or limits_of(arm)
    points = simulated.elbow_peak / limits.elbow_speed, simulated.tool_peak / limits.tool_speed
    shares = np.array([*(simulated.qd_peak / limits.qd_max), *points])
    poses = [arm.tool_pose(q) for q in simulated.q]
    t = settings.period * np.arange(len(poses))
    position = np.stack([place for place, _ in poses])
    quat_xyzw = np.stack([rotations.quat_xyzw(matrix) for _, matrix in poses])
    path = EndEffectorPath(policy.id, t, position, quat_xyzw)
    return Foreseen(path, shares / SPEED_SHARE - 1.0)


def _margin_fault(lowest: np.ndarray, highest: np.ndarray, limits: Limits) -> Fault | None:
    """Fault of the first joint that came too near to a position limit [rad], or None."""
    margins = np.minimum(lowest - limits.q_min, limits.q_max - highest)
    if not (near := np.flatnonzero(margins < POSITION_MARGIN)).size:
        return None
    i = int(near[0])
    text = f"joint {i + 1} comes within {margins[i]:.3f} rad of a limit; "
    return Fault(FaultKind.JOINT_POSITION, f"{text}{POSITION_MARGIN} must remain")
