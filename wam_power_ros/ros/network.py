# SPDX-License-Identifier: Apache-2.0
"""Transports of the middleware: UDP, on loopback only unless the environment asks for more.

ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST limits which processes are looked for, not who may connect:
the sockets are bound to every interface, and a machine with this one in ROS_STATIC_PEERS gets
answers (tested from another network namespace). A profile of Fast DDS binds them to 127.0.0.1. It
sets up discovery as LOCALHOST does and needs SYSTEM_DEFAULT, because under LOCALHOST rmw_fastrtps
adds its own transports on every interface.

Fast DDS 2.14 also has shared memory, which is left out: a process that stood still for a second,
beside others that come and are killed, can stay deaf to one sender for good, although both run on
(5 of 331 times; with UDP alone, 0 of 307).

rclpy is imported only where it is asked which middleware it has loaded: `domain` needs none.
"""

from __future__ import annotations

import socket
import struct
import tempfile
from collections.abc import Mapping, MutableMapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from wam_power_ros.params.resources import share

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
ON_LOOPBACK = {RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "", "ROS_DISCOVERY_SERVER": ""}
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"  # where no profile names them
MIDDLEWARE = "rmw_fastrtps_cpp"  # the only one with a profile here
SWITCHES = ("RCUTILS_LOGGING_USE_STDOUT", "RCUTILS_LOGGING_BUFFERED_STREAM")
RANGES = ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT")


class VariableError(ValueError):
    """An environment variable cannot be used; the message names it, its value and the remedy."""


class Profile(NamedTuple):
    """How a version of Fast DDS gets its profile."""

    variable: str  # environment variable with the path of a file
    here: str  # file that is also read, in the working directory
    ours: str  # file of the loopback interface alone; one word of it differs between the versions

    @property
    def path(self) -> str:
        """Path of our file."""
        return str(share(self.ours))


FAST_DDS_2 = Profile(  # Jazzy
    "FASTRTPS_DEFAULT_PROFILES_FILE", "DEFAULT_FASTRTPS_PROFILES.xml", "security/loopback.xml"
)
FAST_DDS_3 = Profile(  # Kilted
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "DEFAULT_FASTDDS_PROFILES.xml",
    "security/loopback_fast_dds_3.xml",
)


@cache
def profile() -> Profile:
    """Profile of the version of Fast DDS that rclpy has loaded."""
    middleware()  # loads it
    third = "/libfastdds.so" in Path("/proc/self/maps").read_text()
    return FAST_DDS_3 if third else FAST_DDS_2


def middleware() -> str:
    """Identifier of the middleware that rclpy has loaded, whatever the environment names."""
    from rclpy.utilities import get_rmw_implementation_identifier

    identifier: str = get_rmw_implementation_identifier()
    return identifier


def unconfined_middleware() -> str | None:
    """Middleware that cannot be confined to the loopback interface, as text; None if it can."""
    if (loaded := middleware()) == MIDDLEWARE:
        return None
    return f"{loaded}, for which there is no profile of the loopback interface here"


def check(environment: Mapping[str, str]) -> None:
    """Refuse variables of which ROS and Fast DDS say too little, or nothing.

    Raises:
        VariableError: As it says.
    """
    get = environment.get
    wrong = [f"{RANGE}={get(RANGE)} is not one of {', '.join(RANGES)}"]
    wrong *= bool(get(RANGE)) and get(RANGE) not in RANGES
    for variable in (profile().variable, FAST_DDS_2.variable):
        if (file := get(variable)) and not Path(file).is_file():
            wrong.append(f"{variable}={file}: there is no such file")
    for variable in SWITCHES:
        if (value := get(variable) or "0") not in ("0", "1"):
            wrong.append(f"{variable}={value} is not 0 or 1")
    for peer in filter(None, get("ROS_STATIC_PEERS", "").split(";")):
        try:
            socket.getaddrinfo(peer, None)
        except OSError as error:
            text = f"is no address or known host ({error.strerror})"
            wrong.append(f"ROS_STATIC_PEERS: {peer!r} {text}")
    if folder := get("ROS_LOG_DIR"):
        try:
            Path(folder).mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError as error:
            wrong.append(f"ROS_LOG_DIR={folder}: no log can be written there ({error.strerror})")
    if wrong:
        raise VariableError(f"{'; '.join(wrong)}: correct it, or unset the variable")


def confine(environment: MutableMapping[str, str]) -> None:
    """Set the variables that select transports: on loopback unless the environment asks for more.

    Args:
        environment: Variables of a process that has not initialised rclpy yet; changed.
    """
    own = profile()
    if environment.pop("ROS_LOCALHOST_ONLY", "0") == "1":  # overrules the range, for all interfaces
        environment |= ON_LOOPBACK
    if environment.get(own.variable) == own.path:  # set by a parent process
        del environment[own.variable]
        if environment.get(RANGE) == "SYSTEM_DEFAULT":
            environment[RANGE] = "LOCALHOST"
    if not environment.get(RANGE):
        environment[RANGE] = "LOCALHOST"
    if wider_reach(environment):
        environment.setdefault(TRANSPORTS, "UDPv4")
    else:
        environment |= {RANGE: "SYSTEM_DEFAULT", own.variable: own.path}


def wider_reach(environment: Mapping[str, str]) -> str | None:
    """Setting that opens more than the loopback interface, as text; None without one."""
    if unconfined := unconfined_middleware():
        return unconfined
    own = profile()
    if environment.get(own.variable) == own.path:
        return None
    reach = environment.get(RANGE) or "SUBNET"
    if reach != "LOCALHOST":
        return f"discovery range {reach}"
    for name in ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"):
        addresses = [address for address in environment.get(name, "").split(";") if address]
        if not all(address.startswith(("127.", "localhost")) for address in addresses):
            return f"{name}={environment[name]}"
    for variable in (own.variable, FAST_DDS_2.variable):  # rmw_fastrtps of Kilted reads both
        if given := environment.get(variable):
            return f"sockets set by the profile {given}"
    if Path(own.here).exists():
        return f"sockets set by the profile {own.here}"
    return None


def bound_addresses(process: str = "self") -> list[str]:
    """Addresses `ip:port` to which UDP sockets of a process, an id or "self", are bound."""
    inodes = set()
    for file in Path("/proc").glob(f"{process}/fd/*"):
        with suppress(OSError):
            inodes.add(str(file.readlink()))
    return [address for address, inode in _udp_sockets() if f"socket:[{inode}]" in inodes]


def ports_in_use() -> set[int]:
    """UDP ports (IPv4) to which any process of this network namespace has bound a socket."""
    return {int(address.rpartition(":")[2]) for address, _ in _udp_sockets()}


def _udp_sockets() -> list[tuple[str, str]]:
    """Addresses and inodes of the UDP sockets (IPv4) of this network namespace."""
    found = []
    for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]:
        words = line.split()
        ip, _, port = words[1].partition(":")
        address = socket.inet_ntoa(struct.pack("=I", int(ip, 16)))
        found.append((f"{address}:{int(port, 16)}", words[9]))
    return found
