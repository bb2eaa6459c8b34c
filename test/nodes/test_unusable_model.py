# SPDX-License-Identifier: Apache-2.0
"""A model without masses is refused, and one that raises ends in a stop at rest."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from played_arm import HOME, NAMES, ControllerHere
from rigid_arm import MODEL, Plant, check, make_policy, tool
from std_srvs.srv import Trigger

from wam_power_ros.control.arm import Arm
from wam_power_ros.control.modes import ControllerError
from wam_power_ros.control.safety import REST_SPEED
from wam_power_ros.faults import FaultKind
from wam_power_ros.params import torque_controller_params
from wam_power_ros.ros import joint_messages

COMPUTED = ("gravity", "mass_matrix", "bias", "dynamics", "inverse_dynamics", "motion", "speeds")


class Breaking(Arm):
    """A model of which nothing can be computed any more, once it is broken."""

    broken = False

    def __getattribute__(self, name: str) -> object:
        if Breaking.broken and name in COMPUTED:
            raise np.linalg.LinAlgError("Singular matrix")
        return super().__getattribute__(name)


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
    controller_here: Callable[..., ControllerHere], tmp_path: Path
) -> None:
    arm = controller_here(urdf=massless(tmp_path, "wam_link[67]|pan"))
    assert not arm.configure()
    assert f"links {LAST} move without mass" in arm.refused[-1]
    assert arm.send() == ""


@pytest.mark.requirement("S-112")
def test_a_model_that_raises_ends_a_move_at_rest_and_the_node_goes_on(
    controller_here: Callable[..., ControllerHere], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torque_controller_params, "Arm", Breaking)
    monkeypatch.setattr(Breaking, "broken", False)
    arm = controller_here()
    node, plant = arm.node, Plant(HOME, delay=1, sensing=True, friction=1.0)
    failures: list[Exception] = []
    monkeypatch.setattr(node._report, "failed", failures.append)
    assert arm.configure()
    arm.send()
    assert arm.activate()
    arm.send()

    def run(ticks: int) -> list[float]:
        """Speeds of the tool [m/s], a tick each."""
        speeds = []
        for _ in range(ticks):
            before = joint_messages.torque(arm.sent[-1], NAMES).tau
            _, q, qd = plant.state()
            arm.send(NAMES, q, tuple(qd))
            tau = joint_messages.torque(arm.sent[-1], NAMES).tau
            check(tau, before)
            plant.step(tau)
            speeds.append(MODEL.speeds(plant.q, plant.qd).tool_speed)
        return speeds

    run(200)
    node._controller.load(make_policy(q_start=HOME + 0.4))
    node._controller.move_to_start()
    nominal = max(run(400))
    assert arm.label == "move_to_start" and nominal > 0.1
    Breaking.broken = True
    node._on_stop(Trigger.Request(), Trigger.Response())
    stopping = run(250)
    assert arm.label == "fault"
    assert max(stopping) < nominal + 0.1
    assert stopping[-1] < REST_SPEED
    stopped = tool(plant)
    assert max(run(500)) < REST_SPEED
    assert np.linalg.norm(tool(plant) - stopped) < 0.02
    assert node._controller.latched.kind is FaultKind.COMPUTATION
    assert {repr(error) for error in failures} == {"LinAlgError('Singular matrix')"}
    with pytest.raises(ControllerError, match="no torque could be computed"):
        node._reset(node._controller, Trigger.Request())
