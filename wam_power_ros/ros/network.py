# SPDX-License-Identifier: Apache-2.0
"""Transports of the middleware: UDP, on loopback only unless the environment asks for more.

ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST limits which processes are looked for, not who may connect:
the sockets are bound to every interface, and a machine with this one in ROS_STATIC_PEERS gets
answers (tested from another network namespace). A profile of Fast DDS binds them to 127.0.0.1. It
sets up discovery as LOCALHOST does and needs SYSTEM_DEFAULT, because under LOCALHOST rmw_fastrtps
adds its own transports on every interface.

Shared memory of Fast DDS is left out: docs/decisions/06-udp-only.md.

rclpy is imported only where it is asked which middleware it has loaded: `domain` needs none.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

from wam_power_ros.params.resources import share

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
ON_LOOPBACK = {RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "", "ROS_DISCOVERY_SERVER": ""}
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"  # where no profile names them
MIDDLEWARE = "rmw_fastrtps_cpp"  # the only one with a profile here
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


def unrestricted_middleware() -> str | None:
    """Middleware that cannot be confined to the loopback interface, as text; None if it can."""
    if (loaded := middleware()) == MIDDLEWARE:
        return None
    return f"{loaded}, for which there is no profile of the loopback interface here"


def check(environment: Mapping[str, str]) -> None:
    """Refuse, by a VariableError, variables that ROS and Fast DDS ignore without a word."""
    get = environment.get
    if (given := get(RANGE) or RANGES[0]) not in RANGES:
        raise VariableError(f"{RANGE}={given} is not one of {', '.join(RANGES)}: correct it")
    for variable in (profile().variable, FAST_DDS_2.variable):
        if (file := get(variable)) and not Path(file).is_file():
            raise VariableError(f"{variable}={file}: there is no such file; unset the variable")


def restrict_to_loopback(environment: MutableMapping[str, str]) -> None:
    """Set the variables that select transports: on loopback unless the environment asks for more.

    It is that of a process that has not initialised rclpy yet, and is changed.
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
    if unrestricted := unrestricted_middleware():
        return unrestricted
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


def exposed(environment: Mapping[str, str]) -> str | None:
    """Reason why others on the network can command this arm; None if they cannot.

    What each node may do where SROS2 is enforced is in `security/policy.xml`.
    """
    get, reason = environment.get, wider_reach(environment)
    enforced = get("ROS_SECURITY_ENABLE") == "true" and get("ROS_SECURITY_STRATEGY") == "Enforce"
    if enforced or get(RANGE) == "OFF" or reason is None:
        return None
    return (
        f"anybody on the network can command this arm: {reason}, security not enforced. Remove "
        f"that setting and set {RANGE}=LOCALHOST to bind sockets to this machine's "
        "loopback interface, or enforce security: see SECURITY.md"
    )


def ports_in_use() -> set[int]:
    """UDP ports (IPv4) to which any process of this network namespace has bound a socket."""
    _, *lines = Path("/proc/self/net/udp").read_text().splitlines()
    return {int(line.split()[1].partition(":")[2], 16) for line in lines}
