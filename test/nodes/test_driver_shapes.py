# SPDX-License-Identifier: Apache-2.0
"""Every driver with a set-up: a stand-in with its topics, under our controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Probe, Processes, diagnosis, lift
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.learning.policy import Policy
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, joint_messages, pose_messages
from wam_power_ros.ros.stamps import sensor_stamp

IN_STEP = "wam_sim: {ros__parameters: {pace: lockstep}}"  # at any speed of the machine


class Rehearsal:
    """The stand-ins under set-ups."""

    def __init__(self, probe: Probe, processes: Processes, folder: Path, *names: str) -> None:
        over = folder / "over.yaml"
        over.write_text(IN_STEP)
        self.probe, self.processes = probe, processes
        self.setup = overlay.setup([*names, str(over)], simulated=True)
        self.file = folder / "parameters.yaml"
        self.file.write_text(overlay.text(self.setup))
        arm = self.setup["torque_controller"]
        self.states = probe.listen(JointState, arm["state_topic"], interface.STATE_OUT)
        self.diagnostics = probe.diagnostics()
        processes.node("hardware_sim.main", self.file)
        probe.until(lambda: self.states, "a state")

    def execute(self, policy: Policy) -> pose_messages.PathReading:
        """The path of a rollout of this policy, by a controller that is started for it."""
        paths = self.probe.listen(PathMessage, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
        self.processes.node("wam_power_ros.nodes.torque_controller", self.file)
        self.probe.call_until_success("move_to_start", policy)
        self.probe.call_until_success("reset", policy)
        self.probe.call_until_success("execute", policy)
        message = self.probe.until(lambda: paths and paths[-1], "the path")
        return pose_messages.path(message)


@pytest.mark.parametrize("name", ["geodude", "libbarrett"])
@pytest.mark.long
def test_a_rollout_is_the_same_through_every_driver(
    name: str, probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Rehearsal(probe, processes, tmp_path, name, "full_speed")
    arm = bench.setup["torque_controller"]
    speeds = probe.listen(JointState, "/wam/jointVelocity", interface.STATE_OUT)
    path = bench.execute(lift("trial-0001"))
    assert path.t[-1] == pytest.approx(1.4)
    height = path.position[:, 2] - path.position[0, 2]
    assert 0.02 < height.max() < 0.08
    assert abs(height[-1]) < 0.01
    # and its topics were those of that driver
    seen = {tuple(state.name) for state in bench.states}
    others = tuple(bench.setup["wam_sim"]["other_joints"])
    assert seen - {others} == {tuple(arm["joint_names"])}
    assert (others in seen) == (name == "geodude")
    assert all(len(state.velocity) == 0 for state in bench.states) == (name == "libbarrett")
    assert bool(speeds) == (name == "libbarrett")
    assert all(not list(speed.name) and len(speed.velocity) == 7 for speed in speeds)


def test_a_driver_that_is_set_to_do_so_ends_with_a_command_of_a_wrong_size(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    more = tmp_path / "deactivates.yaml"
    more.write_text("wam_sim: {ros__parameters: {deactivates: true}}")
    bench = Rehearsal(probe, processes, tmp_path, "geodude", str(more))
    torques = probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)

    def doing() -> str:
        return diagnosis(bench.diagnostics, "wam_sim").get("message", "")

    probe.until(lambda: doing() == "commanded", "the driver at work")
    torques.publish(Float64MultiArray(data=[np.nan] * 7))  # dropped without a fault
    probe.until(
        lambda: diagnosis(bench.diagnostics, "wam_sim").get("torques refused") == "1", "a refusal"
    )
    assert doing() == "commanded"
    torques.publish(Float64MultiArray(data=[0.0] * 6))
    probe.until(lambda: doing() == "deactivated", "the driver deactivated")
    on = SetBool.Request(data=True)
    assert probe.call(SetBool, interface.WAM_GRAVITY_COMPENSATE, on).success
    probe.until(lambda: doing() == "commanded", "the driver at work again")


def test_an_arm_that_was_idled_is_active_again_once_the_fault_is_reset(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Rehearsal(probe, processes, tmp_path, "libbarrett")
    torques = probe.publisher(JointState, "/joint_torque_commands", interface.COMMAND)
    write = joint_messages.TorqueWriter(bench.setup["wam_sim"]["joint_names"], "joint_state")

    def doing() -> str:
        return diagnosis(bench.diagnostics, "wam_sim").get("message", "")

    def step(label: str) -> None:
        stamp_ns = sensor_stamp(bench.states[-1])
        torques.publish(write(stamp_ns, label, np.zeros(7)))
        probe.until(lambda: sensor_stamp(bench.states[-1]) > stamp_ns, "a step")

    step("fault")
    assert probe.call(Trigger, interface.WAM_IDLE).success
    step("fault")
    probe.until(lambda: doing() == "idle", "the arm idle")
    step("hold")
    probe.until(lambda: doing() == "commanded", "the arm active")
