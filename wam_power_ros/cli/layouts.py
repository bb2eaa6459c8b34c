# SPDX-License-Identifier: Apache-2.0
"""Layouts for RViz, Foxglove and PlotJuggler with the names of a set-up.

The files of config/visualization have the joints, topics and frames of the WAM and the pancake,
which are replaced here.
"""

from __future__ import annotations

import json
import re

from wam_power_ros import plain_json
from wam_power_ros.params.overlay import Setup
from wam_power_ros.params.resources import share

FILES = {"rviz": "session.rviz", "foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}
_NAMES = re.compile(  # in the files: the frame of the base, and topics
    r"\bwam_base\b|/joint_states\b|/effort_controller/commands\b|/robot_description\b"
    r"|/learner/markers\b|/controller/answer\b|/rollout/\w+|/pancake/state\b"
)
_JOINT = re.compile(r"wam_j(\d)/\w+|data\[(\d)\]")  # in the name of a curve of PlotJuggler
_COLOUR = re.compile(r"#\w{6}")


def layout(program: str, setup: Setup, namespace: str = "") -> str:
    """Text of a layout.

    A task without a tracked body leaves the displays of one empty.

    Args:
        program: One of `FILES`.
        setup: Parameters by node.
        namespace: Namespace of the nodes, such as `/left`; empty for none.
    """
    from wam_power_ros.ros import interface

    arm, body = setup["torque_controller"], setup["pancake_tracker"]["body"] or "pancake"
    own = {
        "wam_base": interface.frame(namespace, arm["base_frame"]),
        "/joint_states": arm["state_topic"],
        "/effort_controller/commands": arm["command_topic"],
        "/pancake/state": f"{body}/state",
        "/rollout/pancake": f"rollout/{body}",
    }

    def renamed(found: re.Match[str]) -> str:
        name = str(own.get(found[0], found[0][1:]))
        absolute = name.startswith("/") or found[0] == "wam_base"
        return name if absolute else f"{namespace}/{name}"

    text = share(f"config/visualization/{FILES[program]}").read_text()
    prefix = namespace.lstrip("/")
    if program == "rviz":
        text = text.replace('TF Prefix: ""', f'TF Prefix: "{prefix}"')
    elif program == "foxglove":
        text = _foxglove(text, arm["joint_names"], arm["command_type"] == "joint_state")
        text = text.replace('"framePrefix": ""', f'"framePrefix": "{prefix and prefix + "/"}"')
    else:
        text = _plotjuggler(text, arm["joint_names"], arm["command_type"] == "joint_state")
    return _NAMES.sub(renamed, text)


def _foxglove(text: str, joints: list[str], by_name: bool) -> str:
    """Layout with one line a joint; a driver may have its states in any order, so by number."""
    whole = plain_json.parse(text, "foxglove.json")
    panels = whole["configById"]
    for panel, field in (("Plot!speed", ".velocity"), ("Plot!torque", ".data")):
        line = panels[panel]["paths"][0]
        topic = line["value"].partition(".")[0]
        torques = field == ".data"
        value = topic + (".effort" if torques and by_name else field)
        panels[panel]["paths"] = [
            line | {"value": f"{value}[{number}]", "label": name if torques else f"[{number}]"}
            for number, name in enumerate(joints)
        ]
    return json.dumps(whole, indent=1) + "\n"


def _plotjuggler(text: str, joints: list[str], by_name: bool) -> str:
    """Layout with one curve a joint."""
    lines, colours = [], _COLOUR.findall(text)
    for line in text.splitlines(keepends=True):
        found = _JOINT.search(line)
        if found is None:
            lines.append(line)
        elif found[0].startswith(("wam_j1/", "data[0]")):  # the others follow from the first
            for number, joint in enumerate(joints):
                own = f"data[{number}]"
                if found[1]:
                    own = found[0].replace("wam_j1", joint)
                elif by_name:
                    own = f"{joint}/effort"
                curve = line.replace(found[0], own)
                lines.append(_COLOUR.sub(colours[number % 7], curve))
    return "".join(lines)
