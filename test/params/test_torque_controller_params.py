# SPDX-License-Identifier: Apache-2.0
"""Parameters of the torque controller become limits and settings, or are refused by name."""

from pathlib import Path

import numpy as np
import pytest
import rclpy
import yaml
from rclpy.parameter import Parameter

from hardware_sim.settings import ArmSimParams
from wam_power_ros.params import overlay, parameter_file
from wam_power_ros.params.resources import share
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.regions import Region

FILE = share("config/torque_controller.yaml")
URDF = share("urdf/wam7.urdf").read_text()


def params(tmp_path: Path, **changes: object) -> TorqueControllerParams:
    """Parameters of the file with some changed."""
    over = tmp_path / "over.yaml"
    over.write_text(yaml.safe_dump({"torque_controller": {"ros__parameters": changes}}))
    return TorqueControllerParams.from_setup(overlay.from_files([over]))


def test_every_parameter_of_motion_reaches_the_controller(tmp_path: Path) -> None:
    changes = {
        "period": 0.004,
        "driver_compensates_gravity": True,
        "hold_to_run": True,
        "move_speed": 0.2,
        "start_tolerance": 0.04,
        "settle_time": 0.5,
        "velocity_cutoff": 90.0,
        "stiffness_max": 900.0,
    }
    sphere = {"guarded_region": [0.5, 0.1, 0.3, 0.06], "guarded_region_name": "box"}
    given = params(tmp_path, **changes, **sphere, law="virtual_mass")
    settings = given.controller(URDF).settings
    for name, value in changes.items():
        assert getattr(settings, name) == value
    assert settings.law == "virtual_mass"
    assert settings.region == given.region == Region("box", (0.5, 0.1, 0.3), 0.06)
    sphere["guarded_region"] = [0.5, 0.1, 0.3, 0.0]
    assert params(tmp_path, **sphere).controller(URDF).settings.region is None


def test_an_arm_that_takes_positions_has_set_points_at_its_rate_and_a_model_at_500_hz(
    tmp_path: Path,
) -> None:
    slow = {"output": "trajectory", "period": 0.008, "driver_compensates_gravity": True}
    settings = params(tmp_path, **slow).controller(URDF).settings
    assert (settings.period, settings.state_period, settings.set_point_period) == (
        *(0.002, 0.008, 0.008),
    )
    assert not settings.driver_compensates_gravity  # the model's torques carry it
    assert params(tmp_path, **slow).message == "trajectory"
    rare = {"output": "position", "set_point_period": 0.01}
    assert params(tmp_path, **rare).controller(URDF).settings.set_point_period == 0.01
    assert params(tmp_path).controller(URDF).settings.set_point_period == 0.0
    with pytest.raises(ValueError, match=r"set_point_period = 0\.004 .* 0\.008"):
        params(tmp_path, **slow, set_point_period=0.004)


def test_every_limit_reaches_the_controller(tmp_path: Path) -> None:
    changes = {
        "torque_share": 0.5,
        "torque_rate_max": 500.0,
        "guarded_speed_max": 1.0,
        "tool_speed_max": 1.5,
        "teaching_tool_speed_max": 0.5,
        "workspace_min": [-1.0, -1.1, -0.1],
        "workspace_max": [1.0, 1.1, 1.2],
        "plane": [0.0, 1.0, 0.0, -0.7],
    }
    controller = params(tmp_path, **changes).controller(URDF)
    limits = controller.limits
    assert np.array_equal(limits.torque, 0.5 * controller.arm.tau_max)
    assert np.array_equal(limits.torque_rate, np.full(7, 500.0))
    assert (limits.guarded_speed, limits.tool_speed, limits.teaching_tool_speed) == (1.0, 1.5, 0.5)
    for name in ("workspace_min", "workspace_max", "plane"):
        assert getattr(limits, name).tolist() == changes[name]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("guarded_region", [0.5, 0.1, 0.3, -0.06]),
        ("guarded_region", [0.5, 0.1, float("nan"), 0.06]),
        ("law", "jacobian_transpose"),
        ("move_speed", "1:30"),
        ("period", 0.021),
        ("guarded_speed_max", 3.1),
        ("stiffness_max", 4900.0),
        ("realtime_priority", 99),
    ],
)
def test_a_value_out_of_range_is_refused_with_its_name(
    tmp_path: Path, name: str, value: object
) -> None:
    with pytest.raises(ValueError, match=name):
        params(tmp_path, **{name: value})


@pytest.mark.requirement("S-18")
@pytest.mark.parametrize(
    ("name", "refused", "accepted"),
    [
        ("state_timeout", 0.0, 0.005),
        ("state_timeout", 0.021, 0.02),
        ("stiffness_max", 2801.0, 2800.0),
        ("torque_rate_max", 2001.0, 2000.0),
    ],
)
def test_a_real_arm_has_stricter_bounds_than_a_simulation(
    tmp_path: Path, name: str, refused: float, accepted: float
) -> None:
    params(tmp_path, simulation=True, **{name: refused})
    params(tmp_path, simulation=False, **{name: accepted})
    with pytest.raises(ValueError, match=f"{name} = {refused} must be .* on a real arm"):
        params(tmp_path, simulation=False, **{name: refused})


@pytest.mark.requirement("S-18")
def test_a_real_arm_refuses_simulated_time(domain_id: int) -> None:
    values = parameter_file.of_nodes(FILE)["torque_controller"] | {"simulation": False}
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    try:
        node = rclpy.create_node(
            "torque_controller",
            context=context,
            parameter_overrides=[
                Parameter(name, value=value)
                for name, value in (values | {"use_sim_time": True}).items()
            ],
            automatically_declare_parameters_from_overrides=True,
        )
        with pytest.raises(ValueError, match="use_sim_time = True"):
            TorqueControllerParams.from_node(node)
    finally:
        rclpy.shutdown(context=context)


@pytest.mark.requirement("S-59")
def test_the_controller_takes_policies_of_its_own_arm_only(tmp_path: Path) -> None:
    controller = params(tmp_path).controller(URDF)
    assert controller.settings.arm == controller.arm.identity()


def test_guarded_points_may_have_any_name_or_be_empty(tmp_path: Path) -> None:
    wrist = {"guarded_names": ["wrist"], "guarded_links": ["wam_link6"]}
    named = params(tmp_path, **wrist, guarded_points=[0.0, 0.0, 0.1])
    assert named.controller(URDF).arm.guarded == ("wrist",)
    assert params(tmp_path, guarded_names=[""]).controller(URDF).arm.guarded == ()
    with pytest.raises(ValueError, match="guarded_points"):
        params(tmp_path, **wrist, guarded_points=[0.0, 0.0]).controller(URDF)


def test_the_model_must_have_as_many_joint_names_as_the_driver(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="model_joint_names"):
        params(tmp_path, model_joint_names=["wam_j1"]).controller(URDF)


def test_names_of_the_driver_in_another_order_than_the_models_are_refused() -> None:
    setup = overlay.setup(["ur"])
    names = setup["torque_controller"]["joint_names"]
    for params in (TorqueControllerParams, ArmSimParams):
        node = params.file.removesuffix(".yaml")
        with pytest.raises(ValueError, match="'elbow_joint' in the place of 'shoulder_pan_joint'"):
            params.from_setup(setup.changed({node: {"joint_names": sorted(names)}}))
        assert params.from_setup(setup.changed({node: {"joint_names": [f"l_{n}" for n in names]}}))
