# SPDX-License-Identifier: Apache-2.0
"""How far the middleware reaches: to the loopback interface, unless the network is asked for.

ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST says whom a process looks for, not who may speak to it: its
sockets are bound to every interface, and who names this machine in ROS_STATIC_PEERS is answered
(tried from another network namespace). A profile of Fast DDS binds them to 127.0.0.1. It describes
discovery as LOCALHOST does; SYSTEM_DEFAULT goes with it because under LOCALHOST rmw_fastrtps adds
transports of its own, on every interface. This module imports no rclpy.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Mapping, MutableMapping
from contextlib import suppress
from pathlib import Path

from wam_power_ros.params.resources import share

RANGE, PROFILE = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
PROFILE_HERE = "DEFAULT_FASTRTPS_PROFILES.xml"  # Fast DDS reads it in the working directory, too
LOOPBACK = "security/loopback.xml"


def confine(environment: MutableMapping[str, str]) -> bool:
    """Choose the loopback interface by environment variables, where nothing else is asked for.

    Args:
        environment: Variables of a process that has not initialised rclpy yet; changed.

    Returns:
        Whether the sockets are to be those of the loopback interface.
    """
    profile = str(share(LOOPBACK))
    if environment.get(PROFILE) == profile:  # as a parent process chose
        del environment[PROFILE]
        if environment.get(RANGE) == "SYSTEM_DEFAULT":
            environment[RANGE] = "LOCALHOST"
    if not environment.get(RANGE):
        environment[RANGE] = "LOCALHOST"
    if wider_reach(environment):
        return False
    environment |= {RANGE: "SYSTEM_DEFAULT", PROFILE: profile}
    return True


def wider_reach(environment: Mapping[str, str]) -> str | None:
    """What asks for more than the loopback interface, in words; None if nothing does."""
    if environment.get(PROFILE) == str(share(LOOPBACK)):
        return None
    reach = environment.get(RANGE) or "SUBNET"
    if reach != "LOCALHOST":
        return f"discovery range {reach}"
    for name in ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"):
        places = [place for place in environment.get(name, "").split(";") if place]
        if not all(place.startswith(("127.", "localhost")) for place in places):
            return f"{name}={environment[name]}"
    profile = environment.get(PROFILE) or (PROFILE_HERE if Path(PROFILE_HERE).exists() else "")
    if profile:
        return f"sockets as {profile} sets them"
    middleware = environment.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp"
    if middleware != "rmw_fastrtps_cpp":
        return f"{middleware}, which no profile here keeps to the loopback interface"
    return None


def bound_addresses(processes: str = "self") -> list[str]:
    """Addresses `ip:port` to which UDP sockets of this process are bound; none where not Linux.

    Args:
        processes: "self", or "*" for every process that may be looked into.
    """
    inodes = set()
    for file in Path("/proc").glob(f"{processes}/fd/*"):
        with suppress(OSError):
            inodes.add(str(file.readlink()))
    return [address for address, inode in _udp_sockets() if f"socket:[{inode}]" in inodes]


def ports_in_use() -> set[int]:
    """UDP ports (IPv4) to which any process of this network namespace has bound a socket."""
    return {int(address.rpartition(":")[2]) for address, _ in _udp_sockets()}


def _udp_sockets() -> list[tuple[str, str]]:
    """Address and inode of the UDP sockets (IPv4) of this network namespace."""
    found = []
    with suppress(OSError):
        for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]:
            words = line.split()
            ip, _, port = words[1].partition(":")
            address = socket.inet_ntoa(struct.pack("=I", int(ip, 16)))
            found.append((f"{address}:{int(port, 16)}", words[9]))
    return found
