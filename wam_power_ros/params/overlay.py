# SPDX-License-Identifier: Apache-2.0
"""Set-ups: parameters of every node from its own file and the files that override it.

A set-up file gives each parameter once: parameters of the arm and its driver to
`torque_controller`, of motion capture to `pancake_tracker`. The matching parameters of other nodes,
and of the stand-ins for these devices, are derived here unless a file gives them explicitly.
"""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from wam_power_ros import installed
from wam_power_ros.params import parameter_file
from wam_power_ros.params.resources import robot_description, share

if TYPE_CHECKING:
    from wam_power_ros.control.arm import Arm

Parameters = dict[str, dict[str, Any]]  # by node
NODES = (
    "torque_controller",
    "demonstration_recorder",
    "pancake_tracker",
    "learner",
    "wam_sim",
    "optitrack_sim",
)
STAND_INS = ("wam_sim", "optitrack_sim")
WITH_BODY = ("pancake_tracker", "demonstration_recorder", "optitrack_sim")  # that of the task
SOURCES = ("torque_controller", "pancake_tracker")  # the others' parameters are derived from theirs
REGION = "guarded_region"  # parameter of the controller; a simulated scene has the same one
SIMULATION = "simulation"  # file in config/ with what a simulation changes
MOVE_SPEED = 1.0  # [rad/s] of a simulated arm in lockstep, when it moves to a start
_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
_STR, _SEQ = "tag:yaml.org,2002:str", "tag:yaml.org,2002:seq"


@dataclass(frozen=True, eq=False)  # equal to any mapping of the same parameters
class Setup(Mapping[str, dict[str, Any]]):
    """One set-up, of which nodes, stand-ins, simulations in one process and reports are built.

    It maps nodes to their parameters; `Params.of_setup` reads those of one node.
    """

    nodes: Parameters

    def __getitem__(self, node: str) -> dict[str, Any]:
        return self.nodes[node]

    def __iter__(self) -> Iterator[str]:
        return iter(self.nodes)

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def joint_names(self) -> list[str]:
        """Joint names of the driver, base to tip."""
        names: list[str] = self["torque_controller"]["joint_names"]
        return names

    def arm(self) -> Arm | None:
        """Build the model of the arm; None without a URDF file.

        Raises:
            ValueError: The URDF lacks joints or links that the set-up names.
        """
        from wam_power_ros.control.arm import Arm, guarded_points
        from wam_power_ros.control.corrections import Corrections

        controller = self["torque_controller"]
        if not controller["urdf"]:
            return None
        urdf = robot_description(controller["urdf"])
        points = (controller[f"guarded_{part}"] for part in ("names", "links", "points"))
        names, tool = controller["model_joint_names"], controller["tool_frame"]
        try:
            corrections = Corrections.of_parameters(controller)
            return Arm(urdf, names, tool, guarded_points(*points), corrections)
        except ValueError as error:
            where = "torque_controller: urdf, model_joint_names, tool_frame, guarded_links"
            raise ValueError(f"{controller['urdf']}: {error} ({where})") from None

    def changed(self, changes: Mapping[str, Mapping[str, Any]]) -> Setup:
        """Set-up with other values of some parameters, by node."""
        return Setup(self.nodes | {node: self[node] | dict(changes[node]) for node in changes})


def known() -> list[str]:
    """Names of the set-ups in config/."""
    stems = sorted(file.stem for file in share("config").glob("*.yaml"))
    return [s for s in stems if "." not in s and s not in (*NODES, SIMULATION)]  # no NAME.TASK


def find(name: str) -> Path:
    """Return the file of a set-up: config/NAME.yaml, or the path itself.

    Raises:
        ValueError: There is no such file; the message lists the set-ups in config/.
    """
    given = Path(name).expanduser()
    if given.suffix == ".yaml" and given.is_file():
        return given.resolve()
    if name not in known():
        raise ValueError(f"no set-up {name!r}: give the path of a .yaml file or one of {known()}")
    return share(f"config/{name}.yaml")


