# SPDX-License-Identifier: Apache-2.0
"""The layout of RViz with the frames and topics of a set-up."""

from __future__ import annotations

import re

import yaml
from conftest import ROOT

from wam_power_ros.cli import layouts
from wam_power_ros.params import overlay


def test_the_shipped_layout_is_that_of_the_shipped_set_up() -> None:
    shipped = (ROOT / "config/visualization/session.rviz").read_text()
    assert layouts.rviz(overlay.setup()) == shipped


def test_rviz_shows_the_arm_of_its_namespace_and_no_name_of_another() -> None:
    changes = {"torque_controller": {"base_frame": "stand"}, "pancake_tracker": {"body": "ball"}}
    text = layouts.rviz(overlay.setup(["ur"]).changed(changes), "/left")
    assert not re.search(r"wam_|pancake", text)
    topics = set(re.findall(r"(?<=[\"; ])/(?:[a-z_]+/?)+", text))
    assert topics and all(topic.startswith("/left/") for topic in topics)
    manager = yaml.safe_load(text)["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "left/stand"
    assert [each["TF Prefix"] for each in manager["Displays"] if "TF Prefix" in each] == ["left"]
