# SPDX-License-Identifier: Apache-2.0
"""Set-ups: parameters of every node from its own file and the files that override it.

A set-up file gives each parameter once: parameters of the arm and its driver to
`torque_controller`, of motion capture to `pancake_tracker`. The matching parameters of other nodes,
and of the stand-ins for these devices, are derived here unless a file gives them explicitly.
"""

from __future__ import annotations

import difflib
import itertools
import reprlib
from collections.abc import Mapping, Sequence
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
    "tag_camera",
    "franka_driver",
    "natnet_client",
    "learner",
    "wam_sim",
    "optitrack_sim",
)
STAND_INS = ("wam_sim", "optitrack_sim")
SOURCES = ("torque_controller", "pancake_tracker")  # the others' parameters are derived from theirs
REGION = "guarded_region"  # parameter of the controller; a simulated scene has the same one
SIMULATION = "simulation"  # file in config/ with what a simulation changes
LOCKSTEP = "lockstep"  # file in config/ with what the pace of a simulation changes
_STR, _SEQ = "tag:yaml.org,2002:str", "tag:yaml.org,2002:seq"


class Setup(dict[str, dict[str, Any]]):
    """One set-up, of which nodes, stand-ins, simulations in one process and reports are built.

    It maps nodes to their parameters; `Params.from_setup` reads those of one node.
    """

    @property
    def joint_names(self) -> list[str]:
        """Joint names of the driver, base to tip."""
        names: list[str] = self["torque_controller"]["joint_names"]
        return names

    def arm(self) -> Arm | None:
        """Model of the arm, None without a URDF; a ValueError names joints and links it lacks."""
        from wam_power_ros.control.arm import Arm, guarded_points
        from wam_power_ros.control.corrections import Corrections

        controller = self["torque_controller"]
        if not controller["urdf"]:
            return None
        urdf = robot_description(controller["urdf"])
        points = (controller[f"guarded_{part}"] for part in ("names", "links", "points"))
        names, tool = controller["model_joint_names"], controller["tool_frame"]
        try:
            corrections = Corrections.from_parameters(controller)
            guarded, base = guarded_points(*points), controller["base_frame"]
            limits = controller["position_limits"]
            return Arm(urdf, names, tool, guarded, corrections, base, limits)
        except ValueError as error:
            where = "model_joint_names, base_frame, tool_frame, position_limits, guarded_links"
            text = f"{controller['urdf']}: {error} (torque_controller: urdf, {where})"
            raise ValueError(text) from None

    def changed(self, changes: Mapping[str, Mapping[str, Any]]) -> Setup:
        """Set-up with other values of some parameters, by node."""
        return Setup(self | {node: self[node] | dict(changes[node]) for node in changes})


def known() -> list[str]:
    """Names of the set-ups in config/."""
    stems = sorted(file.stem for file in share("config").glob("*.yaml"))
    others = (*NODES, SIMULATION, LOCKSTEP)
    return [stem for stem in stems if "." not in stem and stem not in others]  # no NAME.TASK


def find(name: str) -> Path:
    """Return the file of a set-up: config/NAME.yaml, or the path itself.

    A ValueError that there is no such file lists the set-ups in config/.
    """
    given = Path(name).expanduser()
    if given.suffix == ".yaml" and given.is_file():
        return given.resolve()
    if name not in known():
        advice = f"give the path of a .yaml file or one of {known()}"
        raise ValueError(f"no set-up {name!r}: {advice}{installed.did_you_mean(name, known())}")
    return share(f"config/{name}.yaml")


