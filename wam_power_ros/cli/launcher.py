# SPDX-License-Identifier: Apache-2.0
"""Runs a plan from this terminal: holds its DDS domain and folder, starts its nodes, ends them."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from wam_power_ros import installed
from wam_power_ros.cli.plan import DOMAIN_FILE, LEARNER, RECORDER, SIMULATION, TRACKER, Plan
from wam_power_ros.cli.processes import ProcessError, Processes, Running
from wam_power_ros.console.prompt import confirm, show
from wam_power_ros.durable_files import check_name, is_locked
from wam_power_ros.entry import SIGNALS
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import robot_description
from wam_power_ros.ros import network
from wam_power_ros.ros.domain import exported, lock, private_domain, shared

if TYPE_CHECKING:
    from wam_power_ros.client.robot import Robot

MEGABYTE = 1e6
ENCLAVE = "ROS_SECURITY_ENCLAVE_OVERRIDE"  # environment variable


class UsageError(Exception):
    """The request cannot be carried out; the message says what to do instead."""


@dataclass(frozen=True)
class Devices:
    """Choice of set-ups."""

    config: Sequence[str] = ()  # set-ups, by name or path; later ones override earlier ones
    simulate: bool = False  # whether stand-ins with the same interfaces replace their devices

    @property
    def stand_ins(self) -> bool:
        """Whether stand-ins take the place of the devices."""
        return self.simulate or not self.config

    def parameters(
        self, task: str = "", seed: int = 0, folder: Path | None = None
    ) -> overlay.Setup:
        """Parameters by node: the task's, which those of the set-ups override.

        Bags go to `folder`/bags; None for the folder of the set-up.

        Raises:
            ValueError: A set-up or the task is unknown or invalid, the scene of the stand-ins has
                another body, or the URDF lacks joints or links that the set-up names.
        """
        setup = overlay.setup(self.config, self.simulate, task)
        check(setup)
        if task and self.stand_ins:
            scene, body = setup[SIMULATION]["scene"], setup[TRACKER]["body"]
            if (simulated := installed.find("scene", scene).body) != body:
                both = f"body {simulated!r} of scene {scene!r}; task {task!r} has {body!r}"
                raise ValueError(f"{both}: set the scene of {SIMULATION}")
        setup = setup.changed({SIMULATION: {"seed": seed}})
        if folder is None:
            return setup
        check_name(folder)
        return setup.changed({RECORDER: {"directory": str(folder / "bags")}})


def check(setup: overlay.Setup) -> None:
    """Refuse what controller and tracker would refuse, before anything starts.

    Raises:
        ValueError: A parameter is out of range or contradicts another, or the URDF lacks joints or
            links that the set-up names.
    """
    from wam_power_ros.params.body_tracker_params import BodyTrackerParams
    from wam_power_ros.params.torque_controller_params import TorqueControllerParams

    controller = TorqueControllerParams.from_setup(setup)
    if setup.arm() is not None:
        controller.controller(robot_description(controller.urdf))
    if setup["pancake_tracker"]["body"]:
        BodyTrackerParams.from_setup(setup)


@dataclass(frozen=True)
class Launcher:
    """Running nodes of a plan."""

    plan: Plan
    processes: Processes

    def node(self, name: str, **parameters: object) -> Running:
        """Start a node of the plan; `parameters` override its own."""
        return self.processes.start(name, self.plan.command(name, secured(), **parameters))

    @contextmanager
    def robot(self) -> Iterator[Robot]:
        """Connect this process to the nodes; the first SIGINT or SIGTERM interrupts, others do not.

        Raises:
            ProcessError: A node has ended, or a service does not appear, answer in time or agree.
        """
        from wam_power_ros.client.link import LOG_AFTER
        from wam_power_ros.client.robot import connected
        from wam_power_ros.ros.node_runner import interrupt_on_signals
        from wam_power_ros.ros.outcomes import ServiceError

        plan, domain = self.plan, session_domain(self.plan.folder)
        with ExitStack() as stack:
            for number in SIGNALS:
                stack.callback(signal.signal, number, signal.getsignal(number))
            interrupt_on_signals()
            if secured() and ENCLAVE not in os.environ:
                os.environ[ENCLAVE] = "/operator"
                stack.callback(os.environ.pop, ENCLAVE)
            try:
                arm = connected(plan.parameters, domain, on_loopback=plan.stand_ins)
                robot = stack.enter_context(arm)
                robot.link.log_period = LOG_AFTER
                with self.processes.watched(robot.link.fail):
                    yield robot
            except ServiceError as error:
                raise ProcessError(str(error)) from None


@contextmanager
def launch(plan: Plan, text: str = "") -> Iterator[Launcher]:
    """Start the nodes of a plan, except a learner, and activate the controller of an arm.

    `text` is shown once nothing stands against it.

    Raises:
        UsageError: Another session or learner uses the folder, or its disk is nearly full.
        ValueError: Nobody can answer, because standard input is closed.
        DomainError: Another session holds the robot's DDS domain, or ROS_DOMAIN_ID is invalid.
    """
    # First, because an import of rclpy may execute the program anew.
    from wam_power_ros.console.activation import activate

    check_space(plan.folder, plan.parameters[RECORDER]["free_to_start"])
    files = plan.written
    with ExitStack() as stack:
        if plan.stand_ins:
            domain = stack.enter_context(private_domain())
            environment = network.ON_LOOPBACK | shared(domain)
            files[plan.file.with_name(DOMAIN_FILE)] = f"{domain}\n"
        else:
            domain = exported(os.environ)
            if held := lock(domain):
                stack.enter_context(held)
            reach = os.environ.get(network.RANGE) or "LOCALHOST"  # this machine alone
            environment = {network.RANGE: reach} | shared(domain)
        stack.enter_context(folder_lock(plan.folder))
        if text:
            show(text)
        if plan.stand_ins:
            show(
                f"The simulation uses ROS_DOMAIN_ID {domain} so that it reaches no robot. To see "
                f"its topics in another terminal: export ROS_DOMAIN_ID={domain}"
            )
        else:  # before `activate`
            confirm(
                "The controller will hold the arm in its current posture once the driver sends "
                "states. Keep a hand on the pendant, then press Enter: "
            )
        for file, text in files.items():
            file.write_text(text, encoding="utf-8")
        launcher = Launcher(plan, stack.enter_context(Processes(plan.file.parent, environment)))
        for name in plan.nodes:
            if name != LEARNER:
                launcher.node(name)
        if not plan.stand_ins:
            with launcher.robot() as robot:
                activate(robot.link)
        yield launcher


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Lock a folder against other launchers, before anything is written there.

    Raises:
        UsageError: Another launcher or a learner holds the folder.
    """
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    with (folder / "logs" / ".lock").open("a") as file:
        held = learner_is_running(folder)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            held = True
        if held:
            raise UsageError(f"another session or learner is using {folder}")
        yield


