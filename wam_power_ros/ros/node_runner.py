# SPDX-License-Identifier: Apache-2.0
"""Ports of Fast DDS: a process started after a killed one should not take its place.

Fast DDS gives a process the lowest participant number that is free, and with it its ports: after a
kill (-9) those of the killed one. The others still send there for 20 s, through shared memory, and
now and then one of them takes that port for dead and deletes it under the new listener, which then
hears no message and no answer for as long as it lives (Fast DDS, pull requests 4728 and 4737; open
in the 2.14 of Jazzy; seen in one to ten of a hundred restarts). Under
ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST shared memory cannot be switched off.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

FIRST, PER_DOMAIN, PER_PARTICIPANT = 7410, 250, 2  # ports of discovery (RTPS 2.2, 9.6.1.1)
SPREAD = 16  # of the 32 numbers that are looked for within LOCALHOST, the rest for who comes later


@contextmanager
def number_by_process() -> Iterator[None]:
    """While a process makes its first node: lets the numbers begin at its process id modulo SPREAD.

    The lower ones that are free are bound meanwhile, and pass for those of living processes.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    first = FIRST + PER_DOMAIN * (int(domain) if domain.isdigit() else 0)
    with ExitStack() as held:
        for number in range(os.getpid() % SPREAD):
            place = held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            with suppress(OSError):  # somebody's
                place.bind(("", first + PER_PARTICIPANT * number))
        yield
