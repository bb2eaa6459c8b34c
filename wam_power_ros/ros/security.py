# SPDX-License-Identifier: Apache-2.0
"""Who may do what on the network: one table, and the SROS2 policy made of it.

Least privilege: a node has an enclave (a key) of its own and may do there what the table says and
nothing else. Torques are published by the controller alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from wam_power_ros.ros import interface

if TYPE_CHECKING:
    from wam_power_ros.params.overlay import Setup

ABOUT_ITSELF = (  # services that every node offers about itself; nobody is allowed to call them
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


@dataclass(frozen=True)
class Access:
    """What one node may do; names of topics and services.

    Attributes:
        publishes: Topics.
        subscribes: Topics.
        serves: Services it offers.
        calls: Services of others.
        managed: It has a life cycle.
        process: Whose enclave it lives in; a process has one.
    """

    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    managed: bool = False
    process: str = ""


def table(setup: Setup) -> dict[str, Access]:
    """Rights of every node under a set-up; of the stand-ins, the teacher and a person as well.

    Args:
        setup: Of `setups.setup`, which knows topics by the names that drivers give them.
    """
    arm, mocap, recorder = (
        setup[node] for node in ("torque_controller", "pancake_tracker", "demonstration_recorder")
    )
    body = mocap["body"]
    reset, truth = interface.body_topic(body, "reset"), interface.body_topic(body, "truth")
    of_body = ()  # what the tracker makes of the body's poses
    if body:
        of_body = (interface.body_topic(body, "state"), interface.rollout_topic(body))
    seen = mocap["pose_topic"] or mocap["markers_topic"]
    idle = arm["idle_service"] or interface.WAM_IDLE
    states = tuple(filter(None, (arm["state_topic"], arm["velocity_topic"])))
    described = () if arm["urdf"] else (interface.ROBOT_DESCRIPTION,)
    lists = ("driver_topics", "mocap_topics", "topics", "latched_topics")
    recorded = dict.fromkeys(
        _absolute(topic)
        for topic in (
            arm["state_topic"],
            *(topic for name in lists for topic in recorder[name] if topic),
            *of_body,
        )
    )
    feedback = (
        interface.LEARNER_REWARD,
        interface.LEARNER_PUNISH,
        interface.LEARNER_DEMONSTRATION,
        interface.LEARNER_PAUSE,
    )
    rights = {
        "torque_controller": Access(
            publishes=(arm["command_topic"], interface.ROLLOUT_END_EFFECTOR, interface.DIAGNOSTICS),
            subscribes=(
                *states,
                *described,
                arm["command_topic"],  # to hear another commander
                interface.POLICY,
                interface.REPLAY_TRAJECTORY,
                interface.ENABLE,
            ),
            serves=(
                interface.EXECUTE,
                interface.STOP,
                interface.RESET,
                interface.MOVE_TO_START,
                interface.REPLAY,
                interface.GRAVITY_COMPENSATION,
            ),
            calls=(idle,),
            managed=True,
        ),
        "demonstration_recorder": Access(
            publishes=(interface.DIAGNOSTICS,),
            subscribes=tuple(dict.fromkeys((*recorded, interface.POLICY))),
            serves=(interface.RECORD,),
        ),
        "pancake_tracker": Access(
            publishes=(*of_body, interface.DIAGNOSTICS),
            subscribes=(seen, interface.ROLLOUT_END_EFFECTOR),
        ),
        "learner": Access(
            publishes=(interface.POLICY,),
            subscribes=(
                interface.ROLLOUT_END_EFFECTOR,
                *of_body,
                truth,
                interface.DIAGNOSTICS,
                interface.LEARNER_BAG,
            ),
            serves=feedback,
            calls=(
                interface.MOVE_TO_START,
                interface.EXECUTE,
                reset,
                interface.RESET,
                interface.RECORD,
            ),
        ),
        "teaching": Access(
            calls=(
                interface.GRAVITY_COMPENSATION,
                interface.RECORD,
                reset,
                interface.DEMONSTRATE,
            ),
            process="operator",
        ),
        "replaying": Access(
            publishes=(interface.REPLAY_TRAJECTORY,),
            calls=(interface.REPLAY, interface.STOP, interface.RECORD),
            process="operator",
        ),
        "enabling_switch": Access(publishes=(interface.ENABLE,), process="operator"),
        "feedback": Access(publishes=(interface.LEARNER_BAG,), calls=feedback, process="operator"),
        "operator": Access(  # a person with `ros2 service call`, `ros2 lifecycle set`
            publishes=(interface.REPLAY_TRAJECTORY, interface.LEARNER_BAG),
            subscribes=(interface.DIAGNOSTICS,),
            calls=(
                interface.EXECUTE,
                interface.STOP,
                interface.RESET,
                interface.MOVE_TO_START,
                interface.REPLAY,
                interface.GRAVITY_COMPENSATION,
                interface.RECORD,
                *feedback,
                *(f"/torque_controller/{name}" for name in LIFECYCLE),
            ),
        ),
        "wam_sim": Access(
            publishes=(
                *states,
                interface.ROBOT_DESCRIPTION,
                truth,
                interface.CLOCK,
                interface.DIAGNOSTICS,
            ),
            subscribes=(arm["command_topic"], interface.POLICY),
            serves=(
                interface.WAM_GRAVITY_COMPENSATE,
                interface.WAM_HOLD,
                interface.WAM_MOVE_HOME,
                interface.WAM_IDLE,
                reset,
                *((interface.body_topic(body, "drop"),) if body else ()),
                interface.DEMONSTRATE,
            ),
        ),
        "optitrack_sim": Access(
            publishes=(
                (seen, interface.body_topic(body, "pose"), interface.MARKERS) if body else ()
            ),
            process="wam_sim",
        ),
    }
    if not body:
        del rights["pancake_tracker"], rights["optitrack_sim"]
    return rights


def policy(rights: Mapping[str, Access]) -> str:
    """A table as the text of an SROS2 policy, one enclave a process.

    `ros2 security generate_artifacts` makes keys and signed permissions of it.
    """
    root = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(root, "enclaves")
    of_process: dict[str, ElementTree.Element] = {}
    for node, access in rights.items():
        process = access.process or node
        if process not in of_process:
            enclave = ElementTree.SubElement(enclaves, "enclave", path=f"/{process}")
            of_process[process] = ElementTree.SubElement(enclave, "profiles")
        profile = ElementTree.SubElement(of_process[process], "profile", ns="/", node=node)
        own = [*ABOUT_ITSELF, *(LIFECYCLE if access.managed else ())]
        events = ["~/transition_event"] if access.managed else []
        _allow(
            profile, "topic", publish=[*access.publishes, *events, "/rosout", "/parameter_events"]
        )
        _allow(profile, "topic", subscribe=[*access.subscribes, interface.CLOCK])
        _allow(profile, "service", reply=[*access.serves, *(f"~/{name}" for name in own)])
        _allow(profile, "service", request=[*access.calls])
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n'


def _allow(profile: ElementTree.Element, kind: str, **names: list[str]) -> None:
    """Add names that are allowed for what the keyword says."""
    ((what, allowed),) = names.items()
    if not allowed:
        return
    element = ElementTree.SubElement(profile, f"{kind}s", {what: "ALLOW"})
    for name in sorted(set(allowed)):
        text = f"/{profile.get('node')}{name[1:]}" if name.startswith("~") else _absolute(name)
        ElementTree.SubElement(element, kind).text = text


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def exposed(environment: Mapping[str, str]) -> str | None:
    """Why others on the network could command this arm, None when they cannot.

    Args:
        environment: Variables of the process.
    """
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    secure = environment.get("ROS_SECURITY_ENABLE") == "true"
    if reach in ("LOCALHOST", "OFF") or (
        secure and environment.get("ROS_SECURITY_STRATEGY") == "Enforce"
    ):
        return None
    return (
        f"anybody on the network can command this arm: discovery range {reach}, security not "
        "enforced; set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, or see SECURITY.md"
    )
