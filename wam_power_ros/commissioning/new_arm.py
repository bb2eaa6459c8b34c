# SPDX-License-Identifier: Apache-2.0
"""A first set-up of an arm from its URDF alone: each value with the reason for it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from wam_power_ros.control.arm import Arm, GuardedPoint
from wam_power_ros.control.inverse_kinematics import damped_step
from wam_power_ros.control.urdf_checks import parsed

MOVABLE = ("revolute", "prismatic", "continuous")
GRIPPER = re.compile("grip|finger|jaw", re.IGNORECASE)  # in the name of a joint that is no arm's
MARGIN = 0.15  # [rad] from the limits of the joints
TRIES = 100  # postures from which a home is sought
SHARE = 0.18  # radius of the obstacle over the way, see config/reach.yaml
ARC = np.array([0.0, 0.0, 0.06])  # [m] of a demonstrated reach
SPEED_SHARE = 0.4  # of the speed limits: a reproduction is up to twice as fast as planned
TABLE = 0.05  # [m] least height of tool and guarded points
DURATION, STEPS = 2.0, 10  # [s] of a demonstrated reach; in which it is tried


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

    The tool is the link that is moved by no joint of a gripper and else by the most joints, of
    these by the fewest slides, farthest out.

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

    mimicked = {mimic.get("joint") for mimic in tree.iterfind("joint/mimic")}

    def is_of_gripper(joint: Element) -> bool:
        name = str(joint.get("name"))
        coupled = joint.find("mimic") is not None or name in mimicked
        return joint.get("type") in MOVABLE and (coupled or GRIPPER.search(name) is not None)

    def rank(link: str) -> tuple[bool, int, int, int]:
        kinds = [joint.get("type") for joint in path(link)]
        turning = kinds.count("revolute") + kinds.count("continuous")
        free = not any(map(is_of_gripper, path(link)))
        return free, turning, -kinds.count("prismatic"), len(kinds)

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


def rows_of(arm: Arm) -> int:
    """Coordinates of the tool's pose that an arm can hold: below six joints its position alone."""
    return 6 if arm.n >= 6 else 3


def solved(
    arm: Arm, q: np.ndarray, position: np.ndarray, rotation: np.ndarray | None = None
) -> np.ndarray | None:
    """Posture with the tool at a position (3,) [m], level or with a rotation (3, 3); else None.

    Light joints move most, as those of an arm that is guided or follows a policy.
    """
    low, high, rows = arm.q_min + MARGIN, arm.q_max - MARGIN, rows_of(arm)
    for _ in range(80):
        now, turned = arm.tool_pose(q)
        axes = np.cross(turned[:, 2], [0.0, 0.0, 1.0])
        if rotation is not None:
            axes = 0.5 * np.cross(turned.T, rotation.T).sum(axis=0)
        error = np.concatenate([position - now, axes])[:rows]
        upright = rows < 6 or rotation is not None or turned[2, 2] > 0.999
        if np.abs(error).max() < 1e-3 and upright:
            return q
        light = np.linalg.cholesky(np.linalg.inv(arm.mass_matrix(q)))
        step = light @ damped_step(arm.jacobian(q)[:rows] @ light, error)
        q = np.clip(q + 0.5 * step, low, high)
    return None


def way_of(arm: Arm, home: np.ndarray, way: np.ndarray) -> np.ndarray | None:
    """Postures (K, n) [rad] at even times of a reach from the home by a way (3,) [m], or None.

    It keeps the tool's orientation and has the arc and the speed of a demonstrated one.
    """
    (start, rotation), postures = arm.tool_pose(home), [home]
    for u in np.linspace(0.0, 1.0, STEPS + 1)[1:]:
        share = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        place = start + share * way + np.sin(np.pi * share) * ARC
        if (found := solved(arm, postures[-1], place, rotation)) is None:
            return None
        postures.append(found)
    return np.array(postures)


def room_of(arm: Arm, postures: np.ndarray, torque_share: float) -> float:
    """How far a reach stays from limits and singularities; negative beyond a limit or at the table.

    The least of distances [rad], shares left of speeds and torques, and singular values.
    """
    near = np.minimum(postures - arm.q_min, arm.q_max - postures) - MARGIN
    speeds = np.abs(np.diff(postures, axis=0)) * STEPS / DURATION
    slow = 1.0 - float((speeds / (SPEED_SHARE * arm.qd_max)).max())
    torques = np.array([np.abs(arm.gravity(q)) for q in postures])
    held = 1.0 - float((torques / (torque_share * arm.tau_max)).max())
    jacobians = np.array([arm.jacobian(q)[: rows_of(arm)] for q in postures])
    nimble = float(np.linalg.svd(jacobians, compute_uv=False).min())
    motions = [arm.motion(q, np.zeros(arm.n)) for q in postures]
    points = np.array([[each.position.tolist(), *each.guarded_positions] for each in motions])
    return min(float(near.min()), slow, held, nimble) if points[:, :, 2].min() > TABLE else -1.0


