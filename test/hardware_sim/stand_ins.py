# SPDX-License-Identifier: Apache-2.0
"""The stand-ins over DDS, for the tests in this folder."""

from __future__ import annotations

import pytest
from conftest import ROOT, Probe, Processes, diagnosis
from nav_msgs.msg import Path
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from hardware_sim.wam import JOINTS
from wam_power_interfaces.msg import GroundTruth
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.policy import Policy
from wam_power_ros.ros import interface, joint_messages, pose_messages
from wam_power_ros.ros.outcomes import Answer, Code

TICK = 2_000_000  # [ns]
CONFIGS = ("wam_sim.yaml", "optitrack_sim.yaml")
NAMES = list(JOINTS)


def arm_model() -> Arm:
    return Arm((ROOT / "urdf/wam7.urdf").read_text(), NAMES)


class Hardware:
    """The stand-ins in a process, and on request a controller in another.

    Args:
        probe: Node of the test.
        processes: Processes of the test.
        pace: Pace of the stand-ins.
        body: Tracked body of their scene.
        module: Module or script that runs them.
        **parameters: Other parameters of wam_sim.
    """

    def __init__(
        self,
        probe: Probe,
        processes: Processes,
        pace: str,
        body: str = "pancake",
        module: str = "hardware_sim.main",
        **parameters: object,
    ) -> None:
        self.probe, self.processes, self.pace = probe, processes, pace
        self.messages = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
        self.diagnostics = probe.diagnostics()
        self.paths = probe.listen(Path, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
        self.truths = probe.listen(
            GroundTruth, interface.body_topic(body, "truth"), interface.LATCHED
        )
        overrides = {f"wam_sim:{name}": value for name, value in parameters.items()}
        self.process = processes.node(module, *CONFIGS, **{"wam_sim:pace": pace, **overrides})
        self._read = joint_messages.JointStateReader(NAMES)
        probe.until(lambda: self.messages, "the first state")

    def state(self, index: int = -1) -> joint_messages.JointReading:
        """One of the received states."""
        return self._read(self.messages[index])

    def control(self, **parameters: object) -> None:
        """Start the controller, with parameters, and wait until it holds."""
        lockstep = self.pace == "lockstep"
        self.controller = self.processes.node(
            "wam_power_ros.nodes.torque_controller",
            "torque_controller.yaml",
            "simulation.yaml",
            state_timeout=0.0 if lockstep else 0.006,
            idle_service='""',  # an idled arm hangs until somebody lifts it
            move_speed=1.0,
            realtime_priority=0 if lockstep else 60,
            **parameters,
        )
        self.holds()

    def holds(self) -> None:
        """Wait until the controller holds."""
        self.probe.until(self._holds, "the controller holds")

    def _holds(self) -> bool:
        label = self.label()
        if label == "fault" and self.pace == "real_time":  # see `call_until_success`
            self.probe.call(Trigger, interface.RESET)
        return label == "hold"

    def label(self) -> str:
        """Activity of the controller, as the stand-in reports it once a second."""
        return diagnosis(self.diagnostics, "wam_sim").get("label", "")

    def ask(self, do: str, policy: Policy | None = None) -> Answer:
        """Send a goal and wait for its outcome."""
        return self.probe.answer(self.probe.ask(do, policy))

    def free(self) -> None:
        """Begin gravity compensation, once the torque that holds the arm is known."""
        request = SetBool.Request(data=True)
        self.probe.until(
            lambda: self.probe.call(SetBool, interface.GRAVITY_COMPENSATION, request).success,
            "gravity compensation",
        )

    def give_back(self) -> None:
        """End gravity compensation."""
        request = SetBool.Request(data=False)
        assert self.probe.call(SetBool, interface.GRAVITY_COMPENSATION, request).success

    def call_until_success(self, do: str, policy: Policy | None = None) -> Answer:
        """Send a goal until it succeeds.

        In real time a busy machine may cause a fault, which is reset as by an operator.
        """
        answers = []

        def agreed() -> bool:
            answers.append(self.ask(do, policy))
            if answers[-1].success:
                return True
            fault = answers[-1].code is Code.FAULT or self.label() == "fault"
            if fault and self.pace == "real_time":
                self.probe.call(Trigger, interface.RESET)
            self.probe.spin(0.05)
            return False

        try:
            self.probe.until(agreed, do)
        except pytest.fail.Exception:
            pytest.fail(f"{do} was refused to the end: {answers[-1:]}, {self.label()}")
        return answers[-1]

    def rollout(
        self, policy: Policy, pauses: tuple[float, float]
    ) -> tuple[Path, dict[str, object]]:
        """One rollout, with pauses [s of wall time] before and after the reset."""
        self.paths.clear()
        self.truths.clear()
        self.call_until_success("move_to_start", policy)
        self.probe.spin(pauses[0])
        self.call_until_success("reset", policy)
        self.probe.spin(pauses[1])
        self.call_until_success("execute", policy)
        self.probe.until(lambda: self.paths and self.truths, "path and truth", deadline=60.0)
        return self.paths[0], pose_messages.ground_truth(self.truths[0]).values
