# SPDX-License-Identifier: Apache-2.0
"""The layouts for RViz, Foxglove and PlotJuggler name what the nodes publish, and nothing else.

That the types are those of the publishers is seen in `test_security`, where every node is made.
"""

from __future__ import annotations

import yaml
from layouts import FOLDER, uses
from rights import RIGHTS

from wam_power_ros.ros import interface

SENT = ("topic", "publish")
PUBLISHED = {topic for rights in RIGHTS.values() for topic in rights.get(SENT, ())}


def test_every_topic_of_a_layout_is_one_that_a_node_publishes() -> None:
    named = {(use.file, use.topic) for use in uses()}
    assert {file for file, _ in named} == {
        path.name for path in FOLDER.iterdir() if path.suffix != ".yaml"
    }
    assert {topic for _, topic in named} - PUBLISHED == set()


def test_the_diagnostics_of_every_node_are_in_one_group() -> None:
    file = yaml.safe_load((FOLDER / "diagnostics.yaml").read_text())
    groups = file["analyzers"]["ros__parameters"]
    wanted = [
        text for group in groups.values() if isinstance(group, dict) for text in group["contains"]
    ]
    nodes = {
        name.removesuffix("_preparation")  # publishes for the controller
        for name, rights in RIGHTS.items()
        if interface.DIAGNOSTICS in rights.get(SENT, ())
    }
    assert len(nodes) > 3
    for name in nodes:
        for namespace in ("", "left/"):
            assert [text for text in wanted if text in f"{namespace}{name}: loop"] == [f"{name}: "]