def setup(names: Sequence[str] = (), simulated: bool = False, task: str = "") -> Setup:
    """Compute the parameters of every node from set-ups.

    Args:
        names: Set-ups that override the nodes' own files, see `find`; the last one wins.
        simulated: Whether stand-ins with the same interfaces replace the devices of these set-ups,
            in real time. Without any set-up the stand-ins are as their own files describe them.
        task: Name of the learnt task, whose set-up (`installed.task_setup`) the others override,
            but for its name and body. What an arm needs for it is beside the arm's set-up NAME.yaml
            in NAME.TASK.yaml. Empty: no task.

    Raises:
        ValueError: The task is unknown, has no set-up or another body than a file says. A file
            cannot be found or read, names an unknown node or parameter, gives a value of another
            kind than the node's own file, or sets `simulation` for a real arm.
    """
    own = _own()
    given: Parameters = {node: {} for node in NODES}
    files = [installed.task_setup(task, share("config"))] if task else []
    of_task = {"body": installed.task_type(task).body} if task else {}
    given["pancake_tracker"] |= of_task
    for file in map(find, names):
        for_task = file.with_suffix(f".{task}.yaml")  # such as openarm.reach.yaml
        files += [file, for_task] if task and for_task.is_file() else [file]
    for file in files:
        for node, values in _read(file).items():
            _check(file, node, values, own)
            given[node] |= _for_ros(values, own[node])
    chosen = {node: own[node] | given[node] for node in NODES}
    _name_body(chosen["pancake_tracker"], given["pancake_tracker"])
    derived = _derived(chosen["torque_controller"], chosen["pancake_tracker"])
    in_simulation = simulated or not names
    if files or in_simulation:
        rules = [f"config/{SIMULATION}.yaml"] if in_simulation else []
        limits = [*own["learner"]["controller"], *rules, *map(str, files)]
        derived["learner"]["controller"] = limits
    if not (names or simulated):  # otherwise stand-ins like the drivers of these devices
        derived["wam_sim"] |= {"pace": "lockstep", "realtime_priority": 0}
        if not chosen["pancake_tracker"]["markers_topic"]:
            del derived["optitrack_sim"]["markers_topic"]  # the stand-in's own publishes both
    parameters = {node: own[node] | derived.get(node, {}) | given[node] for node in NODES}
    parameters["learner"] |= {"task": task} if task else {}
    for node in WITH_BODY if task else ():
        if (body := {"body": parameters[node]["body"]}) != of_task:
            where = f"{body} of {node} contradicts task {task!r}, {of_task}: choose another --task"
            raise ValueError(f"{where}, or omit it in {', '.join(map(str, files))}")
    if not in_simulation and parameters["torque_controller"]["simulation"]:
        raise ValueError(
            f"simulation: true in the set-ups {list(names)}: a set-up describes devices; stand-ins "
            "replace them with --simulate, or in sim.launch.py"
        )
    if in_simulation:  # the stand-ins do what a person does in the lab
        for node, values in _read(share(f"config/{SIMULATION}.yaml")).items():
            parameters[node] |= values
        # A set-up may leave the scene to the task, to try what an arm does without a person, and
        # keep the arm as slow as it is in the lab.
        kept = {"learner": "scene_reset", "torque_controller": "teaching_tool_speed_max"}
        for node, key in kept.items():
            parameters[node] |= {k: v for k, v in given[node].items() if k == key}
        if parameters["wam_sim"]["pace"] == "lockstep":  # wam_sim publishes the time for all nodes
            for node in set(NODES) - set(STAND_INS):
                parameters[node]["use_sim_time"] = True
            # Nobody stands beside a simulated arm: at the usual speed, moves to the start would
            # take two thirds of a session. Lockstep never waits for the clock, so that a node with
            # real-time priority would leave no time to the others.
            in_lockstep = {"move_speed": MOVE_SPEED, "realtime_priority": 0}
            parameters["torque_controller"] |= in_lockstep | given["torque_controller"]
    return Setup(parameters)


def read(file: Path) -> Setup:
    """Read a set-up that was written with `text`, such as `logs/parameters.yaml` of a session.

    Parameters that it lacks, because an older version wrote it, are those of the nodes' own files.

    Raises:
        ValueError: As for `parameter_file.of_nodes`.
    """
    return Setup(_own()).changed(parameter_file.of_nodes(file))


