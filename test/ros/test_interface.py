# SPDX-License-Identifier: Apache-2.0
"""Names are relative to the arm; those of a tracked body begin with its name."""

from __future__ import annotations

import pytest

from wam_power_ros.ros import interface


def test_what_is_of_one_arm_has_a_relative_name_and_only_what_all_share_is_absolute() -> None:
    names = {
        name
        for key, name in vars(interface).items()
        if key.isupper() and isinstance(name, str) and not key.endswith("_FRAME")
    }
    names |= {interface.body_topic("pancake", leaf) for leaf in interface.BODY_LEAVES}
    shared = {"/clock", "/diagnostics", "/rosout", "/tf", "/tf_static"}
    assert {name for name in names if name.startswith("/")} == shared


@pytest.mark.parametrize("leaf", ["pose", "state", "drop"])
def test_without_a_body_there_is_the_truth_of_the_scene_alone(leaf: str) -> None:
    assert interface.body_topic("", "truth") == "scene/truth"
    with pytest.raises(ValueError, match="name '' of a tracked body"):
        interface.body_topic("", leaf)


@pytest.mark.parametrize("body", ["a ball", "/ball", "2balls", "scene", "end_effector"])
def test_a_body_whose_name_makes_no_topic_of_its_own_is_refused(body: str) -> None:
    with pytest.raises(ValueError, match=r"name .* of a tracked body"):
        interface.body_topic(body, "pose")
    for none in (body, ""):
        with pytest.raises(ValueError, match=r"name .* of a tracked body"):
            interface.rollout_topic(none)
