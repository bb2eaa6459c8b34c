# SPDX-License-Identifier: Apache-2.0
"""Environment in which the page of a session finds its nodes."""

from __future__ import annotations

import os

import pytest

pytest.importorskip("viser")
from wam_power_ros.view.viewer import enter


def test_a_session_on_a_real_arm_is_expected_in_the_exported_domain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.delenv("ROS_STATIC_PEERS", raising=False)
    exported = dict(os.environ)
    enter({"ROS_DOMAIN_ID": "42", "ROS_STATIC_PEERS": ""}, exported)
    assert os.environ["ROS_DOMAIN_ID"] == "42" and "ROS_STATIC_PEERS" in os.environ
    enter({}, exported)
    assert dict(os.environ) == exported
