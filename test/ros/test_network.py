# SPDX-License-Identifier: Apache-2.0
"""No process is reachable from the network unless the environment asks for it; none is deaf."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import Probe, Process, Processes
from rclpy.qos import QoSProfile
from std_msgs.msg import Int64

from wam_power_ros.params.resources import share
from wam_power_ros.ros import network
from wam_power_ros.ros.network import RANGE, restrict_to_loopback, wider_reach

PROFILE, PROFILE_HERE, OURS = *network.profile()[:2], network.profile().path
MEMORY = Path("/dev/shm")
SERVE = """
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger
from wam_power_ros.ros import interface, node_runner
def make():
    node = Node("server")
    node.create_subscription(String, "/commands", lambda message: None, interface.COMMAND)
    node.create_service(Trigger, "/reset", lambda _, response: response)
    node.create_timer(0.05, lambda: print("serving", flush=True))  # once the node is complete
    return node
raise SystemExit(node_runner.run(make))
"""
ECHO = """
import os
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Int64
from wam_power_ros.ros import node_runner
def make():
    node = Node("echo")
    publisher = node.create_publisher(Int64, "/echo", QoSProfile(depth=10))
    def answer(message):
        publisher.publish(Int64(data=os.getpid()))
    node.create_subscription(Int64, "/numbers", answer, QoSProfile(depth=10))
    return node
raise SystemExit(node_runner.run(make))
"""
REACH = """
import time
import rclpy
from std_msgs.msg import String
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("stranger")
publisher = node.create_publisher(String, "/commands", 1)
client = node.create_client(Trigger, "/reset")
end = time.monotonic() + 3.0
found = (0, False)
while time.monotonic() < end and found != (1, True):
    time.sleep(0.05)
    found = (publisher.get_subscription_count(), client.service_is_ready())
