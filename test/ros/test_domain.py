# SPDX-License-Identifier: Apache-2.0
"""DDS domains: one process of this machine holds each; a simulation never takes a robot's."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from conftest import ROOT, python_path

from wam_power_ros.ros import domain
from wam_power_ros.ros.domain import DomainError, exported, lock, ports, private_domain, shared

HOLD = """
import sys
from wam_power_ros.ros.domain import lock
held = lock(int(sys.argv[1]))
print(held is None, flush=True)
sys.stdin.readline()
"""


def holder(number: int, **environment: str) -> subprocess.Popen[str]:
    """A process that holds a domain until its input ends."""
    return subprocess.Popen(
        [sys.executable, "-c", HOLD, str(number)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": python_path()} | environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[tuple[int, int]]:
    """The only two private domains in this test: held against the machine, free for the test."""
    with private_domain() as one, private_domain() as other:
        monkeypatch.setenv("TMPDIR", str(tmp_path))  # of the locks, also in the processes below
        monkeypatch.setattr(tempfile, "tempdir", None)
        monkeypatch.setattr(domain, "PRIVATE_DOMAINS", (one, other))
        monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
        yield one, other


@pytest.mark.requirement("S-55")
def test_two_simulations_on_one_machine_get_different_domains(two: tuple[int, int]) -> None:
    with private_domain() as one, private_domain() as other:
        assert {one, other} == set(two)
        with pytest.raises(DomainError, match="is in use on this machine"), private_domain():
            pass


@pytest.mark.requirement("S-55")
def test_a_simulation_never_gets_the_domain_that_is_exported(
    two: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(two[0]))
    for _ in range(8):
        with private_domain() as taken:
            assert taken == two[1]


@pytest.mark.requirement("S-55")
def test_a_domain_in_which_somebody_is_is_not_taken(two: tuple[int, int]) -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as somebody:
        somebody.bind(("127.0.0.1", ports(two[0])[12]))
        for _ in range(8):
            with private_domain() as taken:
                assert taken == two[1]


@pytest.mark.requirement("S-55")
def test_a_domain_has_one_holder_and_is_shared_with_the_processes_that_it_starts(
    two: tuple[int, int],
) -> None:
    with private_domain() as taken:
        below = holder(taken, **shared(taken))
        assert below.communicate("")[0] == "True\n"
        other = holder(taken, **shared(taken + 1))  # of the holder of another domain
        assert other.communicate("")[0] == ""
    other = holder(two[0])
    assert other.stdout is not None and other.stdout.readline() == "False\n"
    with pytest.raises(DomainError, match=f"domain {two[0]} is in use .*fuser .*_{two[0]}.lock"):
        lock(two[0])
    other.communicate("")
    free = lock(two[0])  # the kernel ends the lock with its process
    assert free is not None
    free.close()


def test_a_lock_is_readable_for_other_users_and_one_that_is_not_is_named(
    two: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = Path(tempfile.gettempdir()) / f"ros_domain_{two[0]}.lock"
    file.touch(0o600)  # as of a user with umask 077
    held = lock(two[0])
    assert held is not None
    held.close()
    assert file.stat().st_mode & 0o444 == 0o444

    def theirs(path: Path, how: int) -> object:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(domain, "_locked", theirs)
    with pytest.raises(
        DomainError, match=re.escape(f"{file} cannot be read: it belongs to another user")
    ):
        lock(two[0])


def test_the_exported_domain_is_read_as_ros_does_and_what_is_none_refused_by_its_name() -> None:
    named = [exported({"ROS_DOMAIN_ID": text}) for text in ("", " 7 ", "232")]
    assert [exported({}), *named] == [0, 0, 7, 232]
    for text in ("233", "-1", "1.0", "٣"):
        with pytest.raises(DomainError, match=r"ROS_DOMAIN_ID='.*' is not a whole number"):
            exported({"ROS_DOMAIN_ID": text})
