# SPDX-License-Identifier: Apache-2.0
"""Over DDS: a model without masses is refused, and one that raises ends in a stop at rest."""

from __future__ import annotations

import re
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Probe, Processes, diagnosis
from played_arm import HOME, NAMES, SIMULATED, PlayedArm
from rigid_arm import MODEL, Plant, check, make_policy, tool
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from wam_power_ros.control.safety import REST_SPEED
from wam_power_ros.faults import FaultKind
from wam_power_ros.ros import interface

BREAKING = """
import sys
import numpy as np
from wam_power_ros.control.arm import Arm
from wam_power_ros.nodes import torque_controller
from wam_power_ros.params import torque_controller_params

class Breaking(Arm):
    broken = ()
    def __getattribute__(self, name):
        if name in Breaking.broken:
            raise np.linalg.LinAlgError("Singular matrix")
        return super().__getattribute__(name)

class Node(torque_controller.TorqueController):
    def _on_stop(self, request, response):
        Breaking.broken = ("gravity", "mass_matrix", "bias", "dynamics", "inverse_dynamics",
                           "motion", "speeds")
        return super()._on_stop(request, response)

torque_controller_params.Arm = Breaking
torque_controller.TorqueController = Node
sys.exit(torque_controller.main())
"""
URDF = (ROOT / "urdf/wam7.urdf").read_text()


def massless(folder: Path, links: str) -> Path:
    """A URDF in which the links whose names match have no mass."""
    parts = re.split("(?=<link name=)", URDF)
    bare = re.compile(f'<link name="({links})"')
    kept = [
        re.sub("<inertial>.*?</inertial>", "", part, flags=re.DOTALL) if bare.match(part) else part
        for part in parts
    ]
    (file := folder / "massless.urdf").write_text("".join(kept))
    return file


LAST = ["wam_link6", "wam_link7", "wam_tool_plate", "pan"]


@pytest.mark.requirement("S-111")
def test_the_controller_of_an_arm_without_masses_names_the_links_and_sends_nothing(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    arm = PlayedArm(probe, processes, urdf=str(massless(tmp_path, "wam_link[67]|pan")))

    def refused() -> bool:
        arm.send()
        probe.spin(0.02)
        report = diagnosis(arm.diagnostics, "torque_controller")
        return "move without mass" in report.get("last refusal", "")

    probe.until(refused, "the refusal is reported")
    report = diagnosis(arm.diagnostics, "torque_controller")
    assert f"links {LAST} move without mass" in report["last refusal"]
    assert not arm.read()
    assert arm.process.poll() is None


@pytest.mark.requirement("S-111")
def test_check_driver_names_the_links_that_move_without_mass(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    setup, urdf = tmp_path / "my_arm.yaml", massless(tmp_path, "wam_link[67]|pan")
    setup.write_text(f"torque_controller:\n  ros__parameters:\n    urdf: {urdf}\n")
    check = [sys.executable, "-m", "wam_power_ros.cli", "run", "check_driver"]
    process = processes.start([*check, "--config", str(setup), "--seconds", "1"])
    states = probe.publisher(JointState, interface.JOINT_STATES, interface.STATE_OUT)
    message = JointState(name=NAMES, position=list(HOME), velocity=list(np.zeros(7)))

    def ended() -> bool:
        message.header.stamp = probe.node.get_clock().now().to_msg()
        states.publish(message)
        probe.spin(0.002)
        return process.poll() is not None

    probe.until(ended, "the check ends")
    assert process.returncode == 2
    text = " ".join(processes.output(process).split())
    assert "'wam_link6', 'wam_link7', 'wam_tool_plate', 'pan'] move without mass" in text


@pytest.mark.requirement("S-112")
def test_a_model_that_raises_ends_a_move_at_rest_and_the_node_goes_on(
    probe: Probe, processes: Processes
) -> None:
    config = ["--ros-args"]
    for file in SIMULATED:
        config += ["--params-file", str(ROOT / "config" / file)]
    quick = ["-p", "realtime_priority:=0", "-p", "state_timeout:=0.0"]
    arm = PlayedArm(probe, processes, processes.script(BREAKING, *config, *quick))
    plant = Plant(HOME, delay=1, sensing=True, friction=1.0)
    arm.activate()
    torques = [arm.read()[-1].tau]

    def run(ticks: int) -> list[float]:
        """Speeds of the tool [m/s], a tick each."""
        speeds = []
        for _ in range(ticks):
            _, q, qd = plant.state()
            arm.send(NAMES, q, qd)
            torques.append(arm.answer().tau)
            check(torques[-1], torques[-2])
            plant.step(torques[-1])
            speeds.append(MODEL.speeds(plant.q, plant.qd).tool_speed)
        return speeds

    run(200)
    probe.ask("move_to_start", make_policy(q_start=HOME + 0.4))
    probe.until(lambda: run(1) and arm.read()[-1].label == "move_to_start", "the move")
    nominal = max(run(300))
    assert nominal > 0.1
    probe.begin(Trigger, interface.STOP)
    probe.until(lambda: run(1) and arm.read()[-1].label == "fault", "the fault")
    stopping = run(250)
    assert max(stopping) < nominal + 0.1
    assert stopping[-1] < REST_SPEED
    stopped = tool(plant)
    assert max(run(500)) < REST_SPEED
    assert np.linalg.norm(tool(plant) - stopped) < 0.02
    report = arm.diagnosis(lambda d: d["mode"] == "fault", "the fault is reported")
    assert report["fault kind"] == FaultKind.COMPUTATION.value
    assert "Singular matrix" in report["last refusal"] and "controller.py" in report["last refusal"]
    answer = probe.call(Trigger, interface.RESET)
    assert not answer.success and "no torque could be computed" in answer.message
    assert processes.output(arm.process).count("Singular matrix") < 20  # not one a state
    arm.process.send_signal(signal.SIGTERM)
    probe.until(lambda: arm.process.poll() is not None, "the end of the node")
    assert arm.process.returncode == 0
