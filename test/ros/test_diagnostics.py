# SPDX-License-Identifier: Apache-2.0
"""All arms share /diagnostics: a status names its node and namespace."""

from __future__ import annotations

import pytest
from builtin_interfaces.msg import Time

from wam_power_ros.ros.diagnostics import FAULT_KIND, diagnostics_message, of_controller


@pytest.mark.parametrize(
    ("name", "namespace", "mine"),
    [
        ("torque_controller: loop", "/", True),
        ("left/torque_controller: loop", "/left", True),
        ("left/torque_controller: loop", "/", False),
        ("left/torque_controller: loop", "/right", False),
        ("my_controller: loop", "/", True),  # under any node name
    ],
)
def test_a_controller_is_known_by_its_namespace(name: str, namespace: str, mine: bool) -> None:
    values = {FAULT_KIND: "contact"}
    message = diagnostics_message(Time(), name, "wam7", "error", "a fault", values)
    found = of_controller(namespace, message.status[0])
    assert found == (values if mine else None)
