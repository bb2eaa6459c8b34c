# SPDX-License-Identifier: Apache-2.0
"""DDS domains of this machine: one holder each, by a lock that the kernel drops with its process.

A session holds the domain it works in, and a stand-in the one it was started in. Nodes that the
holder has started belong to it. Simulations in namespaces share a domain. No rclpy is imported.
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

FIRST_PORT, PORTS_PER_DOMAIN, PORTS_PER_PARTICIPANT = (
    7410,
    250,
    2,
)  # ports of discovery (RTPS 2.2, 9.6.1.1)
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
                held.enter_context(_locked(_lock_file(domain)))
            except OSError:  # taken, or made by another user
                continue
            shared_memory.remove_ports(ports(domain))
            yield domain
            return
    raise DomainError(
        f"every DDS domain from {PRIVATE[0]} to {PRIVATE[-1]} is taken on this machine"
    )


def hold(domain: int, namespace: str = "") -> ExitStack | None:
    """Hold a domain until the result is closed or the process ends.

    Args:
        domain: Number of the domain.
        namespace: Namespace that is held, beside those that others hold; empty for all of it.

    Returns:
        The locks; None when a process above this one holds it already.

    Raises:
        DomainError: Another process holds it, or its lock cannot be read.
    """
    name = namespace.strip("/").replace("/", "__")
    files = [(_lock_file(domain), fcntl.LOCK_SH if name else fcntl.LOCK_EX)]
    if name:
        files.append((_lock_file(f"{domain}_{name}"), fcntl.LOCK_EX))
    with ExitStack() as held:
        for file, how in files:
            try:
                held.enter_context(_locked(file, how))
            except PermissionError:
                raise DomainError(
                    f"{file} cannot be read: another user made it; it must be readable for all, "
                    "or removed while nobody uses the domain"
                ) from None
            except BlockingIOError:
                holder = _holder(file)
                if holder in _ancestors():
                    return None
                who = _command(holder) if holder else "another process"
                where = f"namespace {namespace} of DDS domain" if name else "DDS domain"
                raise DomainError(
                    f"{where} {domain} is in use on this machine by {who}; end that, or choose "
                    "another domain: export ROS_DOMAIN_ID=N"
                ) from None
        return held.pop_all()


def ports(domain: int) -> range:
    """UDP ports of a domain."""
    return range(
        FIRST_PORT - 10 + PORTS_PER_DOMAIN * domain,
        FIRST_PORT - 10 + PORTS_PER_DOMAIN * (domain + 1),
    )


def _lock_file(domain: int | str) -> Path:
    return Path(tempfile.gettempdir()) / f"ros_domain_{domain}.lock"


def _locked(path: Path, how: int = fcntl.LOCK_EX) -> IO[str]:
    """A locked file.

    Raises:
        BlockingIOError: Another process holds it.
        OSError: It cannot be opened.
    """
    try:
        file = path.open("a")
        if os.fstat(file.fileno()).st_uid == os.getuid():
            os.fchmod(file.fileno(), 0o644)  # whatever the umask: others must see who holds it
    except PermissionError:  # another user made it: to be read is enough for a lock
        file = path.open()
    try:
        fcntl.flock(file, how | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise
    return file


def _holder(path: Path) -> int:
    """Process that holds a file, as the kernel lists it; 0 where it does not tell."""
    with suppress(OSError):
        inode = path.stat().st_ino
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
