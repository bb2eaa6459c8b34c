# SPDX-License-Identifier: Apache-2.0
"""Each driver of an arm we are set up for: a stand-in of its shape, driven by our controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Probe, Processes, diagnosis, lift
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path as PathMessage
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from wam_power_ros import interface, setups
from wam_power_ros.policy import Policy, to_json
from wam_power_ros.rollout import EndEffectorPath

IN_STEP = "wam_sim: {ros__parameters: {pace: lockstep}}"  # the machine may take its time


class Rehearsal:
    """The stand-ins under set-ups."""

    def __init__(self, probe: Probe, processes: Processes, folder: Path, *names: str) -> None:
        over = folder / "over.yaml"
        over.write_text(IN_STEP)
        self.probe, self.processes = probe, processes
        self.setup = setups.setup([*names, str(over)], rehearse=True)
        self.file = folder / "parameters.yaml"
        self.file.write_text(setups.text(self.setup))
        arm = self.setup["torque_controller"]
        self.states = probe.listen(JointState, arm["state_topic"], interface.STATE_OUT)
        self.diagnostics = probe.listen(
            DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS
        )
        processes.node("hardware_sim.wam_node", self.file)
        probe.until(lambda: self.states, "a state")

    def insist(self, name: str, policy: Policy, policies: Publisher) -> None:
        """Call a service until it has done it for this policy."""

        def done() -> bool:
            policies.publish(String(data=to_json(policy)))
            answer = self.probe.call(Trigger, name)
            self.probe.spin(0.0 if answer.success else 0.1)
            return answer.success and answer.message == policy.id

        self.probe.until(done, name)


@pytest.mark.parametrize("name", ["geodude", "libbarrett", "franka"])
def test_a_rollout_is_the_same_through_every_driver(
    name: str, probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Rehearsal(probe, processes, tmp_path, name, "full_speed")
    arm = bench.setup["torque_controller"]
    speeds = probe.listen(JointState, "/wam/jointVelocity", interface.STATE_OUT)
    paths = probe.listen(PathMessage, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
    processes.node("wam_power_ros.nodes.torque_controller", bench.file)
    policies = probe.publisher(String, interface.POLICY, interface.LATCHED)
    policy = lift("trial-0001")
    for service in (interface.MOVE_TO_START, interface.PANCAKE_RESET, interface.EXECUTE):
        bench.insist(service, policy, policies)
    message = probe.until(lambda: paths and paths[-1], "the path")
    path = interface.path(message, EndEffectorPath)[1]
    assert path.t[-1] == pytest.approx(1.4)
    height = path.position[:, 2] - path.position[0, 2]
    assert 0.02 < height.max() < 0.08
    assert abs(height[-1]) < 0.01
    # and it looked as that driver does
    seen = {tuple(state.name) for state in bench.states}
    others = tuple(bench.setup["wam_sim"]["other_joints"])
    assert seen - {others} == {tuple(arm["joint_names"])}
    assert (others in seen) == (name == "geodude")
    assert all(len(state.velocity) == 0 for state in bench.states) == (name == "libbarrett")
    assert bool(speeds) == (name == "libbarrett")
    assert all(not list(speed.name) and len(speed.velocity) == 7 for speed in speeds)


def test_a_ros2_control_driver_ends_with_a_command_of_a_wrong_size(
    probe: Probe, processes: Processes, tmp_path: Path
) -> None:
    bench = Rehearsal(probe, processes, tmp_path, "geodude")
    torques = probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)

    def doing() -> str:
        return diagnosis(bench.diagnostics, "wam_sim").get("message", "")

    probe.until(lambda: doing() == "commanded", "the driver at work")
    torques.publish(Float64MultiArray(data=np.full(7, np.nan)))  # this it only drops
    probe.until(
        lambda: diagnosis(bench.diagnostics, "wam_sim").get("torques refused") == "1", "a refusal"
    )
    assert doing() == "commanded"
    torques.publish(Float64MultiArray(data=np.zeros(6)))
    probe.until(lambda: doing() == "deactivated", "the driver deactivated")
    on = SetBool.Request(data=True)
    assert probe.call(SetBool, interface.WAM_GRAVITY_COMPENSATE, on).success
    probe.until(lambda: doing() == "commanded", "the driver at work again")
