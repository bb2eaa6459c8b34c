# SPDX-License-Identifier: Apache-2.0
"""Simulate a policy on the rigid-body model of the arm before executing it.

The controller drives the model with its friction: a motion limit that would end the rollout is
found out without moving. Its torques act as late as those of the arm do, for what a delay does to a
fast policy is a limit of motion, too. A tracked body is left out: its weight is nothing to the arm.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.estimate import TORQUE_DELAY
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.safety import Limits, limits_of
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import Fault, FaultKind

_STILL_TICKS = 60  # control periods at rest, in which a controller comes to its fixed point
_SUBSTEPS = 2  # of the model in a control period
POSITION_MARGIN = 0.05  # [rad] to a limit of position
SPEED_SHARE = 0.9  # of the limits of speed: the arm is not the model
OVERRUN_SHARE = 0.98  # of that, for each time that the arm was faster than the model
_STICTION_SPEED = 0.01  # [rad/s] below it friction is not yet all there


@dataclass(frozen=True)
class Feasibility:
    """Result of a simulated rollout.

    Attributes:
        fault: Fault that would end the rollout, None without. Of a policy that the controller
            refuses it is the refusal: no torque is computed for it.
        qd_peak: Highest joint speeds [rad/s]. Shape (n,).
        elbow_peak: Highest speed of the guarded points, elbow and forearm [m/s].
        tool_peak: Highest speed of the tool [m/s].
    """

    fault: Fault | None
    qd_peak: np.ndarray
    elbow_peak: float
    tool_peak: float

    def __str__(self) -> str:
        """One line; the elbow's peak is what the arm's safety board must allow."""
        peaks = f"elbow at most {self.elbow_peak:.2f} m/s, tool {self.tool_peak:.2f} m/s"
        return peaks if self.fault is None else f"{peaks}; would end in a fault: {self.fault.text}"


def speed_margin(overruns: int) -> float:
    """Share of the speed limits that a policy may use on the model.

    Args:
        overruns: Number of rollouts that a limit of motion ended though the model had kept it: it
            has the arm too slow, because of a payload for instance.
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
        margin: Share of the speed limits that the policy may use, see `speed_margin`. From the
            limits of position it must keep `POSITION_MARGIN`.
    """
    limits = settings.limits or limits_of(arm)
    speeds = ("qd_max", "elbow_speed", "tool_speed")
    tight = replace(limits, **{name: margin * getattr(limits, name) for name in speeds})
    model_settings = replace(
        settings,
        limits=tight,
        driver_compensates_gravity=False,
        hold_to_run=False,
        obstacle=(0.0, 0.0, 0.0, 0.0),  # the whole movement must be feasible
    )
    controller = Controller(arm, model_settings)
    period_ns = round(settings.period * 1e9)
    dt = settings.period / _SUBSTEPS
    q, qd, stamp_ns = policy.q_start.copy(), np.zeros(arm.n), period_ns

    def rest() -> np.ndarray:
        """Torque that answers one state of the arm at rest."""
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
        fault = Fault(FaultKind.COMPUTATION, str(error))
        return Feasibility(fault, np.zeros(arm.n), 0.0, 0.0)
    while not controller.ready:
        rest()
    sent = deque((rest() for _ in range(_STILL_TICKS)), maxlen=TORQUE_DELAY + 1)
    controller.execute()
    qd_peak, elbow_peak, tool_peak = np.zeros(arm.n), 0.0, 0.0
    lowest, highest = q, q
    while True:
        tau = controller.step(stamp_ns, q, qd)
        if controller.mode is not Mode.ROLLOUT:
            break
        sent.append(tau)
        for _ in range(_SUBSTEPS):
            friction = arm.friction * np.tanh(qd / _STICTION_SPEED) + arm.damping * qd
            qd = qd + dt * arm.forward_dynamics(q, qd, sent[0] - friction)
            q = q + dt * qd
        stamp_ns += period_ns
        lowest, highest = np.minimum(lowest, q), np.maximum(highest, q)
        guarded, tool = arm.speeds(q, qd)
        np.maximum(qd_peak, np.abs(qd), out=qd_peak)
        elbow_peak, tool_peak = max(elbow_peak, *guarded), max(tool_peak, tool)
    latched = controller.latched
    if latched is None:
        latched = _too_near(lowest, highest, limits)
    return Feasibility(latched, qd_peak, elbow_peak, tool_peak)


def _too_near(lowest: np.ndarray, highest: np.ndarray, limits: Limits) -> Fault | None:
    """Fault of the first joint that came nearer to a limit than it may [rad]; None without."""
    room = np.minimum(lowest - limits.q_min, limits.q_max - highest)
    if not (near := np.flatnonzero(room < POSITION_MARGIN)).size:
        return None
    i = int(near[0])
    text = f"joint {i + 1} comes within {room[i]:.3f} rad of a limit; {POSITION_MARGIN} must remain"
    return Fault(FaultKind.JOINT_POSITION, text)
