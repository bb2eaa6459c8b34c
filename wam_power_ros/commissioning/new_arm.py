# SPDX-License-Identifier: Apache-2.0
"""A first set-up of an arm from its URDF alone: each value with the reason for it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.inverse_kinematics import damped_step
from wam_power_ros.control.urdf_checks import parsed

MOVABLE = ("revolute", "prismatic", "continuous")
MARGIN = 0.15  # [rad] from the limits of the joints
TRIES = 60  # postures from which a home is sought
SHARE = 0.18  # radius of the obstacle over the way, see config/reach.yaml
ARC = np.array([0.0, 0.0, 0.06])  # [m] of a demonstrated reach


class Proposal(NamedTuple):
    """A value of a parameter of a node, and the reason for it."""

    node: str
    name: str
    value: Any
    reason: str


def limits_of_turning(tree: Element, names: list[str]) -> list[float]:
    """Position limits for a set-up: a turn less `MARGIN` of continuous joints [rad]; else none."""
    kinds = {joint.get("name"): joint.get("type") for joint in tree.iterfind("joint")}
    most = round(np.pi - MARGIN, 2)
    limits = [(-most, most) if kinds[name] == "continuous" else (0.0, 0.0) for name in names]
    return [end for each in limits for end in each] if np.any(limits) else []


def chain(tree: Element, tool: str = "") -> tuple[list[str], list[str], str]:
    """Joints base to tip, links base to tip and the tool of a URDF.

    The tool is the link that is moved by the most joints, of these by the fewest slides, farthest
    out.

    Raises:
        ValueError: There is no such link, or no joint moves it.
    """
    above = {each.find("child").get("link"): each for each in tree.iterfind("joint")}  # type: ignore[union-attr]

    def path(link: str) -> list[Element]:
        joints: list[Element] = []
        while link in above and len(joints) < len(above):
            joints.insert(0, joint := above[link])
            link = joint.find("parent").get("link")  # type: ignore[union-attr, assignment]
        return joints

    def rank(link: str) -> tuple[int, int, int]:
        kinds = [joint.get("type") for joint in path(link)]
        turning = kinds.count("revolute") + kinds.count("continuous")
        return turning, -kinds.count("prismatic"), len(kinds)

    links = [str(each.get("name")) for each in tree.iterfind("link")]
    if tool and tool not in links:
        raise ValueError(f"no link {tool!r} in the robot description; known: {links}")
    tool = tool or max(links, key=rank, default="")
    joints = path(tool)
    moving = [joint for joint in joints if joint.get("type") in MOVABLE]
    if not moving:
        raise ValueError(f"no joint moves the link {tool!r}: is this the description of an arm?")
    root = joints[0].find("parent").get("link")  # type: ignore[union-attr]
    moved = [str(joint.find("child").get("link")) for joint in moving]  # type: ignore[union-attr]
    return [str(joint.get("name")) for joint in moving], [str(root), *moved], tool


def solved(
    arm: Arm, q: np.ndarray, position: np.ndarray, rotation: np.ndarray | None = None
) -> np.ndarray | None:
    """Posture with the tool at a position (3,) [m], level or with a rotation (3, 3); else None."""
    low, high = arm.q_min + MARGIN, arm.q_max - MARGIN
    for _ in range(80):
        now, turned = arm.tool_pose(q)
        axes = np.cross(turned[:, 2], [0.0, 0.0, 1.0])
        if rotation is not None:
            axes = 0.5 * np.cross(turned.T, rotation.T).sum(axis=0)
        error = np.concatenate([position - now, axes])
        if np.abs(error).max() < 1e-3 and (rotation is not None or turned[2, 2] > 0.999):
            return q
        q = np.clip(q + 0.5 * damped_step(arm.jacobian(q), error), low, high)
    return None


def reach_of(arm: Arm, rng: np.random.Generator) -> tuple[np.ndarray, float, float, np.ndarray]:
    """Home (n,) [rad], reach and way to the goal [m], and goal (3,) [m].

    Raises:
        ValueError: No posture with a level tool, from which a straight reach is possible, was
            found within the limits.
    """
    low, high = arm.q_min + MARGIN, arm.q_max - MARGIN
    random = rng.uniform(low, high, (TRIES * 20, arm.n))
    tools = np.array([arm.tool_pose(q)[0] for q in random])
    reach = float(np.linalg.norm(tools[:, :2], axis=1).max())
    best: tuple[float, np.ndarray, float, np.ndarray] | None = None
    for q in random[:TRIES]:
        far, side = rng.uniform(0.45, 0.75) * reach, rng.uniform(0.15, 0.35) * reach
        start = np.array([far, -side, rng.uniform(0.2, 0.7) * reach])
        if (home := solved(arm, q, start)) is None:
            continue
        rotation = arm.tool_pose(home)[1]
        postures = [home]
        for share in np.linspace(0.1, 1.0, 10):
            place = start + share * np.array([0.0, 2.0 * side, 0.0]) + np.sin(np.pi * share) * ARC
            if (found := solved(arm, postures[-1], place, rotation)) is None:
                break
            postures.append(found)
        room = min(float(np.minimum(q - low, high - q).min()) for q in postures)
        if len(postures) == 11 and (best is None or room > best[0]):
            best = room, home, 2.0 * side, start + np.array([0.0, 2.0 * side, 0.0])
    if best is None:
        raise ValueError(
            "no posture with a level tool (z up) and a reach to its left was found: is z the axis "
            "out of the tool? Give a link that is, with --tool, or home and goal by hand"
        )
    return best[1], reach, best[2], best[3]


def proposals(urdf: str, file: str, tool: str, output: str) -> Iterator[Proposal]:
    """Values of a set-up, in the order of its file.

    Raises:
        ValueError: The URDF is none of an arm that can be used, as `Arm` says.
    """
    names, links, tool = chain(tree := parsed(urdf), tool)
    limits = limits_of_turning(tree, names)
    arm = Arm(urdf, names, tool, (), position_limits=limits)
    home, reach, way, goal = reach_of(arm, np.random.default_rng(0))
    start = arm.tool_pose(home)[0]
    elbow, wrist = links[(len(names) + 1) // 2], links[max(len(names) - 2, 1)]
    node = "torque_controller"
    reason = "all that move the tool, base to tip; those of the driver, if it names them otherwise"
    yield Proposal(node, "joint_names", names, reason)
    yield Proposal(node, "model_joint_names", names, "the same in the URDF")
    yield Proposal(node, "urdf", file, "as given")
    yield Proposal(node, "base_frame", links[0], "root of the URDF")
    yield Proposal(node, "tool_frame", tool, f"moved by all {len(names)} joints, farthest out")
    if limits:
        reason = "[rad] of continuous joints, short of a jump by 2 pi; 0, 0: those of the URDF"
        yield Proposal(node, "position_limits", limits, reason)
    yield Proposal(node, "guarded_names", ["elbow", "wrist"], "their speed is limited, too")
    yield Proposal(node, "guarded_links", [elbow, wrist], "half-way, and before the hand")
    yield Proposal(node, "guarded_points", [0.0] * 6, "[m] at their joints")
    box = round(1.2 * reach, 2)
    yield Proposal(node, "workspace_min", [-box, -box, 0.0], "[m] 1.2 times its reach, above floor")
    yield Proposal(node, "workspace_max", [box, box, 2.0 * box], "[m]")
    yield Proposal(node, "plane", [0.0, 0.0, 1.0, 0.0], "it stands on a table at the height of 0")
    yield Proposal(node, "torque_share", 0.5, "of the URDF's limits, for the first runs")
    yield Proposal(node, "guarded_speed_max", 1.0, "[m/s] for the first runs")
    yield Proposal(node, "idle_service", "", "none is known")
    yield Proposal(node, "output", output, "what the driver takes")
    middle = [*((start + goal) / 2.0 + ARC).round(3).tolist(), round(SHARE * way, 3)]
    yield Proposal(node, "guarded_region", middle, "[m] obstacle of task reach, half-way")
    yield Proposal("wam_sim", "drives", "direct", "one motor a joint, limits of the URDF")
    yield Proposal("wam_sim", "home", home.round(3).tolist(), "[rad] tool level, limits far")
    yield Proposal("wam_sim", "goal", goal.round(3).tolist(), "[m] as far to the left as the home")


def text(values: list[Proposal]) -> str:
    """The set-up as a file."""
    lines = ["# Proposed from the URDF alone: check each line, above all limits, plane and home."]
    for node in dict.fromkeys(each.node for each in values):
        lines += [f"/**/{node}:", "  ros__parameters:"]
        for _, name, value, reason in (each for each in values if each.node == node):
            lines.append(f"    {name}: {json.dumps(value)}  # {reason}")
    return "\n".join(lines) + "\n"