def summary(name: str) -> str:
    """First sentence of the comment at the top of a set-up in config/."""
    lines = find(name).read_text().splitlines()
    comment = itertools.takewhile(lambda line: line.startswith("#"), lines)
    return " ".join(line.strip("# ") for line in comment).partition(". ")[0].rstrip(".")


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
        ValueError: The task is unknown, has no set-up or another body than a file says, or a node
            has another base frame than the controller. A file cannot be read, names an unknown
            node or parameter, gives a value of another kind than the node's own file, or sets
            `simulation` for a real arm.
    """
    own = _own()
    files = [installed.task_setup(task, share("config"))] if task else []
    for file in map(find, names):
        for_task = file.with_suffix(f".{task}.yaml")  # such as openarm.reach.yaml
        files += [file, for_task] if task and for_task.is_file() else [file]
    of_task = {"body": installed.task_type(task).body} if task else {}
    given = [(file, _sections(file, own)) for file in files]
    in_simulation = simulated or not names
    first: Parameters = {"wam_sim": {"pace": "lockstep"}}
    if names or simulated:  # stand-ins like the drivers of these devices
        first = _derived(*(own[source] for source in SOURCES))
    parameters = _folded(own, _over(own, first), [(None, {"pancake_tracker": of_task}), *given])
    parameters["learner"] |= {"task": task} if task else {}
    base = parameters["torque_controller"]["base_frame"]
    for node, values in parameters.items():
        if task and (body := {"body": values.get("body", of_task["body"])}) != of_task:
            where = f"{body} of {node} contradicts task {task!r}, {of_task}: choose another --task"
            raise ValueError(f"{where}, or omit it in {', '.join(map(str, files))}")
        if (own_base := values.get("base_frame", base)) != base:
            text = f"base_frame {own_base!r} of {node} is not that of torque_controller, {base!r}"
            raise ValueError(f"{text}: give it there, the other nodes have it from there")
    if not in_simulation and parameters["torque_controller"]["simulation"]:
        raise ValueError(
            f"simulation: true in the set-ups {list(names)}: a set-up describes devices; stand-ins "
            "replace them with --simulate, or in sim.launch.py"
        )
    if in_simulation:  # the stand-ins do what a person does in the lab
        said = _over({node: {} for node in NODES}, *(sections for _, sections in given))
        rules = _read(share(f"config/{SIMULATION}.yaml"))
        # A set-up may leave the scene to the task, to try what an arm does without a person, and
        # keep the arm as slow as it is in the lab.
        kept = {"learner": "scene_reset", "torque_controller": "teaching_tool_speed_max"}
        for node, key in kept.items():
            rules[node] |= {k: v for k, v in said[node].items() if k == key}
        parameters = _over(parameters, rules)
        own_limits, *limits = parameters["learner"]["controller"]
        parameters["learner"]["controller"] = [own_limits, f"config/{SIMULATION}.yaml", *limits]
        if parameters["wam_sim"]["pace"] == "lockstep":
            rules = _read(share(f"config/{LOCKSTEP}.yaml"))
            for node, values in rules.items():  # unless a set-up says so
                values |= {k: v for k, v in said[node].items() if k in values}
            parameters = _over(parameters, rules)
    return Setup(parameters)


def from_files(
    files: Sequence[Path],
    namespace: str = "/",
    node: str = "",
    kind: str = "",
    own_values: Mapping[str, Any] | None = None,
) -> Setup:
    """Compute the parameters of every node from plain files, which may leave out any.

    They are those of the nodes' own files, changed by each other file in turn: by its sections,
    and by what is derived for the other nodes from those of the arm and the motion capture. A
    section of all nodes (`/**`) holds for each that has such a parameter.

    Args:
        files: Parameter files, later ones over earlier ones.
        namespace: Namespace of the nodes; sections of others are ignored.
        node: Name that a node was started with, whose sections are those of its kind as well.
        kind: Its name in `NODES`.
        own_values: Parameters of the node from its command line, which replace those of files.

    A ValueError names a file that is malformed, or an unknown parameter or a value of another kind
    than the node's own file in it.
    """
    own, defaults = _own(), {share(f"config/{each}.yaml").resolve() for each in NODES}
    others = [path for path in map(Path.resolve, files) if path not in defaults]
    sections = [(file, _sections(file, own, namespace, {node: kind})) for file in others]
    given = {k: v for k, v in (own_values or {}).items() if _same_kind(v, own[kind].get(k))}
    return Setup(_folded(own, own, [*sections, (None, {kind: given} if given else {})]))


def _folded(
    own: Parameters, base: Parameters, files: Sequence[tuple[Path | None, Parameters]]
) -> Parameters:
    """Apply the sections of files in turn, and what each changes in derived parameters."""
    given: Parameters = {source: {} for source in SOURCES}
    parameters = _over(base)
    before = _derived(*(own[source] for source in SOURCES))
    for file, sections in files:
        given = {source: given[source] | sections.get(source, {}) for source in SOURCES}
        arm, mocap = (own[source] | given[source] for source in SOURCES)
        mocap = _with_body(mocap, given["pancake_tracker"])
        after = _derived(arm, mocap)
        changes = {
            node: {k: v for k, v in values.items() if before[node].get(k) != v}
            for node, values in after.items()
        }
        if file and "torque_controller" in sections:
            changes["learner"]["controller"] = [*parameters["learner"]["controller"], str(file)]
        topics = {name: mocap[name] for name in ("pose_topic", "markers_topic")}
        parameters = _over(parameters, changes, sections, {"pancake_tracker": topics})
        before = after
    return parameters


def _over(below: Parameters, *above: Mapping[str, Mapping[str, Any]]) -> Parameters:
    """Parameters by node, later ones over earlier ones."""
    nodes = {node: dict(values) for node, values in below.items()}
    for each in above:
        for node, values in each.items():
            nodes[node] |= values
    return nodes


def read(file: Path) -> Setup:
    """Read a set-up that was written with `text`, such as `logs/parameters.yaml` of a session.

    Parameters that it lacks, because an older version wrote it, are those of the nodes' own files.
    """
    return Setup(_own()).changed(parameter_file.of_nodes(file))


def _own() -> Parameters:
    return {node: _read(share(f"config/{node}.yaml"))[node] for node in NODES}


def text(setup: Setup) -> str:
    """Text of one parameter file for all nodes, in any namespace."""
    nodes = {f"/**/{node}": {"ros__parameters": values} for node, values in setup.items()}
    return yaml.dump(nodes, Dumper=_Plain, sort_keys=False, width=1000)


class _Plain(yaml.SafeDumper):
    """YAML for ROS: without references, and with quoted strings, because ROS reads y as true."""

    def ignore_aliases(self, data: object) -> bool:
        """Write a repeated list in full."""
        return True


_Plain.add_representer(str, lambda to, text: to.represent_scalar(_STR, text, style='"'))
_Plain.add_representer(list, lambda to, items: to.represent_sequence(_SEQ, items, flow_style=True))


def _read(file: Path, namespace: str = "") -> Parameters:
    found = parameter_file.of_nodes(file, namespace)
    for values in found.values():  # the URDF path may be relative to the set-up file
        if values.get("urdf") and (urdf := file.parent / str(values["urdf"])).is_file():
            values["urdf"] = str(urdf.resolve())
    return found


def _sections(
    file: Path, own: Parameters, namespace: str = "", renamed: Mapping[str, str] | None = None
) -> Parameters:
    """Checked parameters by node from one file; those of all nodes are given to each that has them.

    With `renamed`, the kinds of nodes by the name that they were started with, the file is one of
    ROS, and unknown nodes are those of others.
    """
    found = _read(file, namespace)
    common = found.pop(parameter_file.ALL_NODES, {})
    every = {name: values for node in own.values() for name, values in node.items()}
    _check(file, "every node", common, every)
    sections: Parameters = {
        node: {
            name: value
            for name, value in common.items()
            if name in own[node] or parameter_file.of_ros(name)
        }
        for node in NODES
    }
    for name, values in found.items():
        node = (renamed or {}).get(name, name)
        if node in own:
            _check(file, node, values, own[node])
            sections[node] |= values
        elif renamed is None:
            raise ValueError(f"{file} has parameters for {node!r}; the nodes are {list(NODES)}")
    tracker = sections["pancake_tracker"]
    for topic, other in itertools.permutations(("pose_topic", "markers_topic")):
        if tracker.get(topic) and other not in tracker:
            tracker[other] = ""  # a source replaces that of a file before
    return {
        node: {name: _of_kind(value, own[node].get(name, value)) for name, value in values.items()}
        for node, values in sections.items()
        if values
    }


def _check(file: Path, node: str, values: Mapping[str, Any], own: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if parameter_file.of_ros(name):
            continue
        if name not in own:
            near = difflib.get_close_matches(str(name), own, n=1)
            hint = f"; is it {near[0]}?" if near else f"; it has {sorted(own)}"
            raise ValueError(f"{file}: {node} has no parameter {name!r}{hint}")
        if not _same_kind(value, default := own[name]):
            shown = reprlib.repr(value)  # the value may be a whole file
            like = f"one like {default!r}"
            raise ValueError(f"{file}: {name} of {node} is {shown}; allowed is {like}")


def _same_kind(value: object, default: object) -> bool:
    """Whether a value has the type of the default; an int may replace a float."""
    if isinstance(default, list):
        if not isinstance(value, list) or not (value or isinstance(default[0], str)):
            return False
        return all(_same_kind(item, default[0]) for item in value)
    return type(value) is type(default) or (type(value) is int and type(default) is float)


def _of_kind(value: Any, default: Any) -> Any:  # noqa: ANN401 - of any kind
    """Value of the kind of a default, as ROS tells a whole number from a float.

    A list of both, or an empty one, ends a node before it can say which parameter it is.
    """
    if isinstance(value, list):
        return [_of_kind(item, default[0]) for item in value] or [""]
    return float(value) if isinstance(default, float) else value


def _with_body(mocap: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Motion capture with the body's name in its pose topic, or without topics if there is none."""
    body = mocap["body"]
    if not body:
        return {**mocap, "pose_topic": "", "markers_topic": ""}
    if given.get("markers_topic") and "pose_topic" not in given:
        return dict(mocap)
    return {**mocap, "pose_topic": given.get("pose_topic", "{body}/pose").replace("{body}", body)}


