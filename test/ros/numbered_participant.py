# SPDX-License-Identifier: Apache-2.0
"""Makes one node under a given process id, and prints the ports expected and found, as JSON.

A process of its own: the middleware counts the participants of a process across all domains.
"""

from __future__ import annotations

import json
import os
import socket
import sys
from contextlib import closing, suppress

import rclpy

from wam_power_ros.ros.node_runner import (
    FIRST_PORT,
    NUMBER_SPREAD,
    PORTS_PER_DOMAIN,
    PORTS_PER_PARTICIPANT,
    number_by_process,
)


def free(port: int) -> bool:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as tried:
        try:
            tried.bind(("", port))
        except OSError:
            return False
        return True


def main(process: int) -> tuple[int, list[int]]:
    """Port that a participant should take, and those that it took; the fourth is in use."""
    first = FIRST_PORT + PORTS_PER_DOMAIN * int(os.environ["ROS_DOMAIN_ID"])
    ports = [first + PORTS_PER_PARTICIPANT * k for k in range(32)]
    rclpy.init()
    os.getpid = lambda: process
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other:
        with suppress(OSError):  # already bound by another program, which does as well
            other.bind(("", ports[3]))
        taken = [port for port in ports if not free(port)]
        assert ports[3] in taken
        with number_by_process():
            node = rclpy.create_node("numbered")
        mine = [port for port in ports if not free(port) and port not in taken]
        node.destroy_node()
    rclpy.shutdown()
    return next(port for port in ports[process % NUMBER_SPREAD :] if port not in taken), mine


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(int(sys.argv[1]))))
