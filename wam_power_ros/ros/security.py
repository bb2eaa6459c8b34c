# SPDX-License-Identifier: Apache-2.0
"""Whether others can command this arm: SROS2 enforced, its keys, and the reach of the network.

What each node may do is in `security/policy.xml`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from wam_power_ros.ros import network


def check_keystore(environment: Mapping[str, str], arguments: Sequence[str]) -> None:
    """Check that a process has its keys if security is enforced.

    Raises:
        ValueError: The keystore or the enclave is missing; the message names it.
    """
    if not _enforced(environment):
        return
    keystore = environment.get("ROS_SECURITY_KEYSTORE", "")
    named = dict(pairwise(arguments)).get("--enclave", "/")
    enclave = environment.get("ROS_SECURITY_ENCLAVE_OVERRIDE") or named
    folder = Path(keystore) / "enclaves" / enclave.lstrip("/")
    if not keystore:
        missing = "ROS_SECURITY_KEYSTORE is not set"
    elif not folder.is_dir():
        missing = f"there is no enclave {enclave} in the keystore, no folder {folder}"
    else:
        return
    raise ValueError(f"security is enforced, but {missing}: see SECURITY.md")


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
