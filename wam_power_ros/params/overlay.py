# SPDX-License-Identifier: Apache-2.0
"""Set-ups: parameters of every node from its own file and the files that override it.

A set-up file gives each parameter once: those of the arm's driver to `torque_controller`, those of
the motion capture to `pancake_tracker`. The parameters of other nodes, and of stand-ins that
replace these devices, are derived from them here, unless a file gives them explicitly.
"""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from wam_power_ros.params import parameter_file
from wam_power_ros.params.resources import share

Setup = dict[str, dict[str, Any]]  # parameters by node
NODES = (
    "torque_controller",
    "demonstration_recorder",
    "pancake_tracker",
    "learner",
    "wam_sim",
    "optitrack_sim",
)
STAND_INS = ("wam_sim", "optitrack_sim")
MOVE_SPEED = 1.0  # [rad/s] of a simulated arm in lockstep, on its way to a start
_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
_STR, _SEQ = "tag:yaml.org,2002:str", "tag:yaml.org,2002:seq"


def known() -> list[str]:
    """Names of the set-ups in config/."""
    files = sorted(share("config").glob("*.yaml"))
    return [file.stem for file in files if file.stem not in NODES]


def find(name: str) -> Path:
    """File of a set-up: config/NAME.yaml, or the path of one.

    Raises:
        ValueError: When there is none; lists those in config/.
    """
    given = Path(name).expanduser()
    if given.suffix == ".yaml" and given.is_file():
        return given.resolve()
    if name not in known():
        raise ValueError(f"no set-up {name!r}: give the path of a .yaml file or one of {known()}")
    return share(f"config/{name}.yaml")


def setup(names: Sequence[str] = (), simulated: bool = False, task: str = "") -> Setup:
    """Parameters of every node under some set-ups.

    Args:
        names: Set-ups over the nodes' own files, see `find`; later ones override earlier ones.
        simulated: Whether stand-ins of the same shape replace the devices of these set-ups, in
            real time. Without any set-up the stand-ins are as their own files describe them.
        task: Set-up of the task that is learnt, which lies under the others: the path of a file, or
            the name of the task, where config/TASK.yaml counts if it is there.

    Raises:
        ValueError: When a file cannot be found or read, names an unknown node or parameter, or
            gives one another kind of value than the node's own file does.
    """
    own = {node: _read(share(f"config/{node}.yaml"))[node] for node in NODES}
    given: Setup = {node: {} for node in NODES}
    of_task = [task] if task in known() or task.endswith(".yaml") else []
    files = [find(name) for name in (*of_task, *names)]
    for file in files:
        for node, values in _read(file).items():
            _check(file, node, values, own)
            given[node] |= values
    chosen = {node: own[node] | given[node] for node in NODES}
    _name_body(chosen["pancake_tracker"], given["pancake_tracker"])
    follows = _follows(chosen["torque_controller"], chosen["pancake_tracker"])
    if files:
        follows["learner"]["controller"] = [*own["learner"]["controller"], *map(str, files)]
    if names or simulated:
        follows |= _shape(chosen["torque_controller"], chosen["pancake_tracker"])
    follows.setdefault("wam_sim", {})["obstacle"] = chosen["torque_controller"]["obstacle"]
    seen = {name: chosen["pancake_tracker"][name] for name in ("body", "pose_topic")}
    follows["optitrack_sim"] = seen | follows.get("optitrack_sim", {})
    whole = {node: own[node] | follows.get(node, {}) | given[node] for node in NODES}
    if simulated or not names:  # the stand-in does what a person does in the lab
        whole["torque_controller"] |= {
            "simulation": True,
            "hold_to_run": False,
            "allow_no_realtime": True,
        }
        whole["learner"] |= {"scene_reset": True, "reset_faults": True}
        whole["demonstration_recorder"]["source"] = "sim"
        if whole["wam_sim"]["pace"] == "lockstep":  # publishes the time, and waits for every node
            for node in set(NODES) - set(STAND_INS):
                whole[node]["use_sim_time"] = True
            # Nobody stands beside it: two thirds of a session would pass on the way to a start.
            # And it runs as fast as it can: with real-time priority nothing else would run.
            in_lockstep = {"move_speed": MOVE_SPEED, "realtime_priority": 0}
            whole["torque_controller"] |= in_lockstep | given["torque_controller"]
    return whole


def text(setup: Setup, namespace: str = "") -> str:
    """A set-up as the text of a parameter file for every node.

    Args:
        setup: Parameters by node.
        namespace: Namespace of the nodes, such as `/left`; empty for whatever they are in.
    """
    above = namespace or "/**"
    nodes = {f"{above}/{node}": {"ros__parameters": values} for node, values in setup.items()}
    return yaml.dump(nodes, Dumper=_Plain, sort_keys=False, width=1000)


