# SPDX-License-Identifier: Apache-2.0
"""Whether others can command this arm: SROS2 enforced, and the reach of the network.

What each node may do is in `security/policy.xml`.
"""

from __future__ import annotations

from collections.abc import Mapping

from wam_power_ros.ros import network


def exposed(environment: Mapping[str, str]) -> str | None:
    """Reason why others on the network can command this arm; None if they cannot."""
    reason = network.wider_reach(environment)
    if _enforced(environment) or environment.get(network.RANGE) == "OFF" or reason is None:
        return None
    return (
        f"anybody on the network can command this arm: {reason}, security not enforced. Remove "
        f"that setting and set {network.RANGE}=LOCALHOST to bind sockets to this machine's "
        "loopback interface, or enforce security: see SECURITY.md"
    )


def _enforced(environment: Mapping[str, str]) -> bool:
    switches = map(environment.get, ("ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"))
    return [*switches] == ["true", "Enforce"]