def adopted(node: str, files: Sequence[Path], namespace: str = "/") -> dict[str, tuple[Any, Any]]:
    """Compute what `setup` would change in the parameters of a node that is given plain files.

    ROS itself passes to a node only its own sections: those of the arm and of the motion capture
    would not reach a recorder. Without any file a node has its own file of config/; where the files
    of its process, that of wam_sim, leave parameters of optitrack_sim out, it has its own for them.

    Args:
        node: Name of the node, one of `NODES`.
        files: Its parameter files, later ones over earlier ones; other nodes are ignored.
        namespace: Namespace of the node.

    Returns:
        Value in its own sections (None if there is none) and derived value, by name of the
        parameter, where they differ.

    Raises:
        ValueError: A file is malformed, or an arm's or motion capture's section has an unknown
            parameter or a value of another kind than the node's own file.
    """
    own = _own()
    named = {name for file in files for name in _read(file, namespace).get(node, {})}
    if not files or (node == "optitrack_sim" and own[node].keys() - named):
        changed = adopted(node, [share(f"config/{node}.yaml"), *files], namespace)
        left_out = {name: (None, own[node][name]) for name in own[node].keys() - named}
        return left_out | {
            name: (plain if name in named else None, value)
            for name, (plain, value) in changed.items()
        }
    given: Parameters = {source: {} for source in SOURCES}
    limits = share("config/torque_controller.yaml")
    controller = list(own["learner"]["controller"])
    plain: dict[str, Any] = {}
    found: dict[str, Any] = {}

    def derive() -> dict[str, Any]:
        arm, mocap = (own[source] | given[source] for source in SOURCES)
        cameras = dict(given["pancake_tracker"])
        _name_body(mocap, cameras)
        if node == "pancake_tracker":
            named = {name: mocap[name] for name in ("pose_topic", "markers_topic")}
            return named | {"base_frame": given[node].get("base_frame", arm["base_frame"])}
        derived = _derived(arm, mocap).get(node, {})
        return derived | ({"controller": list(controller)} if node == "learner" else {})

    before = derive()
    for file in files:
        section = parameter_file.of_nodes(file, namespace).get(node, {})
        sections = _read(file, namespace)
        for source in SOURCES:
            values = _without_ros(sections.get(source, {}))
            _check(file, source, values, own)
            values = _for_ros(values, own[source])
            changed = {name: value for name, value in values.items() if value != own[source][name]}
            given[source] = {k: v for k, v in given[source].items() if k not in values} | changed
            if source == "torque_controller" and values and file.resolve() != limits.resolve():
                controller.append(str(file.resolve()))  # also one that restores own values
        after = derive()
        new = {name: value for name, value in after.items() if value != before.get(name)}
        found |= new | sections.get(node, {}) | (after if node in SOURCES else {})
        plain |= section
        before = after
    return {
        name: (plain.get(name), value)
        for name, value in _without_ros(found).items()
        if plain.get(name) != value
    }


def _own() -> Parameters:
    return {node: _read(share(f"config/{node}.yaml"))[node] for node in NODES}


