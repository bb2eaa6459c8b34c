# SPDX-License-Identifier: Apache-2.0
"""Access rights: the table holds what the nodes use, and the policy holds the table."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rclpy
from conftest import ROOT, Processes
from layouts import uses
from rclpy.node import Node

from hardware_sim.main import Simulation
from hardware_sim.optitrack_node import OptitrackSim
from wam_power_ros.cli import main
from wam_power_ros.nodes.body_tracker import BodyTracker
from wam_power_ros.nodes.demonstration_recorder import DemonstrationRecorder
from wam_power_ros.nodes.learner import Learner
from wam_power_ros.nodes.preparation_worker import PreparationWorker
from wam_power_ros.nodes.torque_controller import TorqueController
from wam_power_ros.params import overlay
from wam_power_ros.ros import interface, security
from wam_power_ros.ros.process_channel import pair
from wam_power_ros.view.live import View

RIGHTS = security.table(overlay.setup())
RELATIVE = {
    value
    for name, value in vars(interface).items()
    if name.isupper() and isinstance(value, str) and not name.endswith("_FRAME")
} - {interface.SCENE}
RELATIVE |= {interface.body_topic("pancake", leaf) for leaf in interface.BODY_LEAVES}
NAMES = {f"/{name.lstrip('/')}" for name in RELATIVE | {interface.rollout_topic("pancake")}}
NODES = {
    "torque_controller_preparation": lambda: PreparationWorker(pair()[0]),
    "torque_controller": TorqueController,
    "demonstration_recorder": DemonstrationRecorder,
    "pancake_tracker": BodyTracker,
    "learner": Learner,
    "wam_sim": lambda: Simulation().wam,  # offers services once its world is built
    "optitrack_sim": OptitrackSim,
    "view": lambda: View(overlay.setup()["torque_controller"], "pancake"),
}


def test_the_shipped_policy_is_that_of_the_table() -> None:
    assert (ROOT / "security/policy.xml").read_text() == security.policy(RIGHTS), (
        "wam-power policy > security/policy.xml"
    )


def test_every_topic_and_service_is_somebodys_and_no_other_is() -> None:
    used = {
        name
        for right in RIGHTS.values()
        for names in (right.publishes, right.subscribes, right.serves, right.calls)
        for name in names
    }
    assert NAMES - used == set()
    own = {name for name in used if name.startswith("/torque_controller/")}
    assert used - NAMES == own


@pytest.mark.parametrize("name", [None, *overlay.known()])
def test_only_the_controller_publishes_torques(name: str | None) -> None:
    setup = overlay.setup([name] if name else [])
    root = ElementTree.fromstring(security.policy(security.table(setup)))
    torques = f"/{setup['torque_controller']['command_topic']}"
    senders = [
        profile.get("node")
        for profile in root.iter("profile")
        for topics in profile.iter("topics")
        if topics.get("publish") == "ALLOW" and torques in [topic.text for topic in topics]
    ]
    assert senders == ["torque_controller"]


def test_the_table_follows_the_name_of_the_body(tmp_path: Path) -> None:
    def named(body: str) -> dict[str, security.Access]:
        file = tmp_path / "body.yaml"
        file.write_text(f'pancake_tracker: {{ros__parameters: {{body: "{body}"}}}}')
        return security.table(overlay.setup([str(file)]))

    def topics(table: dict[str, security.Access]) -> dict[str, list[set[str]]]:
        return {
            node: [set(right.publishes), set(right.subscribes), set(right.serves), set(right.calls)]
            for node, right in table.items()
        }

    ball, none = named("ball"), named("")
    assert topics(ball) == {
        node: [{re.sub("pancake$|pancake(?=/)", "ball", name) for name in names} for names in kinds]
        for node, kinds in topics(RIGHTS).items()
    }
    assert set(RIGHTS) - set(none) == {"pancake_tracker", "optitrack_sim"}
    assert "/scene/truth" in none["learner"].subscribes
    assert not any("pancake" in name for right in none.values() for name in right.subscribes)


def test_the_recorder_only_listens_and_the_learner_only_proposes() -> None:
    recorder, learner = RIGHTS["demonstration_recorder"], RIGHTS["learner"]
    assert (recorder.publishes, recorder.calls) == ((interface.DIAGNOSTICS,), ())
    proposed = (interface.CONTROLLER_REQUEST, interface.REPLAY, interface.SCENE_REQUEST)
    proposes = {f"/{topic}" for topic in proposed}
    assert set(learner.publishes) - proposes == {
        interface.DIAGNOSTICS,
        f"/{interface.LEARNER_ANSWER}",
        f"/{interface.LEARNER_MARKERS}",
    }
    assert {name.split("/")[1] for name in learner.serves} == {"learner"}


def test_in_a_namespace_an_arm_has_rights_on_its_own_topics_and_no_other_arm() -> None:
    left, right = (
        ElementTree.fromstring(security.policy(security.table(overlay.setup(), name), name))
        for name in ("left", "right")
    )
    shared = {"/diagnostics", "/rosout", "/parameter_events"}

    def names(policy: ElementTree.Element) -> set[str]:
        texts = {item.text for kind in ("topic", "service") for item in policy.iter(kind)}
        return {text for text in texts if not text.startswith("/_ros2cli")}

    assert names(left) & names(right) == shared
    assert all(name.startswith("/left/") for name in names(left) - shared)
    assert {enclave.get("path").split("/")[1] for enclave in left.iter("enclave")} == {"left"}


@pytest.mark.parametrize("namespace", ["", "/left"])
@pytest.mark.parametrize("kind", NODES.values(), ids=NODES)
def test_a_node_does_what_it_may_and_may_what_it_does(
    kind: Callable[[], Node], namespace: str, domain_id: int, tmp_path: Path
) -> None:
    file = tmp_path / "parameters.yaml"
    setup = overlay.setup()
    for name in ("torque_controller", "demonstration_recorder", "wam_sim"):
        setup[name]["realtime_priority"] = 0  # the node is in this process
    file.write_text(overlay.text(setup))
    remaps = ["-r", f"__ns:={namespace}", "-r", "/clock:=clock"] if namespace else []
    rclpy.init(args=["--ros-args", "--params-file", str(file), *remaps], domain_id=domain_id)
    try:
        node = kind()
        name = node.get_name()
        right = security.table(setup, namespace)[name]
        whose = (name, node.get_namespace())
        clock = security.resolved_name(interface.CLOCK, namespace)
        everyones = {"/rosout", "/parameter_events", clock}
        own = {
            f"{namespace}/{name}/{service}"
            for service in (*security.NODE_SERVICES, *security.LIFECYCLE)
        }
        published = dict(node.get_publisher_names_and_types_by_node(*whose))
        shown = [use for use in uses() if f"{namespace}{use.topic}" in published]
        wrong = [use for use in shown if not use.fits(published[f"{namespace}{use.topic}"][0])]
        assert wrong == []
        heard = {topic for topic, _ in node.get_subscriber_names_and_types_by_node(*whose)}
        served = {topic for topic, _ in node.get_service_names_and_types_by_node(*whose)} - own
        called = {topic for topic, _ in node.get_client_names_and_types_by_node(*whose)}
        events = (
            {f"{namespace}/{name}/transition_event"} if name in security.LIFECYCLE_NODES else set()
        )
        assert published.keys() - everyones - events == set(right.publishes) - everyones
        assert heard - everyones <= set(right.subscribes)
        assert called <= set(right.calls)
        assert served == set(right.serves)
        node.destroy_node()
    finally:
        rclpy.shutdown()


def test_the_command_line_prints_the_policy_of_a_set_up(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main.main(["policy", "libbarrett", "--namespace", "left"]) == 0
    assert "<topic>/left/joint_torque_commands</topic>" in capsys.readouterr().out
    assert main.main(["policy", "libbarrett"]) == 0
    text = capsys.readouterr().out
    assert "<topic>/joint_torque_commands</topic>" in text
    assert f"/{interface.EFFORT_COMMANDS}" not in text


@pytest.mark.parametrize(
    ("environment", "open_"),
    [
        ({}, True),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, True),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}, True),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, False),
        ({"ROS_SECURITY_ENABLE": "true"}, True),
        ({"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}, False),
    ],
)
def test_an_arm_that_anybody_can_command_is_told(environment: dict[str, str], open_: bool) -> None:
    assert (security.exposed(environment) is not None) == open_


@pytest.mark.parametrize(
    ("environment", "says"),
    [
        ({}, "ROS_SECURITY_KEYSTORE is not set"),
        ({"ROS_SECURITY_KEYSTORE": "/nowhere"}, "no enclave /learner .* /nowhere/enclaves/learner"),
        ({"ROS_SECURITY_ENCLAVE_OVERRIDE": "/cook"}, "ROS_SECURITY_KEYSTORE is not set"),
    ],
)
def test_a_missing_keystore_is_one_clear_error(environment: dict[str, str], says: str) -> None:
    enforced = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    arguments = ["learner", "--ros-args", "--enclave", "/learner"]
    with pytest.raises(ValueError, match=says):
        security.check_keystore(enforced | environment, arguments)
    security.check_keystore(environment, arguments)  # security is not enforced


def test_an_enclave_that_is_there_is_accepted(tmp_path: Path) -> None:
    (tmp_path / "enclaves/cook").mkdir(parents=True)
    enforced = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    enforced |= {"ROS_SECURITY_KEYSTORE": str(tmp_path), "ROS_SECURITY_ENCLAVE_OVERRIDE": "/cook"}
    security.check_keystore(enforced, ["--enclave", "/learner"])


def test_the_controller_says_so_and_with_security_enforced_never_starts_in_the_open(
    processes: Processes, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "wam_power_ros.nodes.torque_controller", "--ros-args"]
    command += ["--params-file", str(ROOT / "config/torque_controller.yaml")]
    (tmp_path / "enclaves/torque_controller").mkdir(parents=True)  # an enclave without keys
    refused = processes.start(
        [*command, "--enclave", "/torque_controller"],
        ROS_SECURITY_ENABLE="true",
        ROS_SECURITY_STRATEGY="Enforce",
        ROS_SECURITY_KEYSTORE=str(tmp_path),
    )
    assert refused.wait(120) == 2
    assert re.search("security", processes.output(refused), re.IGNORECASE)
    assert "Traceback" not in processes.output(refused)
    telling = processes.start(command, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
    end = time.monotonic() + 60.0
    while "anybody on the network" not in processes.output(telling) and time.monotonic() < end:
        time.sleep(0.1)
    assert "anybody on the network" in processes.output(telling)