def reach_of(
    arm: Arm, torque_share: float, rng: np.random.Generator
) -> tuple[np.ndarray, float, np.ndarray]:
    """Home (n,) [rad], farthest place of the tool [m], and way to the goal (3,) [m].

    The tool is level if that is possible. A long way counts as much as room about it.

    Raises:
        ValueError: No reach within the limits of position and speed, above the table, was found.
    """
    postures = rng.uniform(arm.q_min + MARGIN, arm.q_max - MARGIN, (TRIES * 20, arm.n))
    poses = [arm.tool_pose(q) for q in postures]
    tools, upright = np.array([p for p, _ in poses]), np.array([r[2, 2] for _, r in poses])
    middle = tools.mean(axis=0)
    reach = float(np.linalg.norm((tools - middle)[:, :2], axis=1).max())
    ahead = np.flatnonzero((tools[:, 0] > middle[0]) & (tools[:, 2] > TABLE))
    ways = np.outer(rng.uniform(0.1, 0.7, TRIES) * reach, [0.0, 1.0, 0.0])
    farthest = float(np.linalg.norm(tools[:, :2], axis=1).max())
    for level in (True, False):
        tried = ahead[upright[ahead].argsort()[::-1]] if level else ahead
        most, best = 0.0, None
        for q, start, way in zip(postures[tried], tools[tried], ways, strict=False):
            home = solved(arm, q, start) if level else q
            path = None if home is None else way_of(arm, home, way)
            if path is not None and (worth := way[1] * room_of(arm, path, torque_share)) > most:
                most, best = worth, (path[0], farthest, way)
        if best is not None:
            return best
    raise ValueError(
        f"no reach of the tool to its left was found above the height of 0, {MARGIN} rad from the "
        f"position limits, with {SPEED_SHARE:g} of the speed and {torque_share:g} of the torque "
        "limits: are they those of its maker? Give another link, with --tool, or home and goal by "
        "hand"
    )


def proposals(urdf: str, file: str, tool: str, output: str) -> Iterator[Proposal]:
    """Values of a set-up, in the order of its file.

    Raises:
        ValueError: The URDF is none of an arm that can be used, as `Arm` says.
    """
    names, links, tool = chain(tree := parsed(urdf), tool)
    limits = limits_of_turning(tree, names)
    elbow, wrist = links[(len(names) + 1) // 2], links[max(len(names) - 2, 1)]
    guarded = [GuardedPoint(link, link, (0.0, 0.0, 0.0)) for link in (elbow, wrist)]
    arm = Arm(urdf, names, tool, guarded, position_limits=limits)
    share = 0.5 if output == "torque" else 1.0
    home, reach, way = reach_of(arm, share, np.random.default_rng(0))
    start = arm.tool_pose(home)[0]
    goal = start + way
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
    reason = "of the URDF's limits, for the first runs" if share < 1.0 else "of the model alone"
    yield Proposal(node, "torque_share", share, reason)
    yield Proposal(node, "guarded_speed_max", 1.0, "[m/s] for the first runs")
    yield Proposal(node, "idle_service", "", "none is known")
    yield Proposal(node, "output", output, "what the driver takes")
    middle = [*((start + goal) / 2.0 + ARC).round(3).tolist(), round(SHARE * float(way[1]), 3)]
    yield Proposal(node, "guarded_region", middle, "[m] obstacle of task reach, half-way")
    yield Proposal("wam_sim", "drives", "direct", "one motor a joint, limits of the URDF")
    yield Proposal(
        "wam_sim", "home", home.round(3).tolist(), "[rad] tool level if it can be, limits far"
    )
    yield Proposal("wam_sim", "goal", goal.round(3).tolist(), "[m] to the left of the home")


def text(values: list[Proposal]) -> str:
    """The set-up as a file."""
    lines = ["# Proposed from the URDF alone: check each line, above all limits, plane and home."]
    for node in dict.fromkeys(each.node for each in values):
        lines += [f"/**/{node}:", "  ros__parameters:"]
        for _, name, value, reason in (each for each in values if each.node == node):
            lines.append(f"    {name}: {json.dumps(value)}  # {reason}")
    return "\n".join(lines) + "\n"
