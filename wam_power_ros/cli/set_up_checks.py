# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a set-up although each of its values would be accepted on its own."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np

from wam_power_ros import installed
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.feasibility import POSITION_MARGIN
from wam_power_ros.control.inverse_kinematics import damped_step
from wam_power_ros.params import overlay

GOAL_DISTANCE_MAX = 0.01  # [m] from the goal
ITERATIONS, DAMPING = 200, 0.01  # of the inverse kinematics


def mistakes(setup: overlay.Setup) -> Iterator[str]:
    """Sentences about a set-up, each with the parameter, its value and what is allowed."""
    simulated, controller = setup["wam_sim"], setup["torque_controller"]
    try:
        installed.task_type(setup["learner"]["task"])
    except ValueError as error:
        yield f"task of learner: {error}"
    scene, has_goal = simulated["scene"], False
    if scene not in installed.names("scene"):
        yield f"scene = {scene!r} of wam_sim is not one of {', '.join(installed.names('scene'))}"
    else:
        with contextlib.suppress(ValueError):  # without MuJoCo, on an arm
            has_goal = installed.find("scene", scene).has_goal
    try:
        arm = setup.arm()
    except ValueError as error:
        yield str(error)
        return
    if arm is None:
        return
    if simulated["drives"] == "wam":  # it begins where its scene says
        return
    home, names = np.array(simulated["home"], dtype=float), arm.joint_names
    if home.shape != (arm.n,):
        yield f"home = {home.tolist()} of wam_sim must be {arm.n} angles, one for each of {names}"
        return
    low, high = arm.q_min + POSITION_MARGIN, arm.q_max - POSITION_MARGIN
    for name, angle, least, most in zip(names, home, low, high, strict=True):
        if not least <= angle <= most:
            yield f"home of wam_sim: {name} = {angle:g} must be from {least:.2f} to {most:.2f} rad"
    places = {"the tool at home": arm.tool_pose(home)[0]}
    if has_goal:
        places["goal of wam_sim"] = goal = np.array(simulated["goal"], dtype=float)
        if (left := _distance(arm, home, goal)) > GOAL_DISTANCE_MAX:
            yield f"goal = {goal.tolist()} of wam_sim is {left:.2f} m beyond the reach of the tool"
    *normal, distance = controller["plane"]
    box = controller["workspace_min"], controller["workspace_max"]
    for what, place in places.items():
        shown = f"{what}, {place.round(3).tolist()} m,"
        if np.any(place < box[0]) or np.any(place > box[1]):
            yield f"{shown} is outside workspace_min {box[0]} to workspace_max {box[1]}"
        if place @ normal < distance:
            yield f"{shown} is behind plane = {controller['plane']}"


def _distance(arm: Arm, q: np.ndarray, goal: np.ndarray) -> float:
    """Distance [m] to which the tool comes to a goal (3,) [m], from a posture (n,) [rad]."""
    nearest = np.inf
    for _ in range(ITERATIONS):
        error = goal - arm.tool_pose(q)[0]
        nearest = min(nearest, float(np.linalg.norm(error)))
        step = damped_step(arm.jacobian(q)[:3], error, DAMPING)
        q = np.clip(q + 0.5 * step, arm.q_min, arm.q_max)
    return nearest
