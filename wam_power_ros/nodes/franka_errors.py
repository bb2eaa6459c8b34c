# SPDX-License-Identifier: Apache-2.0
"""Errors of libfranka in words: what the robot stopped for, and what clears it."""

from __future__ import annotations

REMEDIES = {  # by a part of the name, the first that fits
    "motion_generator": "of a motion that the robot generates, and nothing here asks for: look in "
    "Desk who else is connected, then reset",
    "communication_constraints": "20 torques in a row came late: no other load on this machine, "
    "real-time priority, a cable without a switch; then reset",
    "torque_discontinuity": "a step of more than 1 N m in 1 ms reached the robot, of torques that "
    "were lost on the way; look for lost packets, then reset",
    "cartesian_reflex": "the tool touched something, or its mass in Desk is wrong; free it, reset",
    "joint_reflex": "a joint touched something, or its load in Desk is wrong; free it, then reset",
    "self_collision": "guide the arm apart with the robot's own button, then reset",
    "position_limits": "guide the arm back with the robot's own button, then reset",
    "velocity": "the arm was faster than the robot allows in this posture; slower, then reset",
    "tau_j_range": "a torque beyond the robot's sensors; lighter or slower, then reset",
    "power_limit": "too much power; slower, then reset",
    "force_control": "force at the tool beyond the robot's limit; free it, then reset",
    "instability": "the loop oscillated: a wrong URDF or payload, or too much delay; then reset",
    "base_acceleration": "the robot's base moved, or its sensor failed; look in Desk, restart",
}
OTHER = "look it up in libfranka's franka::Errors and in Desk, then reset"
MODES = {
    "UserStopped": "the enabling device or the emergency stop is pressed: release it",
    "Guiding": "a person guides the arm by the robot's own button: let go",
    "Other": "joints are locked or FCI is off: unlock and activate both in Desk",
}


def described(errors: object, mode: str) -> str:
    """What stopped a robot, in a mode, and what clears it; attributes that are true name errors."""
    if mode in MODES:
        return f"{mode}: {MODES[mode]}, then reset"
    names = [name for name in dir(errors) if name[0] != "_" and getattr(errors, name) is True]
    texts = [f"{n}: {next((REMEDIES[p] for p in REMEDIES if p in n), OTHER)}" for n in names]
    return "; ".join(texts) or f"the robot ended control without an error, in mode {mode}: reset"