class _Plain(yaml.SafeDumper):
    """YAML as ROS reads it: without references, strings quoted, for it reads a bare y as true."""

    def ignore_aliases(self, data: object) -> bool:
        """Write a repeated list again."""
        return True


_Plain.add_representer(str, lambda to, text: to.represent_scalar(_STR, text, style='"'))
_Plain.add_representer(list, lambda to, items: to.represent_sequence(_SEQ, items, flow_style=True))


def _read(file: Path) -> Setup:
    """Parameters by node of one file."""
    found = parameter_file.of_nodes(file)
    for values in found.values():  # a URDF may be in the folder of the set-up file
        if values.get("urdf") and (beside := file.parent / str(values["urdf"])).is_file():
            values["urdf"] = str(beside.resolve())
    return found


def _check(file: Path, node: str, values: Mapping[str, Any], own: Setup) -> None:
    if node not in own:
        raise ValueError(f"{file} has parameters for {node!r}; the nodes are {list(NODES)}")
    for name, value in values.items():
        if name not in own[node]:
            near = difflib.get_close_matches(str(name), own[node], n=1)
            hint = f"; is it {near[0]}?" if near else f"; it has {sorted(own[node])}"
            raise ValueError(f"{file}: {node} has no parameter {name!r}{hint}")
        if not _alike(value, usual := own[node][name]):
            shown = reprlib.repr(value)  # may be a file of it
            raise ValueError(f"{file}: {name} of {node} is {shown}; allowed is {_kind(usual)}")


def _alike(value: object, usual: object) -> bool:
    """Whether a value is of the kind of another; a whole number may stand for any number."""
    if isinstance(usual, list):
        return isinstance(value, list) and all(_alike(item, usual[0]) for item in value)
    return type(value) is type(usual) or (type(value) is int and type(usual) is float)


def _kind(usual: object) -> str:
    """What values like this one are, for people."""
    if isinstance(usual, list):
        return f"a list, each {_kind(usual[0])}"
    return _KINDS[type(usual)]


def _name_body(mocap: dict[str, Any], given: dict[str, Any]) -> None:
    """Fill the body's name into the topic of its poses, or clear the topics without a body."""
    if not mocap["body"]:
        given |= {"pose_topic": "", "markers_topic": ""}
    elif "pose_topic" in given:
        given["pose_topic"] = given["pose_topic"].replace("{body}", mocap["body"])
    elif not given.get("markers_topic"):
        given["pose_topic"] = f"{mocap['body']}/pose"
    mocap |= given


def _follows(arm: Mapping[str, Any], mocap: Mapping[str, Any]) -> Setup:
    """Parameters of other nodes that follow from the driver and the motion capture."""
    return {
        "torque_controller": {
            "simulation": False,
            "hold_to_run": True,
            "allow_no_realtime": False,
        },
        "demonstration_recorder": {
            **{name: arm[name] for name in ("state_topic", "joint_names")},
            **{name: arm[name] for name in ("model_joint_names", "urdf", "tool_frame")},
            "driver_topics": [
                name for name in (arm["command_topic"], arm["velocity_topic"]) if name
            ],
            "body": mocap["body"],
            "mocap_topics": [mocap["pose_topic"] or mocap["markers_topic"]],
            "source": "hardware",
        },
        "learner": {
            **{name: arm[name] for name in ("joint_names", "model_joint_names", "tool_frame")},
            "urdf": arm["urdf"],
            "scene_reset": False,
            "reset_faults": False,
        },
    }


def _shape(arm: Mapping[str, Any], mocap: Mapping[str, Any]) -> Setup:
    """Parameters of stand-ins that replace these devices."""
    driver = ("joint_names", "state_topic", "velocity_topic", "command_topic", "command_type")
    model = ("urdf", "model_joint_names", "tool_frame")
    guarded = ("guarded_names", "guarded_links", "guarded_points")
    cameras = ("body", "pose_topic", "markers_topic", "up_axis", "world_to_base", "rate")
    shape: Setup = {
        "wam_sim": {
            **{name: arm[name] for name in (*driver, *model, *guarded)},
            "driver_compensates_gravity": arm["driver_compensates_gravity"],
            "velocity": "empty" if arm["velocity_topic"] else "filled",
            "pace": "real_time",  # as every driver's
            "realtime_priority": 70,
        },
        "optitrack_sim": {name: mocap[name] for name in cameras},
    }
    if mocap["latency_offset"]:  # stamps are later than the exposure
        shape["optitrack_sim"] |= {"stamps": "receipt", "latency": mocap["latency_offset"]}
    return shape
