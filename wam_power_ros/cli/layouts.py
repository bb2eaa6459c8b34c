# SPDX-License-Identifier: Apache-2.0
"""The layout of RViz in config/visualization, with the frames and topics of another set-up."""

from __future__ import annotations

import re

from wam_power_ros.params.overlay import Setup
from wam_power_ros.params.resources import share

_NAMES = re.compile(  # in the file: the frame of the base, and topics
    r"\bwam_base\b|/robot_description\b|/learner/markers\b|/rollout/\w+|/pancake/state\b"
)


def rviz(setup: Setup, namespace: str = "") -> str:
    """Text of the layout; a task without a tracked body leaves its display empty.

    Args:
        setup: Parameters by node.
        namespace: Namespace of the nodes, such as `/left`; empty for none.
    """
    from wam_power_ros.ros import interface

    body = setup["pancake_tracker"]["body"] or "pancake"
    own = {
        "wam_base": interface.frame(namespace, setup["torque_controller"]["base_frame"]),
        "/pancake/state": f"{namespace}/{body}/state",
        "/rollout/pancake": f"{namespace}/rollout/{body}",
    }
    text = share("config/visualization/session.rviz").read_text()
    text = text.replace('TF Prefix: ""', f'TF Prefix: "{namespace.lstrip("/")}"')
    return _NAMES.sub(lambda name: own.get(name[0], f"{namespace}{name[0]}"), text)
