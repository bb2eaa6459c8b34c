# SPDX-License-Identifier: Apache-2.0
"""Execute a saved policy on the arm, record each rollout and print its return.

A rollout is that of a learner: move to the start, wait until the body is ready, execute, hold.
Nothing is learnt. Ctrl-C stops the arm.
"""

from __future__ import annotations

from functools import partial

from wam_power_ros.client.robot import Robot
from wam_power_ros.client.rollouts import Executed
from wam_power_ros.console.prompt import confirm, let_go_after, show
from wam_power_ros.console.replay import SETTLE_TIME
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import ServiceError
from wam_power_ros.tasks.task import Assessment, Pose, Task


def task_of(session: Session | None, name: str) -> tuple[Task | None, str]:
    """Task that scores the rollouts; None, with the reason, if it needs a session and has none."""
    if session and name == session.header.settings.task:
        return session.task, ""
    try:
        return preset(name).make_task({}), ""
    except KeyError as error:
        why = f"task {name} measures by the demonstrations of a session ({error})"
        return None, f"{why}: run the policy in its folder"


def run(robot: Robot, policy: Policy, task: Task | None, rollouts: int, person: bool) -> int:
    """Execute a policy as often as asked; returns the exit status.

    A task scores the rollouts; a person beside a real arm is asked before each of them.

    Raises:
        ServiceError: The controller does not answer or refuses to stop.
        ValueError: The person cannot answer, because standard input is closed.
    """
    robot.stop()  # succeeds once the controller is active
    show(f"Executing {policy.id}, {policy.basis.duration:.1f} s; Ctrl-C stops the arm")
    body = f"Put the {task.body} in its place. " if task and task.body else ""
    tool = Pose(*robot.arm.tool_pose(policy.q_start))
    ready = partial(task.ready, tool=tool) if task else lambda state: ""
    faults = 0
    with let_go_after(person):
        try:
            for number in range(1, rollouts + 1):
                place = f"{number} of {rollouts}"
                if person:
                    moves = f"The arm will move to the start of {policy.id} and execute it"
                    confirm(f"{body}{moves} ({place}). Press Enter: ")
                done = robot.rollout(policy, ready)
                faults += done.rollout.fault is not None
                assessed = task.assess(policy, done.rollout) if task else None
                show(f"{place}: {outcome(assessed, done)}")
        except KeyboardInterrupt:  # also at a question; `Stopped` is one
            robot.link.sleep(SETTLE_TIME)
            robot.link.call(interface.RECORD, False)  # answers that there is none if there is none
            show("Stopped: the arm holds.")
            return INTERRUPTED
        except ServiceError as error:
            show(str(error))
            return 1
    return 1 if faults else 0


def outcome(assessed: Assessment | None, done: Executed) -> str:
    """Return of a rollout with its terms, or why it has none, and the name of its bag."""
    rollout, words = done.rollout, []
    if assessed is not None:
        words.append("no return" if assessed.ret is None else f"return {assessed.ret:.3f}")
        words += [f"{term} {value:.3f}" for term, value in assessed.terms.items()]
        words += ["success"] if assessed.success else []
        words += [assessed.why] if assessed.why else []
    elif rollout.fault is not None:
        words.append(f"fault: {rollout.fault.text}")
    else:
        words.append("done")
    return ", ".join([*words, *([f"recorded: {done.bag}"] if done.bag else [])])
