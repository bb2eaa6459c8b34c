# SPDX-License-Identifier: Apache-2.0
"""Names are relative to the arm; those of a tracked body begin with its name."""

from __future__ import annotations

from wam_power_ros.ros import interface


def test_what_is_of_one_arm_has_a_relative_name_and_only_what_all_share_is_absolute() -> None:
    names = {
        name for key, name in vars(interface).items() if key.isupper() and isinstance(name, str)
    }
    names |= {interface.body_topic("pancake", leaf) for leaf in interface.BODY_LEAVES}
    shared = {"/clock", "/diagnostics", "/rosout", "/tf", "/tf_static"}
    assert {name for name in names if name.startswith("/")} == shared


def test_frames_and_topics_have_the_arm_and_the_body_in_their_names() -> None:
    assert interface.frame("/", "wam_base") == "wam_base"
    assert interface.frame("/left", "wam_base") == "left/wam_base"
    assert interface.body_topic("pancake", "state") == "pancake/state"
    assert interface.rollout_topic("ball") == "rollout/ball"
    assert interface.body_topic("", "truth") == "scene/truth"
