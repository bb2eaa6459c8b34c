# SPDX-License-Identifier: Apache-2.0
"""DDS domains of this machine: one holder each, by a lock that the kernel drops with its process.

A session holds the domain it works in, and a stand-in the one it was started in. Nodes that the
holder has started belong to it. This module imports no rclpy.
"""

from __future__ import annotations

import fcntl
import os
import random
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from wam_power_ros.ros import network, shared_memory

FIRST, PER_DOMAIN, PER_PARTICIPANT = 7410, 250, 2  # ports of discovery (RTPS 2.2, 9.6.1.1)
LAST = 232  # above it there are no ports
PRIVATE = range(1, 102)  # above these, ports meet those the kernel hands out


class DomainError(ValueError):
    """A domain that is not one, or that is somebody else's."""


def exported(environment: Mapping[str, str]) -> int:
    """The domain that an environment names, 0 if none.

    Raises:
        DomainError: It is not a number from 0 to LAST.
    """
    text = environment.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= LAST):
        raise DomainError(f"ROS_DOMAIN_ID={text!r} is not a whole number from 0 to {LAST}")
    return int(text)


@contextmanager
def private_domain() -> Iterator[int]:
    """A domain for a simulation: nobody on this machine holds it, and nobody is in it.

    It is never the one that ROS_DOMAIN_ID names, which may be a robot's.

    Raises:
        DomainError: All are taken.
    """
    used, named = network.ports_in_use(), os.environ.get("ROS_DOMAIN_ID", "").strip()
    domains = [domain for domain in PRIVATE if str(domain) != named]
    random.SystemRandom().shuffle(domains)
    for domain in domains:
        if not used.isdisjoint(ports(domain)):
            continue
        with ExitStack() as held:
            try:
                held.enter_context(_locked(domain))
            except OSError:  # taken, or made by another user
                continue
            shared_memory.remove_ports(ports(domain))
            yield domain
            return
    raise DomainError(
        f"every DDS domain from {PRIVATE[0]} to {PRIVATE[-1]} is taken on this machine"
    )


def hold(domain: int) -> IO[str] | None:
    """Hold a domain until the result is closed or the process ends.

    Returns:
        The lock; None when a process above this one holds the domain already.

    Raises:
        DomainError: Another process holds it.
    """
    try:
        return _locked(domain)
    except BlockingIOError:
        holder = _holder(domain)
        if holder in _ancestors():
            return None
        who = _command(holder) if holder else "another process"
        raise DomainError(
            f"DDS domain {domain} is in use on this machine by {who}; end that, or choose another "
            "domain: export ROS_DOMAIN_ID=N"
        ) from None


def ports(domain: int) -> range:
    """UDP ports of a domain."""
    return range(FIRST - 10 + PER_DOMAIN * domain, FIRST - 10 + PER_DOMAIN * (domain + 1))


def _lock_file(domain: int) -> Path:
    return Path(tempfile.gettempdir()) / f"ros_domain_{domain}.lock"


def _locked(domain: int) -> IO[str]:
    """The locked file of a domain.

    Raises:
        BlockingIOError: Another process holds it.
        OSError: It cannot be opened.
    """
    path = _lock_file(domain)
    try:
        file = path.open("a")
    except PermissionError:  # another user made it: to be read is enough for a lock
        file = path.open()
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise
    return file


def _holder(domain: int) -> int:
    """Process that holds a domain, as the kernel lists it; 0 where it does not tell."""
    with suppress(OSError):
        inode = _lock_file(domain).stat().st_ino
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()
            if "FLOCK" in words and words[-3].rpartition(":")[2] == str(inode):
                return int(words[-4])
    return 0


def _ancestors() -> set[int]:
    """This process and those above it."""
    found, process = set(), os.getpid()
    while process > 0 and process not in found:
        found.add(process)
        try:
            stat = Path(f"/proc/{process}/stat").read_text()
        except OSError:
            break
        process = int(stat.rpartition(")")[2].split()[1])
    return found


def _command(process: int) -> str:
    try:
        words = Path(f"/proc/{process}/cmdline").read_text(errors="replace").split("\0")
    except OSError:
        return f"process {process}"
    return f"process {process} ({' '.join(words).strip()[:100]})"
