# SPDX-License-Identifier: Apache-2.0
"""Contact of bodies with tool and surroundings."""

import mujoco
import numpy as np

WALLS, WALL = 16, 0.002  # boxes around a vessel, and their half thickness [m]
_FIXED, _BODY = 1, 2  # collision bits: only bodies collide, with tool and ground


def body_contact(friction: float) -> dict[str, object]:
    """Geom arguments for the contact of a body with tool and ground."""
    return tool_contact(friction) | {"contype": _BODY, "conaffinity": _FIXED}


def tool_contact(friction: float) -> dict[str, object]:
    """Geom arguments for the contact of the tool with a body.

    Nearly inelastic: MuJoCo's softer default lets a thin disc fall through a tool.
    """
    return {
        "solref": [0.005, 0.6],
        "solimp": [0.9, 0.97, 0.002, 0.5, 2.0],
        "friction": [friction, 0.005, 0.0001],
        "condim": 4,
        "contype": _FIXED,
        "conaffinity": _BODY,
    }


def add_vessel(
    tool: mujoco.MjsBody,
    name: str,
    radius: float,
    height: float,
    width: float,
    flare: float = 0.0,
    floor: float = WALL,
    **contact: object,
) -> None:
    """Add a round vessel without mass to the tool: a floor below its origin, a wall of boxes.

    The floor has this radius and half thickness `floor` [m]. The wall leans outward by `flare`
    [rad]; each of its `WALLS` boxes has this height and half width [m]. `name` begins the names of
    the geoms, `contact` are other arguments of theirs.
    """
    contact |= {"mass": 0.0}
    tool.add_geom(
        name=f"{name}_floor",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[radius, floor, 0.0],
        pos=[0.0, 0.0, -floor],
        **contact,
    )
    outward = radius + 0.5 * height * np.tan(flare)
    tilt = np.array([np.cos(flare / 2), 0.0, np.sin(flare / 2), 0.0])  # about y
    for k in range(WALLS):
        angle = 2.0 * np.pi * k / WALLS
        turn = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])  # about z
        quat_wxyz = np.zeros(4)
        mujoco.mju_mulQuat(quat_wxyz, turn, tilt)
        tool.add_geom(
            name=f"{name}_wall{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[WALL, width, 0.5 * height / np.cos(flare)],
            pos=[outward * np.cos(angle), outward * np.sin(angle), 0.5 * height],
            quat=quat_wxyz,
            **contact,
        )