print("matched", *found)
rclpy.shutdown()
"""


@pytest.mark.requirement("S-56")
@pytest.mark.parametrize(
    "given", [{}, {RANGE: ""}, {RANGE: "LOCALHOST"}, {"ROS_STATIC_PEERS": "127.0.0.1;localhost"}]
)
def test_where_nothing_is_asked_for_the_loopback_interface_is_chosen(given: dict[str, str]) -> None:
    environment = dict(given)
    restrict_to_loopback(environment)
    assert (environment[RANGE], environment[PROFILE]) == ("SYSTEM_DEFAULT", OURS)
    chosen = dict(environment)
    restrict_to_loopback(environment)  # in a child process
    assert environment == chosen


@pytest.mark.requirement("S-56")
@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({RANGE: "SUBNET"}, "SUBNET"),
        ({RANGE: "SYSTEM_DEFAULT"}, "SYSTEM_DEFAULT"),
        ({RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.7"}, "ROS_STATIC_PEERS=10.0.0.7"),
        ({"ROS_DISCOVERY_SERVER": "10.0.0.7:11811"}, "ROS_DISCOVERY_SERVER"),
        ({PROFILE: "/etc/mine.xml"}, "/etc/mine.xml"),
        ({network.FAST_DDS_2.variable: "/etc/old.xml"}, "/etc/old.xml"),
        ({RANGE: "SUBNET", network.TRANSPORTS: "DEFAULT"}, "SUBNET"),
    ],
)
def test_what_is_asked_for_wins_and_is_named(given: dict[str, str], reason: str) -> None:
    above = {RANGE: "SYSTEM_DEFAULT", PROFILE: OURS}  # as set by a parent process
    changed = {RANGE: "SYSTEM_DEFAULT"}.items() <= given.items() or PROFILE in given
    for inherited in ({},) if changed else ({}, above):
        environment = inherited | given
        restrict_to_loopback(environment)
        assert environment == {RANGE: "LOCALHOST", network.TRANSPORTS: "UDPv4", **given}
        assert reason in (wider_reach(environment) or "")


@pytest.mark.requirement("S-56")
def test_a_profile_in_the_working_directory_wins_and_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / PROFILE_HERE).write_text("<dds/>")
    environment: dict[str, str] = {}
    restrict_to_loopback(environment)
    assert PROFILE_HERE in (wider_reach(environment) or "")


@pytest.mark.requirement("S-56")
def test_another_middleware_is_named_whatever_the_environment_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(network, "middleware", lambda: "rmw_zenoh_cpp")
    environment = {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}
    restrict_to_loopback(environment)
    assert PROFILE not in environment
    assert "rmw_zenoh_cpp" in (wider_reach(environment) or "")


@pytest.mark.requirement("S-56")
def test_the_profiles_of_both_versions_differ_in_one_word() -> None:
    second, third = (
        share(version.ours).read_text().partition("<dds")[2]
        for version in (network.FAST_DDS_2, network.FAST_DDS_3)
    )
    assert "heartbeatPeriod" in second
    assert second.replace("heartbeatPeriod", "heartbeat_period") == third


def served(processes: Processes, *before: str, **environment: str) -> Process:
    """Start a node, and wait until it is ready or has ended."""
    process = processes.start([*before, sys.executable, "-c", SERVE], **environment)
    while "serving" not in processes.output(process) and process.poll() is None:
        time.sleep(0.02)
    return process


@pytest.fixture(scope="module")
def reaching(shared_nodes: tuple[Probe, Processes]) -> dict[str, Process]:
    """A node for each range of discovery."""
    _, processes = shared_nodes
    return {asked: served(processes, **{RANGE: asked}) for asked in ("LOCALHOST", "SUBNET")}


def bound_addresses(process: int) -> list[str]:
    """Addresses to which UDP sockets (IPv4) of a process are bound."""
    inodes = {os.readlink(file) for file in Path(f"/proc/{process}/fd").iterdir()}
    lines = Path("/proc/self/net/udp").read_text().splitlines()[1:]
    found = [line.split()[1] for line in lines if f"socket:[{line.split()[9]}]" in inodes]
    return [socket.inet_ntoa(bytes.fromhex(each[:8])[::-1]) for each in found]


@pytest.mark.requirement("S-56")
@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_every_socket_of_a_node_is_bound_to_the_loopback_interface(
    reaching: dict[str, Process],
) -> None:
    addresses = bound_addresses(reaching["LOCALHOST"].pid)
    assert len(addresses) >= 2
    assert [each for each in addresses if not each.startswith("127.")] == []
    assert any(each.startswith("0.0.0.0") for each in bound_addresses(reaching["SUBNET"].pid))


@pytest.mark.requirement("S-68")
@pytest.mark.skipif(not MEMORY.is_dir(), reason="no /dev/shm")
def test_a_node_uses_no_shared_memory_of_the_middleware(
    reaching: dict[str, Process], processes: Processes
) -> None:
    def segments(process: Process) -> set[str]:
        words = Path(f"/proc/{process.pid}/maps").read_text().split()
        names = tuple(str(MEMORY / name) for name in ("fastrtps", "fastdds"))
        return {word for word in words if word.startswith(names)}

    assert segments(reaching["LOCALHOST"]) == segments(reaching["SUBNET"]) == set()
    # a person who asks for it gets it
    assert segments(served(processes, **{RANGE: "SUBNET", network.TRANSPORTS: "DEFAULT"})) != set()


@pytest.mark.requirement("S-68")
def test_a_node_started_after_a_killed_one_hears_and_is_heard(
    probe: Probe, processes: Processes
) -> None:
    heard = probe.listen(Int64, "/echo", QoSProfile(depth=10))
    numbers = probe.node.create_publisher(Int64, "/numbers", QoSProfile(depth=10))
    for _ in range(3):
        node = processes.start([sys.executable, "-c", ECHO])

        def answered(process: int = node.pid) -> bool:
            numbers.publish(Int64(data=1))
            return any(message.data == process for message in heard)

        probe.until(answered, "an answer of the node")
        processes.end(node, signal.SIGKILL)


@pytest.fixture
def networks() -> Iterator[tuple[str, str]]:
    """Two network namespaces with a cable between them; the first has 10.213.7.1."""
    names = [f"wampower{os.getpid()}{end}" for end in "ab"]
    links = [f"wp{os.getpid() % 10**7}{end}" for end in "ab"]

    def ip(*words: str) -> None:
        subprocess.run(["ip", *words], check=True, capture_output=True)

    try:
        for name in names:
            ip("netns", "add", name)
        (here, there), (link, other) = names, links
        cable = f"link add {link} netns {here} type veth peer name {other} netns {there}"
        ip(*cable.split())
        for number, (name, link) in enumerate(zip(names, links, strict=True), start=1):
            ip("-n", name, "addr", "add", f"10.213.7.{number}/24", "dev", link)
            ip("-n", name, "link", "set", link, "up")
            ip("-n", name, "link", "set", "lo", "up")
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no network namespaces here: {error}")
    else:
        yield names[0], names[1]
    finally:
        for name in names if shutil.which("ip") else ():
            subprocess.run(["ip", "netns", "delete", name], capture_output=True)


@pytest.mark.requirement("S-56")
def test_from_another_network_nothing_matches_and_no_service_answers(
    networks: tuple[str, str], processes: Processes
) -> None:
    here, there = (["ip", "netns", "exec", name] for name in networks)

    def matched() -> str:
        reaching = processes.start(
            [*there, sys.executable, "-c", REACH],
            **{RANGE: "SUBNET", PROFILE: "", "ROS_STATIC_PEERS": "10.213.7.1"},
        )
        assert reaching.wait(60.0) == 0
        return processes.output(reaching).splitlines()[-1]

    confined = served(processes, *here, **{RANGE: "LOCALHOST"})
    assert matched() == "matched 0 False"
    processes.end(confined)
    served(processes, *here, **{RANGE: "SUBNET"})  # the cable works
    assert matched() == "matched 1 True"
