# SPDX-License-Identifier: Apache-2.0
"""DDS domains of this machine: one process holds each, by a lock that ends with the process.

A session holds the domain it works in, a stand-in the domain it was started in; processes that they
start share it (`shared`). Simulations in namespaces may share a domain. This module imports no
rclpy.
"""

from __future__ import annotations

import fcntl
import os
import random
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

from wam_power_ros.ros import network

FIRST_PORT = 7410  # of a participant of domain 0 (RTPS 2.2, 9.6.1.1)
PORTS_PER_DOMAIN, PORTS_PER_PARTICIPANT = 250, 2
DOMAIN_MAX = 232  # ports of higher domains do not exist
PRIVATE_DOMAINS = range(1, 102)  # ports of higher domains are also assigned by the kernel
HELD = "WAM_POWER_HELD_DOMAIN"  # environment variable: domain that a parent process holds


class DomainError(network.VariableError):
    """The domain does not exist, or another process holds it."""


def exported(environment: Mapping[str, str]) -> int:
    """Domain in ROS_DOMAIN_ID, 0 if it is not set; a DomainError if it is none."""
    text = environment.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= DOMAIN_MAX):
        raise DomainError(f"ROS_DOMAIN_ID={text!r} is not a whole number from 0 to {DOMAIN_MAX}")
    return int(text)


def shared(domain: int) -> dict[str, str]:
    """Environment variables of processes that share a domain which this process holds."""
    return {"ROS_DOMAIN_ID": str(domain), HELD: str(domain)}


@contextmanager
def private_domain() -> Iterator[int]:
    """Hold a domain for a simulation, which no other process on this machine holds or uses.

    It is never that of ROS_DOMAIN_ID, which may be a robot's. A DomainError if all are in use.
    """
    used, named = network.ports_in_use(), os.environ.get("ROS_DOMAIN_ID", "").strip()
    domains = [domain for domain in PRIVATE_DOMAINS if str(domain) != named]
    random.SystemRandom().shuffle(domains)
    for domain in domains:
        if not used.isdisjoint(ports(domain)):
            continue
        with ExitStack() as held:
            try:
                held.enter_context(_locked(_lock_file(domain)))
            except OSError:  # held, or another user's
                continue
            yield domain
            return
    first, last = PRIVATE_DOMAINS[0], PRIVATE_DOMAINS[-1]
    text = f"every DDS domain from {first} to {last} is in use on this machine"
    raise DomainError(f"{text}; end a simulation")


def lock(domain: int, namespace: str = "") -> ExitStack | None:
    """Hold a domain until the returned locks are closed or the process ends.

    With a namespace only that one, beside those of other processes. None if a parent process holds
    the domain, as its environment says (`shared`); a DomainError if another does, or its lock
    cannot be read.
    """
    if os.environ.get(HELD) == str(domain):
        return None
    name = namespace.strip("/").replace("/", "__")
    files = [(_lock_file(domain), bool(name))]  # and whether others may lock it as well
    files += [(_lock_file(f"{domain}_{name}"), False)] if name else []
    with ExitStack() as held:
        for file, shared in files:
            try:
                held.enter_context(_locked(file, fcntl.LOCK_SH if shared else fcntl.LOCK_EX))
            except PermissionError:
                raise DomainError(
                    f"{file} cannot be read: it belongs to another user; make it readable for all, "
                    "or remove it while nobody uses the domain"
                ) from None
            except BlockingIOError:
                where = f"namespace {namespace} of " if name else ""
                raise DomainError(
                    f"{where}DDS domain {domain} is in use on this machine by another session "
                    f"(`fuser {file}` names its process); end it, or choose another domain: "
                    "export ROS_DOMAIN_ID=N"
                ) from None
        return held.pop_all()


def ports(domain: int) -> range:
    """UDP ports of a domain."""
    first = FIRST_PORT - 10 + PORTS_PER_DOMAIN * domain
    return range(first, first + PORTS_PER_DOMAIN)


def _lock_file(domain: int | str) -> Path:
    return Path(tempfile.gettempdir()) / f"ros_domain_{domain}.lock"


def _locked(path: Path, operation: int = fcntl.LOCK_EX) -> IO[str]:
    try:
        file = path.open("a")
        if os.fstat(file.fileno()).st_uid == os.getuid():
            os.fchmod(file.fileno(), 0o644)  # whatever the umask: other users must be able to lock
    except PermissionError:  # another user's: a file open for reading can be locked, too
        file = path.open()
    try:
        fcntl.flock(file, operation | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise
    return file
