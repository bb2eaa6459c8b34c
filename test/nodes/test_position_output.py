# SPDX-License-Identifier: Apache-2.0
"""Positions and poses over DDS: each kind of message, an interrupted rollout, a dead driver."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Probe, Processes, lift
from sensor_msgs.msg import JointState

from wam_power_ros.learning.policy import Policy
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, joint_messages

NAMES = [f"wam_j{i}" for i in range(1, 8)]
FILES = ("torque_controller.yaml", "simulation.yaml")


class PositionArm:
    """Stand-in and controller of an arm that takes positions, with what each says."""

    def __init__(
        self, probe: Probe, processes: Processes, pace: str, output: str, kind: str = "multiarray"
    ) -> None:
        self.probe, self.processes = probe, processes
        message = joint_messages.COMMAND_TYPES[kind if output == "position" else output]
        topic = interface.EFFORT_COMMANDS
        self.states = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
        self.sent = probe.listen(message, topic, interface.DEEP_IN)
        lockstep = pace == "lockstep"
        common = {"output": output, "command_type": kind}
        stand_in = {"pace": pace, "command_delay_ticks": 20, "servo_lag": 0.02, **common}
        stand_in["listeners"] = "[probe]"
        self.driver = processes.node(
            "hardware_sim.main",
            *("wam_sim.yaml", "optitrack_sim.yaml"),
            **{f"wam_sim:{name}": value for name, value in stand_in.items()},
        )
        probe.until(lambda: self.states, "the first state", 15.0)
        self.controller = processes.node(
            "wam_power_ros.nodes.torque_controller",
            *FILES,
            state_timeout=0.0 if lockstep else 0.01,
            idle_service='""',
            move_speed=1.0,
            realtime_priority=0 if lockstep else 60,
            set_point_period=0.0 if lockstep and output != "pose" else 0.008,  # the probe keeps up
            **common,
        )

    def q(self, index: int = -1) -> np.ndarray:
        """Reported posture [rad]."""
        return np.array(self.states[index].position)

    def references(self) -> list[joint_messages.TorqueReading]:
        """Positions that were sent."""
        return [joint_messages.torque(message, NAMES, "wam_base") for message in self.sent]

    def move(self, policy: Policy) -> None:
        """Begin a rollout, and wait until the arm moves in it."""
        self.probe.call_until_success("move_to_start", policy)
        self.probe.ask("execute", policy)
        start = self.q()
        self.probe.until(lambda: np.abs(self.q() - start).max() > 0.02, "the rollout moves")


@pytest.mark.parametrize(
    ("output", "kind"),
    [  # positions in an array: below
        ("position", "joint_state"),
        ("trajectory", "multiarray"),
        ("pose", "multiarray"),
    ],
)
def test_a_rollout_by_positions_ends_as_by_torques_with_each_kind_of_message(
    probe: Probe, processes: Processes, output: str, kind: str
) -> None:
    arm = PositionArm(probe, processes, "lockstep", output, kind)
    policy = lift("lifted")
    probe.call_until_success("move_to_start", policy)
    assert probe.answer(probe.ask("execute", policy)).success
    sent = np.array([each.tau for each in arm.references()])
    assert np.ptp(sent, axis=0).max() > 0.05
    assert np.abs(np.diff(sent, axis=0)).max() < 0.02
    if output == "trajectory":
        assert arm.sent[-1].points[0].time_from_start.nanosec == 2_000_000
        assert arm.sent[-1].header.stamp.sec == 0


@pytest.mark.alone
@pytest.mark.requirement("S-151")
@pytest.mark.parametrize(
    ("ended", "output"), [("controller", "position"), ("driver", "position"), ("driver", "pose")]
)
def test_an_interrupted_controller_and_a_dead_driver_leave_references_at_rest(
    probe: Probe,
    processes: Processes,
    ended: str,
    output: str,
    record_property: Any,  # noqa: ANN401
) -> None:
    arm = PositionArm(probe, processes, "real_time", output)
    arm.move(lift("cut-short"))
    count, begun = len(arm.sent), arm.references()[-1].tau
    state = len(arm.states)
    process = arm.controller if ended == "controller" else arm.driver
    process.send_signal(signal.SIGINT if ended == "controller" else signal.SIGKILL)
    probe.spin(1.5)
    sent = np.array([each.tau for each in arm.references()[count - 1 :]])
    steps = np.abs(np.diff(sent, axis=0)).max(axis=1)
    assert steps.max() < 0.02
    moved = np.flatnonzero(steps > 1e-6)
    figures = {"way [rad, m]": float(np.abs(sent[-1] - begun).max())}
    figures["messages until rest"] = int(moved[-1]) + 1 if len(moved) else 0
    assert figures["way [rad, m]"] < 0.3
    assert figures["messages until rest"] < 100
    if ended == "controller":
        q = np.array([message.position for message in arm.states[state:]])
        assert np.abs(q[-1] - sent[-1]).max() < 0.01
        still = np.abs(q - q[-1]).max(axis=1) < 0.002
        figures["states until the arm rests"] = int(np.flatnonzero(~still)[-1]) + 1
        figures["way of the arm [rad]"] = float(np.abs(q[-1] - q[0]).max())
    else:
        assert output == "pose" or arm.references()[-1].label == "fault"  # a pose has no label
    for name, value in figures.items():
        record_property(name, value)


@pytest.mark.alone
@pytest.mark.requirement("S-151")
@pytest.mark.parametrize("ended", ["controller", "driver"])
@pytest.mark.parametrize("names", [("ur", "position"), ("gen3",), ("xarm7",)])
def test_the_references_of_each_arm_rest_when_its_controller_or_driver_ends(
    names: tuple[str, ...],
    ended: str,
    probe: Probe,
    processes: Processes,
    tmp_path: Path,
    record_property: Any,  # noqa: ANN401
) -> None:
    setup = overlay.setup([*names, "full_speed"], simulated=True, task="reach")
    setup = setup.changed({"wam_sim": {"pace": "real_time", "listeners": ["probe"]}})
    (file := tmp_path / "parameters.yaml").write_text(overlay.text(setup))
    taken, stand_in = setup["torque_controller"], setup["wam_sim"]
    joints, base = taken["joint_names"], taken["base_frame"]
    message = joint_messages.COMMAND_TYPES[
        taken["command_type"] if taken["output"] == "position" else taken["output"]
    ]
    states = probe.listen(JointState, taken["state_topic"], interface.STATE_RECORD)
    sent = probe.listen(message, taken["command_topic"], interface.DEEP_IN)
    driver = processes.node("hardware_sim.main", file)
    probe.until(lambda: states, "the first state", 15.0)
    controller = processes.node("wam_power_ros.nodes.torque_controller", file)
    policy = lift("cut-short", setup.arm(), stand_in["home"])
    probe.call_until_success("move_to_start", policy)
    probe.ask("execute", policy)
    start = np.array(states[-1].position)
    probe.until(lambda: np.abs(states[-1].position - start).max() > 0.02, "the rollout moves")
    count, state = len(sent), len(states)
    process = controller if ended == "controller" else driver
    process.send_signal(signal.SIGINT if ended == "controller" else signal.SIGKILL)
    probe.spin(1.5)
    references = [joint_messages.torque(each, joints, base).tau for each in sent[count - 1 :]]
    steps = np.abs(np.diff(references, axis=0)).max(axis=1)
    moved = np.append(0, np.flatnonzero(steps > 1e-6) + 1)[-1]
    period = taken["set_point_period"] or taken["period"]
    figures = {"way [rad]": np.abs(references[-1] - references[0]).max()}
    figures |= {"rest after [s]": moved * period, "largest step [rad]": steps.max()}
    if ended == "controller":
        order = [states[0].name.index(name) for name in joints]
        q = np.array([each.position for each in states[state:]])[:, order]
        figures |= {"way of the arm [rad]": np.abs(q[-1] - q[0]).max()}
        assert np.abs(q[-1] - references[-1]).max() < 0.01
    for name, value in figures.items():
        record_property(name, float(value))
    assert figures["largest step [rad]"] < 0.02
    assert figures["way [rad]"] < 0.3
    assert figures["rest after [s]"] < 0.4
