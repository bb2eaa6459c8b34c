# SPDX-License-Identifier: Apache-2.0
"""Every driver with a set-up: a stand-in with its topics, under our controller."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import Probe, Processes, lift
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from hardware_sim.arm_node import ArmSim
from hardware_sim.world import World
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, joint_messages, pose_messages

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
        self.probe.insist("move_to_start", policy)
        self.probe.insist("reset", policy)
        self.probe.insist("execute", policy)
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


Driver = tuple[ArmSim, Callable[[], str]]


@pytest.fixture
def driver(node_here: Callable[..., ArmSim], tmp_path: Path) -> Callable[..., Driver]:
    """Makes a stand-in in this process, with its state in words."""

    def make(name: str, **values: object) -> Driver:
        setup = overlay.setup([name], simulated=True).changed({"wam_sim": values})
        (file := tmp_path / "parameters.yaml").write_text(overlay.text(setup))
        arm = node_here(ArmSim, file)
        arm.attach(World.of(arm.params, None), lambda *_: None)
        said: list[str] = []
        arm._diagnostics = SimpleNamespace(publish=lambda _, text, values: said.append(text))
        return arm, lambda: (arm.report({}), said[-1])[1]

    return make


def test_a_driver_that_is_set_to_do_so_ends_with_a_command_of_a_wrong_size(
    driver: Callable[..., Driver],
) -> None:
    arm, doing = driver("geodude", deactivates=True)
    arm._on_torque(Float64MultiArray(data=[np.nan] * 7))  # dropped without a fault
    assert (arm.counters["torques refused"], doing()) == (1, "commanded")
    arm._on_torque(Float64MultiArray(data=[0.0] * 6))
    assert doing() == "deactivated"
    arm._barrett._on_gravity_compensate(SetBool.Request(data=True), SetBool.Response())
    assert doing() == "commanded"


def test_an_arm_that_was_idled_is_active_again_once_the_fault_is_reset(
    driver: Callable[..., Driver],
) -> None:
    arm, doing = driver("libbarrett")
    step = lambda label: arm.tick(joint_messages.TorqueReading(None, label, np.zeros(7)))  # noqa: E731
    step("fault")
    arm._barrett._on_idle(Trigger.Request(), Trigger.Response())
    step("fault")
    assert doing() == "idle"
    step("hold")
    assert doing() == "commanded"
