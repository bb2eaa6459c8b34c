# SPDX-License-Identifier: Apache-2.0
"""Topics, types and fields that the layouts of config/visualization name."""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator
from typing import NamedTuple
from xml.etree import ElementTree

import yaml
from conftest import ROOT

FOLDER = ROOT / "config/visualization"
DISPLAYS = {  # of RViz
    "Path": "nav_msgs/msg/Path",
    "Odometry": "nav_msgs/msg/Odometry",
    "RobotModel": "std_msgs/msg/String",
}
PANELS = {  # of Foxglove: what its 3D panel, its models and its summary draw
    **dict.fromkeys(("/rollout/pancake", "/rollout/end_effector"), "nav_msgs/msg/Path"),
    "/robot_description": "std_msgs/msg/String",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


class Use(NamedTuple):
    """One place in a layout that names a topic.

    Attributes:
        file: Name of the layout.
        topic: Topic without a namespace.
        kind: Type that is needed there, empty for any with the fields.
        fields: Fields of the message, from the outermost on.
    """

    file: str
    topic: str
    kind: str
    fields: tuple[str, ...] = ()

    def fits(self, kind: str) -> bool:
        """Whether messages of this type can be shown there."""
        package, _, name = kind.split("/")
        message = getattr(importlib.import_module(f"{package}.msg"), name)()
        for field in self.fields:
            message = getattr(message, field.partition("[")[0], None)
        return message is not None and self.kind in ("", kind)


def uses() -> list[Use]:
    """All of them."""
    return [*_rviz(), *_foxglove(), *_plotjuggler()]


def _rviz() -> Iterator[Use]:
    for display in yaml.safe_load((FOLDER / "session.rviz").read_text())["Visualization Manager"][
        "Displays"
    ]:
        kind = display["Class"].removeprefix("rviz_default_plugins/")
        if topic := display.get("Topic", display.get("Description Topic")):
            yield Use("session.rviz", topic["Value"], DISPLAYS[kind])


def _foxglove() -> Iterator[Use]:
    text = (FOLDER / "foxglove.json").read_text()
    for panel in json.loads(text)["configById"].values():
        plotted = [line["value"] for line in panel.get("paths", ())]
        for path in filter(None, [*plotted, panel.get("topicPath")]):
            topic, *fields = path.split(".")
            yield Use("foxglove.json", topic, "", tuple(fields))
        layers = panel.get("layers", {}).values()
        named = [layer.get(key) for layer in layers for key in ("topic", "jointStatesTopic")]
        for topic in filter(None, [*panel.get("topics", ()), *named, panel.get("topicToRender")]):
            yield Use("foxglove.json", topic, PANELS[topic])


def _plotjuggler() -> Iterator[Use]:
    file = "plotjuggler.xml"
    root = ElementTree.parse(FOLDER / file)
    topics = next(root.iter("selected_topics")).get("list", "").split(";")
    yield from (Use(file, topic, "") for topic in topics)
    for curve in root.iter("curve"):
        name = curve.get("name", "")
        (topic,) = (each for each in topics if name.startswith(f"{each}/"))
        fields = name.removeprefix(f"{topic}/").split("/")
        if re.fullmatch(r"wam_j[1-7]", fields[0]):  # it names the values of a joint state so
            yield Use(file, topic, "sensor_msgs/msg/JointState", (fields[1],))
        else:
            yield Use(file, topic, "", tuple(fields))
