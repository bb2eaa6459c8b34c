# SPDX-License-Identifier: Apache-2.0
"""Access rights on the network: one table, and the SROS2 policy generated from it.

Least privilege: a node has its own enclave (a key) and may do only what the table allows. Only the
controller publishes torques.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from wam_power_ros.ros import interface, network

if TYPE_CHECKING:
    from wam_power_ros.params.overlay import Setup

NODE_SERVICES = (  # services that every node offers; nobody may call them
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
LIFECYCLE = (
    "change_state",
    "get_available_states",
    "get_available_transitions",
    "get_state",
    "get_transition_graph",
)


CONTROLLER = "STOP RESET GRAVITY_COMPENSATION"
FEEDBACK = "LEARNER_REWARD LEARNER_PUNISH LEARNER_PAUSE"
# Node -> rights -> names: constants of `interface`; names in lower case are derived from the set-up
# by `_names`. The controller subscribes to its own command topic to detect another commander.
TABLE: dict[str, dict[str, str]] = {
    "torque_controller": {
        "publishes": "command",
        "subscribes": "states description command ENABLE",
        "serves": CONTROLLER,
        "calls": "idle",
    },
    "torque_controller_preparation": {
        "publishes": "CONTROLLER_ANSWER POLICY ROLLOUT_END_EFFECTOR DIAGNOSTICS",
        "subscribes": "CONTROLLER_REQUEST REPLAY",
    },
    "demonstration_recorder": {
        "publishes": "DIAGNOSTICS",
        "subscribes": "recorded state rollout POLICY",
        "serves": "RECORD",
    },
    "pancake_tracker": {
        "publishes": "state rollout DIAGNOSTICS",
        "subscribes": "mocap ROLLOUT_END_EFFECTOR",
    },
    "learner": {
        "publishes": "CONTROLLER_REQUEST REPLAY SCENE_REQUEST LEARNER_ANSWER LEARNER_MARKERS "
        "DIAGNOSTICS",
        "subscribes": "CONTROLLER_ANSWER SCENE_ANSWER LEARNER_REQUEST ROLLOUT_END_EFFECTOR state "
        "rollout truth DIAGNOSTICS",
        "serves": FEEDBACK,
        "calls": "RESET RECORD",
    },
    "teaching": {
        "publishes": "SCENE_REQUEST",
        "subscribes": "SCENE_ANSWER",
        "calls": "GRAVITY_COMPENSATION RECORD",
    },
    "replaying": {
        "publishes": "REPLAY",
        "subscribes": "CONTROLLER_ANSWER",
        "calls": "STOP RECORD",
    },
    "running_policy": {
        "publishes": "CONTROLLER_REQUEST SCENE_REQUEST",
        "subscribes": "CONTROLLER_ANSWER SCENE_ANSWER ROLLOUT_END_EFFECTOR state rollout truth "
        "DIAGNOSTICS",
        "calls": "STOP RESET RECORD",
    },
    "activation": {"subscribes": "DIAGNOSTICS", "calls": "lifecycle"},
    "enabling_switch": {"publishes": "ENABLE"},
    "feedback": {
        "publishes": "LEARNER_REQUEST",
        "subscribes": "LEARNER_ANSWER",
        "calls": f"STOP {FEEDBACK}",
    },
    "view": {
        "publishes": "LEARNER_REQUEST SCENE_REQUEST",
        "subscribes": "states description POLICY ROLLOUT_END_EFFECTOR DIAGNOSTICS state "
        "LEARNER_ANSWER SCENE_ANSWER",
        "calls": f"STOP GRAVITY_COMPENSATION RECORD {FEEDBACK}",
    },
    "operator": {  # a person with `ros2 service call`, `ros2 lifecycle set`, `ros2 topic hz`
        "publishes": "LEARNER_REQUEST",
        "subscribes": "DIAGNOSTICS states state LEARNER_ANSWER",
        "calls": f"{CONTROLLER} RECORD {FEEDBACK} lifecycle",
    },
    "wam_sim": {
        "publishes": "states ROBOT_DESCRIPTION truth SCENE_ANSWER CLOCK DIAGNOSTICS",
        "subscribes": "command SCENE_REQUEST",
        "serves": "WAM_GRAVITY_COMPENSATE WAM_HOLD WAM_MOVE_HOME WAM_IDLE drop",
    },
    "optitrack_sim": {"publishes": "mocap pose MARKERS"},
}
NODE_NAMES = {"operator": "_ros2cli*"}  # names that differ: each `ros2` command has its own
LIFECYCLE_NODES = {"torque_controller"}
BODY_NODES = {"pancake_tracker", "optitrack_sim"}  # run only for a task with a tracked body
PROCESSES = {  # node -> process whose enclave it shares; every other node has its own
    **dict.fromkeys(
        (
            "teaching",
            "replaying",
            "running_policy",
            "activation",
            "enabling_switch",
            "feedback",
            "view",
        ),
        "operator",
    ),
    "optitrack_sim": "wam_sim",
    "torque_controller_preparation": "torque_controller",  # its two processes
}


@dataclass(frozen=True)
class Access:
    """Names of the topics and services that one node may use."""

    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()


def table(setup: Setup, namespace: str = "") -> dict[str, Access]:
    """Rights of every node under a set-up of `overlay.setup`, stand-ins and console included.

    Args:
        setup: Parameters by node.
        namespace: Namespace of the arm's nodes; empty for none.
    """
    names = _names(setup)

    def resolved(words: str) -> tuple[str, ...]:
        found = (names[w] if w in names else (getattr(interface, w),) for w in words.split())
        flat = dict.fromkeys(name for group in found for name in group)
        return tuple(resolved_name(name, namespace) for name in flat)

    return {
        node: Access(**{right: resolved(words) for right, words in rights.items()})
        for node, rights in TABLE.items()
        if setup["pancake_tracker"]["body"] or node not in BODY_NODES
    }


def _names(setup: Setup) -> dict[str, tuple[str, ...]]:
    """Topics and services that depend on the set-up, by their names in `TABLE`."""
    nodes = ("torque_controller", "pancake_tracker", "demonstration_recorder")
    arm, mocap, recorder = (setup[node] for node in nodes)
    body = mocap["body"]
    leaves = interface.BODY_LEAVES if body else interface.SCENE_LEAVES
    recorded = ("driver_topics", "mocap_topics", "topics", "latched_topics")
    return {
        **dict.fromkeys(interface.BODY_LEAVES, ()),
        **{leaf: (interface.body_topic(body, leaf),) for leaf in leaves},
        "rollout": (interface.rollout_topic(body),) if body else (),
        "command": (arm["command_topic"],),
        "states": tuple(filter(None, (arm["state_topic"], arm["velocity_topic"]))),
        "description": () if arm["urdf"] else (interface.ROBOT_DESCRIPTION,),
        "idle": (arm["idle_service"] or interface.WAM_IDLE,),
        "mocap": (mocap["pose_topic"] or mocap["markers_topic"],),
        "recorded": (arm["state_topic"], *filter(None, chain(*map(recorder.get, recorded)))),
        "lifecycle": tuple(f"torque_controller/{name}" for name in LIFECYCLE),
    }


def resolved_name(name: str, namespace: str) -> str:
    """Full name of a topic or service; in a namespace each arm has its own /clock."""
    inside = f"/{namespace.strip('/')}".rstrip("/")
    if name == interface.CLOCK:
        return f"{inside}{name}"
    return name if name.startswith("/") else f"{inside}/{name}"


def policy(rights: Mapping[str, Access], namespace: str = "") -> str:
    """SROS2 policy of a table, one enclave per process, for `ros2 security generate_artifacts`.

    Args:
        rights: Rights by node, of `table` with the same namespace.
        namespace: Namespace of the arm's nodes; empty for none.
    """
    inside = f"/{namespace.strip('/')}".rstrip("/")
    root = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(root, "enclaves")
    profiles: dict[str, ElementTree.Element] = {}
    for node, access in rights.items():
        process = PROCESSES.get(node, node)
        if process not in profiles:
            enclave = ElementTree.SubElement(enclaves, "enclave", path=f"{inside}/{process}")
            profiles[process] = ElementTree.SubElement(enclave, "profiles")
        own_namespace = "" if node in NODE_NAMES else inside  # nodes of `ros2` are in none
        profile = ElementTree.SubElement(
            profiles[process], "profile", ns=own_namespace or "/", node=node
        )
        managed = node in LIFECYCLE_NODES
        own = {f"~/{name}" for name in NODE_SERVICES + (LIFECYCLE if managed else ())}
        topics = {"/rosout", "/parameter_events"} | ({"~/transition_event"} if managed else set())
        for kind, right, names in (
            ("topic", "publish", topics.union(access.publishes)),
            ("topic", "subscribe", {*access.subscribes, resolved_name(interface.CLOCK, namespace)}),
            ("service", "reply", own.union(access.serves)),
            ("service", "request", set(access.calls)),
        ):
            if names:
                group = ElementTree.SubElement(profile, f"{kind}s", {right: "ALLOW"})
                for name in sorted(names):
                    named = f"{own_namespace}/{NODE_NAMES.get(node, node)}"
                    ElementTree.SubElement(group, kind).text = name.replace("~", named)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n'


def check_keystore(environment: Mapping[str, str], arguments: Sequence[str]) -> None:
    """Check that a process has its keys if security is enforced.

    Args:
        environment: Environment of the process.
        arguments: Its command line, which names its enclave.

    Raises:
        ValueError: The keystore or the enclave is missing; the message names it.
    """
    if not _enforced(environment):
        return
    keystore = environment.get("ROS_SECURITY_KEYSTORE", "")
    named = dict(pairwise(arguments)).get("--enclave", "/")
    enclave = environment.get("ROS_SECURITY_ENCLAVE_OVERRIDE") or named
    folder = Path(keystore) / "enclaves" / enclave.lstrip("/")
    if not keystore:
        missing = "ROS_SECURITY_KEYSTORE is not set"
    elif not folder.is_dir():
        missing = f"there is no enclave {enclave} in the keystore, no folder {folder}"
    else:
        return
    raise ValueError(f"security is enforced, but {missing}: see SECURITY.md")


def exposed(environment: Mapping[str, str]) -> str | None:
    """Reason why others on the network can command this arm; None if they cannot."""
    reason = network.wider_reach(environment)
    if _enforced(environment) or environment.get(network.RANGE) == "OFF" or reason is None:
        return None
    return (
        f"anybody on the network can command this arm: {reason}, security not enforced. Remove "
        f"that setting and set {network.RANGE}=LOCALHOST to bind sockets to this machine's "
        "loopback interface, or enforce security: see SECURITY.md"
    )


def _enforced(environment: Mapping[str, str]) -> bool:
    switches = map(environment.get, ("ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"))
    return [*switches] == ["true", "Enforce"]