def _derived(arm: Mapping[str, Any], mocap: Mapping[str, Any]) -> Parameters:
    """Derive parameters of other nodes, stand-ins included, from the arm's and the cameras'."""
    model = ("joint_names", "model_joint_names", "urdf", "base_frame", "tool_frame")
    driver = ("period", "state_topic", "velocity_topic", "command_topic", "command_type", "output")
    world = ("guarded_names", "guarded_links", "guarded_points", REGION)
    cameras = ("body", "single_marker", "pose_topic", "markers_topic", "message_type")
    cameras += ("body_in_message", "up_axis", "world_to_base", "rate")
    topics = [name for name in (arm["command_topic"], arm["velocity_topic"]) if name]
    derived: Parameters = {
        "demonstration_recorder": {
            "state_topic": arm["state_topic"],
            **{name: arm[name] for name in (*model, "position_limits")},
            "driver_topics": topics,
            "body": mocap["body"],
            "mocap_topics": [mocap["pose_topic"] or mocap["markers_topic"]],
        },
        "pancake_tracker": {"base_frame": arm["base_frame"]},
        "tag_camera": {"body": mocap["body"]},
        "franka_driver": {
            name: arm[name] for name in ("joint_names", "state_topic", "command_topic", "period")
        },
        "natnet_client": {"body": mocap["body"], "frame": mocap["mocap_frame"]},
        "learner": {name: arm[name] for name in model},
        "wam_sim": {
            **{name: arm[name] for name in (*model, "position_limits", *driver, *world)},
            "driver_compensates_gravity": arm["driver_compensates_gravity"],
            "velocity": "empty" if arm["velocity_topic"] else "filled",
            "effort": {"torque": "filled", "none": "empty"}.get(arm["effort"], arm["effort"]),
        },
        "optitrack_sim": {name: mocap[name] for name in cameras} | {"frame": mocap["mocap_frame"]},
    }
    if mocap["latency_offset"]:  # stamps are later than the exposure
        derived["optitrack_sim"] |= {"stamps": "receipt", "latency": mocap["latency_offset"]}
    return derived
