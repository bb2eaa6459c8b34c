# SPDX-License-Identifier: Apache-2.0
"""Errors of libfranka in words."""

from __future__ import annotations

from wam_power_ros.nodes.franka_errors import described


class Errors:
    """As the library has them: an attribute for each error, and others."""

    joint_reflex = True
    power_limit_violation = False
    newly_named_violation = True

    def copy(self) -> Errors:
        """No error."""
        return self


def test_each_error_is_named_with_what_clears_it_and_an_unknown_one_where_it_is_explained() -> None:
    first, second = described(Errors(), "Reflex").split("; newly_")
    assert first.startswith("joint_reflex: a joint touched something")
    assert "franka::Errors" in second
    assert "power_limit" not in first + second


def test_a_switch_of_a_person_comes_before_the_errors_of_the_last_motion() -> None:
    assert described(Errors(), "UserStopped").startswith("UserStopped: ")
    assert "reflex" not in described(Errors(), "UserStopped")
    assert "without an error, in mode Idle" in described(object(), "Idle")
