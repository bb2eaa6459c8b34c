# SPDX-License-Identifier: Apache-2.0
"""Execute a saved policy on the arm, record each rollout and print its return.

A rollout is that of a learner: move to the start, wait until the body is ready, execute, hold.
Nothing is learnt. Ctrl-C stops the arm.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("wam_power_ros.console.run_policy", INTERRUPTED))

from dataclasses import fields
from pathlib import Path

from pydantic import Field
from rclpy.node import Node

from wam_power_ros.client.link import LOG_AFTER, Link
from wam_power_ros.client.robot import Robot, Stopped
from wam_power_ros.client.rollouts import Executed, RolloutSettings
from wam_power_ros.console.prompt import ask, show
from wam_power_ros.console.replay import SETTLE_TIME
from wam_power_ros.control.arm import Arm
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params.node_params import Names, Params, Timeout
from wam_power_ros.params.resources import robot_description
from wam_power_ros.practice import session
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import run_script
from wam_power_ros.tasks.task import Pose, Task


class RunPolicyParams(Params):
    """Parameters of the rollouts; those of `RolloutSettings` are the learner's.

    Attributes:
        policy: Path of the policy.
        rollouts: Number of rollouts.
        session: Folder of the session whose task is used; "" for the task's first preset.
        task: Name of the task.
        person: True to ask the person beside a real arm before each rollout.
        urdf: URDF of the arm: path, or a file of our share folder.
        model_joint_names: Names of its joints, base to tip.
        tool_frame: Its tool.
    """

    policy: str
    rollouts: int = Field(ge=1, le=1000, description="a day of rollouts")
    session: str
    task: str
    person: bool
    urdf: str
    model_joint_names: Names
    tool_frame: str
    scene_reset: bool
    reset_faults: bool
    record_rollouts: bool
    service_timeout: Timeout
    rollout_timeout: Timeout
    patience: Timeout


class RunningPolicy(Node):
    """Node of the script, with its parameters."""

    def __init__(self) -> None:
        super().__init__("running_policy", automatically_declare_parameters_from_overrides=True)
        self.params = RunPolicyParams.of(self)


def task_of(folder: str, name: str) -> tuple[Task | None, str]:
    """Task that scores the rollouts; None, with the reason, if it needs a session and has none."""
    if folder:
        return session.read(folder).task, ""
    try:
        return preset(name).make_task({}), ""
    except KeyError as error:
        why = f"task {name} measures by the demonstrations of a session ({error})"
        return None, f"{why}: run the policy in its folder"


def run(node: RunningPolicy) -> int:
    """Execute the policy as often as asked; returns the exit status."""
    params = node.params
    urdf = robot_description(params.urdf)
    arm = Arm(urdf, params.model_joint_names, params.tool_frame, guarded=())
    policy = session.read_policy(Path(params.policy), arm.identity())
    task, unscored = task_of(params.session, params.task)
    tool = Pose(*arm.tool_pose(policy.q_start))
    names = [each.name for each in fields(RolloutSettings)]
    settings = RolloutSettings(**{name: getattr(params, name) for name in names})
    body, settle_time = (task.body, task.settle_time) if task else ("", 0.0)
    with Link(node, log_period=LOG_AFTER) as link:
        robot = Robot(link, body=body, settings=settings, settle_time=settle_time)
        robot.stop()  # succeeds once the controller is active
        if unscored:
            show(f"No returns: {unscored}")
        show(f"Executing {policy.id}, {policy.basis.duration:.1f} s; Ctrl-C stops the arm")
        faults = 0
        try:
            for number in range(1, params.rollouts + 1):
                if params.person:
                    place = f"Put the {body} in its place. " if body else ""
                    question = f"{place}The arm will move to the start of {policy.id} and execute "
                    ask(f"{question}it ({number} of {params.rollouts}). Press Enter: ")
                done = robot.rollout(policy, lambda state: task.ready(state, tool) if task else "")
                faults += done.rollout.fault is not None
                show(f"{number} of {params.rollouts}: {outcome(task, policy, done)}")
        except Stopped:
            link.sleep(SETTLE_TIME)
            link.call(interface.RECORD, False)  # answers that there is none if it had not begun
            show("Stopped: the arm holds.")
            return INTERRUPTED
        finally:
            if params.person:
                ask("The arm holds. Support it, then press Enter to let it go: ")
    return 1 if faults else 0


def outcome(task: Task | None, policy: Policy, done: Executed) -> str:
    """Return of a rollout with its terms, or why it has none, and the name of its bag."""
    rollout, words = done.rollout, []
    if task is not None:
        assessed = task.assess(policy, rollout)
        words.append("no return" if assessed.ret is None else f"return {assessed.ret:.3f}")
        words += [f"{term} {value:.3f}" for term, value in assessed.terms.items()]
        words += ["success"] if assessed.success else []
        words += [assessed.why] if assessed.why else []
    elif rollout.fault is not None:
        words.append(f"fault: {rollout.fault.text}")
    else:
        words.append("done")
    return ", ".join([*words, *([f"recorded: {done.bag}"] if done.bag else [])])


def main() -> int:
    """Run `python -m wam_power_ros.console.run_policy`."""
    return run_script(RunningPolicy, run)