def learner_is_running(folder: Path) -> bool:
    """Whether a learner is running in a session folder."""
    return is_locked(folder / ".lock")


def check_space(folder: Path, needed: float) -> None:
    """Raise a UsageError if a disk has less than `needed` [MB], before a person teaches."""
    existing = next(path for path in (folder, *folder.resolve().parents) if path.exists())
    free = shutil.disk_usage(existing).free / MEGABYTE
    if free < needed:
        raise UsageError(
            f"{free:.0f} MB free on the disk of {folder}, {needed:.0f} MB needed: free some space"
        )


def session_domain(folder: Path) -> int | None:
    """DDS domain of a session in simulation; None on an arm, whose domain is in ROS_DOMAIN_ID."""
    file = folder / "logs" / DOMAIN_FILE
    text = file.read_text().strip() if file.exists() else ""
    return int(text) if text else None


def task_stems() -> dict[str, set[str]]:
    """Map each stem of bag names to the tasks whose demonstrations have it."""
    tasks: dict[str, set[str]] = {}
    for name in installed.names("task"):
        recorder = overlay.setup(task=name)["demonstration_recorder"]
        tasks.setdefault(recorder["stem"], set()).add(name)
    return tasks


def secured() -> bool:
    """Whether this terminal asks for SROS2."""
    return os.environ.get("ROS_SECURITY_ENABLE") == "true"


def timestamp() -> str:
    """Current time as a folder name."""
    return datetime.now().strftime("%Y-%m-%d-%H%M%S")


def short_path(path: Path) -> Path:
    """Path relative to the working directory where it lies below it."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
