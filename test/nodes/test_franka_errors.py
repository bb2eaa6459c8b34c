# SPDX-License-Identifier: Apache-2.0
"""Errors of libfranka in words."""

from types import SimpleNamespace

from wam_power_ros.nodes.franka_errors import described

ERRORS = SimpleNamespace(joint_reflex=True, power_limit_violation=False, newly_named=True)


def test_each_error_is_named_with_what_clears_it_and_a_persons_switch_before_all() -> None:
    first, second = described(ERRORS, "Reflex").split("; newly_")
    assert first.startswith("joint_reflex: a joint touched something")
    assert "franka::Errors" in second
    assert "power_limit" not in first + second
    assert described(ERRORS, "UserStopped").startswith("UserStopped: ")
    assert "reflex" not in described(ERRORS, "UserStopped")
    assert "without an error, in mode Idle" in described(object(), "Idle")
