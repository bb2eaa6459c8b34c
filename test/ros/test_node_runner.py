# SPDX-License-Identifier: Apache-2.0
"""A process started after a killed one does not take its place among the ports."""

import os
import socket
from contextlib import closing

import pytest
import rclpy

from wam_power_ros.ros.node_runner import FIRST, PER_DOMAIN, PER_PARTICIPANT, number_by_process


def free(port: int) -> bool:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as tried:
        try:
            tried.bind(("", port))
        except OSError:
            return False
        return True


@pytest.mark.requirement("S-68")
@pytest.mark.parametrize(("process", "number"), [(1600, 0), (1603, 4), (1605, 5), (1622, 6)])
def test_a_participant_is_numbered_by_its_process_and_keeps_no_other_port(
    process: int, number: int, domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = FIRST + PER_DOMAIN * domain_id
    taken = first + PER_PARTICIPANT * 3
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    monkeypatch.setattr(os, "getpid", lambda: process)
    context = rclpy.Context()
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other:
        other.bind(("", taken))
        rclpy.init(context=context)
        try:
            with number_by_process():
                node = rclpy.create_node("numbered", context=context)
            ports = [first + PER_PARTICIPANT * k for k in range(16)]
            mine = [port for port in ports if not free(port) and port != taken]
            assert mine == [first + PER_PARTICIPANT * number]
            node.destroy_node()
        finally:
            rclpy.shutdown(context=context)
