# SPDX-License-Identifier: Apache-2.0
"""Contact of bodies with tool and surroundings."""

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