def _without_ros(values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters without those that ROS itself defines."""
    prefixes = parameter_file.ROS_PARAMETERS
    return {name: value for name, value in values.items() if not str(name).startswith(prefixes)}


def text(setup: Setup, namespace: str = "") -> str:
    """Write a set-up as the text of one parameter file for all nodes.

    Args:
        setup: Parameters by node.
        namespace: Namespace of the nodes, such as `/left`; empty to match any namespace.
    """
    above = namespace or "/**"
    nodes = {f"{above}/{node}": {"ros__parameters": values} for node, values in setup.items()}
    return yaml.dump(nodes, Dumper=_Plain, sort_keys=False, width=1000)


class _Plain(yaml.SafeDumper):
    """YAML for ROS: without references, and with quoted strings, because ROS reads y as true."""

    def ignore_aliases(self, data: object) -> bool:
        """Write a repeated list in full."""
        return True


_Plain.add_representer(str, lambda to, text: to.represent_scalar(_STR, text, style='"'))
_Plain.add_representer(list, lambda to, items: to.represent_sequence(_SEQ, items, flow_style=True))


def _read(file: Path, namespace: str = "") -> Parameters:
    """Read the parameters by node from one file, see `parameter_file.of_nodes`."""
    found = parameter_file.of_nodes(file, namespace)
    for values in found.values():  # the URDF path may be relative to the set-up file
        if values.get("urdf") and (urdf := file.parent / str(values["urdf"])).is_file():
            values["urdf"] = str(urdf.resolve())
    return found


def _check(file: Path, node: str, values: Mapping[str, Any], own: Parameters) -> None:
    if node not in own:
        raise ValueError(f"{file} has parameters for {node!r}; the nodes are {list(NODES)}")
    for name, value in values.items():
        if name not in own[node]:
            near = difflib.get_close_matches(str(name), own[node], n=1)
            hint = f"; is it {near[0]}?" if near else f"; it has {sorted(own[node])}"
            raise ValueError(f"{file}: {node} has no parameter {name!r}{hint}")
        if not _same_kind(value, default := own[node][name]):
            shown = reprlib.repr(value)  # the value may be a whole file
            raise ValueError(f"{file}: {name} of {node} is {shown}; allowed is {_kind(default)}")


def _same_kind(value: object, default: object) -> bool:
    """Whether a value has the type of the default; an int may replace a float."""
    if isinstance(default, list):
        if not isinstance(value, list) or not (value or isinstance(default[0], str)):
            return False
        return all(_same_kind(item, default[0]) for item in value)
    return type(value) is type(default) or (type(value) is int and type(default) is float)


def _for_ros(values: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Values of the kinds of the own file, as ROS tells a whole number from a float.

    A list of both, or an empty one, ends a node before it can say which parameter it is.
    """
    return {name: _of_kind(value, own[name]) for name, value in values.items()}


def _of_kind(value: Any, default: Any) -> Any:  # noqa: ANN401 - of any kind
    if isinstance(value, list):
        return [_of_kind(item, default[0]) for item in value] or [""]
    return float(value) if isinstance(default, float) else value


def _kind(default: object) -> str:
    """Name of the kind of values that the default has, for messages."""
    if isinstance(default, list):
        return f"a list, each {_kind(default[0])}, not empty unless of text"
    return _KINDS[type(default)]


def _name_body(mocap: dict[str, Any], given: dict[str, Any]) -> None:
    """Insert the body's name into its pose topic, or clear the topics without a body; in place."""
    if not mocap["body"]:
        given |= {"pose_topic": "", "markers_topic": ""}
    elif "pose_topic" in given:
        given["pose_topic"] = given["pose_topic"].replace("{body}", mocap["body"])
    elif not given.get("markers_topic"):
        given["pose_topic"] = f"{mocap['body']}/pose"
    mocap |= given


def _derived(arm: Mapping[str, Any], mocap: Mapping[str, Any]) -> Parameters:
    """Derive parameters of other nodes, stand-ins included, from the arm's and the cameras'."""
    model = ("joint_names", "model_joint_names", "urdf", "tool_frame")
    driver = ("period", "state_topic", "velocity_topic", "command_topic", "command_type")
    world = ("guarded_names", "guarded_links", "guarded_points", REGION)
    cameras = ("body", "single_marker", "pose_topic", "markers_topic", "up_axis", "world_to_base")
    topics = [name for name in (arm["command_topic"], arm["velocity_topic"]) if name]
    derived: Parameters = {
        "demonstration_recorder": {
            "state_topic": arm["state_topic"],
            **{name: arm[name] for name in model},
            "driver_topics": topics,
            "body": mocap["body"],
            "mocap_topics": [mocap["pose_topic"] or mocap["markers_topic"]],
        },
        "pancake_tracker": {"base_frame": arm["base_frame"]},
        "learner": {name: arm[name] for name in (*model, "base_frame")},
        "wam_sim": {
            **{name: arm[name] for name in (*model, *driver, *world)},
            "driver_compensates_gravity": arm["driver_compensates_gravity"],
            "velocity": "empty" if arm["velocity_topic"] else "filled",
            "effort": {"torque": "filled", "none": "empty"}.get(arm["effort"], arm["effort"]),
        },
        "optitrack_sim": {name: mocap[name] for name in (*cameras, "rate")},
    }
    if mocap["latency_offset"]:  # stamps are later than the exposure
        derived["optitrack_sim"] |= {"stamps": "receipt", "latency": mocap["latency_offset"]}
    return derived
