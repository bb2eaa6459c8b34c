# SPDX-License-Identifier: Apache-2.0
"""False states and shutdown in motion, over DDS with the node in a process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import Probe, Processes
from played_arm import HOME, NAMES, PlayedArm
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from benchmark.false_states import FALSE_STATES
from benchmark.hidden_arm import StandIn
from benchmark.lab import Driver, Lab, inject
from wam_power_ros.control.safety import REST_SPEED
from wam_power_ros.faults import FaultKind
from wam_power_ros.ros import interface


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with Lab(tmp_path).open() as lab:
        yield lab


@pytest.mark.alone
@pytest.mark.requirement("S-91")
@pytest.mark.parametrize("kind", ["velocities negated", "the same state again and again"])
def test_an_arm_that_keeps_the_last_torque_is_stopped_when_its_states_turn_false(
    lab: Lab, kind: str
) -> None:
    driver = Driver(lab, StandIn())
    outcomes = []
    for _ in range(3):  # on a busy processor it brakes late or not at all
        controller = lab.controller(priority=0)
        outcomes.append(inject(driver, lab, "upwards", FALSE_STATES[kind]()))
        assert outcomes[-1].noticed is not None
        if outcomes[-1].rest < REST_SPEED:
            return
        lab.end(controller)
    raise AssertionError(outcomes)


@pytest.mark.alone
@pytest.mark.requirement("S-05")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_controller_that_is_ended_in_a_rollout_stops_the_arm_first(lab: Lab, number: int) -> None:
    driver = Driver(lab, StandIn())
    seen = []
    for _ in range(10):  # on a busy processor it brakes late or not at all
        controller = lab.controller(priority=0)
        driver.begin("upwards")
        if driver.speeds[-1] < REST_SPEED:  # a busy machine has caused a fault
            lab.end(controller)
            continue
        controller.process.send_signal(number)
        assert driver.play(20.0, lambda: controller.process.poll() is not None)  # noqa: B023
        driver.speeds.clear()
        driver.play(0.5)
        assert lab.label == "inactive"
        off = np.abs(lab.torques[-1][1].tau - driver.plant.gravity()).max()
        lab.end(controller)
        seen.append((max(driver.speeds), off))
        if max(driver.speeds) < REST_SPEED and off < 0.5:
            return
    pytest.fail(f"never at rest: speed [m/s] and torque off g(q) [N m] {seen}")


@pytest.mark.alone
@pytest.mark.requirement("S-53")
def test_a_cut_network_is_a_fault_that_stays_when_it_is_back(tmp_path: Path) -> None:
    if subprocess.run(
        ["unshare", "-n", "ip", "link", "show", "lo"], capture_output=True
    ).returncode:
        pytest.skip("no network namespace for us here")
    here = Path(__file__).parent
    up = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "
    command = f"{sys.executable} {here / 'cut_network.py'} {tmp_path}"
    environment = os.environ | {  # without shared memory, which a cut network would not stop
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "PYTHONPATH": os.pathsep.join([str(here.parents[1]), os.environ.get("PYTHONPATH", "")]),
    }
    done = subprocess.run(
        ["unshare", "-n", "sh", "-c", up + command],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.stdout.splitlines()[-1:] == ["['fault'] hold"], (done.stdout, done.stderr)


@pytest.mark.requirement("S-94")
def test_a_velocity_topic_that_falls_silent_is_a_fault(probe: Probe, processes: Processes) -> None:
    arm = PlayedArm(probe, processes, velocity_topic="/velocities", state_timeout=0.02)
    velocities = probe.publisher(JointState, "/velocities", interface.STATE_OUT)

    def played(speeds: bool) -> str:
        for _ in range(10):
            if speeds:
                velocities.publish(JointState(name=NAMES, velocity=[0.0] * 7))
            arm.send(q=HOME, qd=np.empty(0))
            probe.spin(0.001)
        torques = arm.read()
        return torques[-1].label if torques else ""

    def held() -> bool:
        label = played(True)
        if label == "fault":  # caused by a delay of a busy machine
            probe.call(Trigger, interface.RESET)
        return label == "hold"

    probe.until(held, "the arm is held")
    probe.until(lambda: played(False) == "fault", "the fault")
    kinds = {FaultKind.VELOCITY.value, FaultKind.STATES_LOST.value}  # or of a busy machine
    assert arm.diagnosis(lambda d: d["mode"] == "fault", "it")["fault kind"] in kinds
