# SPDX-License-Identifier: Apache-2.0
"""Execute a saved policy on the arm, or compare two; record each rollout and print its return.

A rollout is that of a learner: move to the start, wait until the body is ready, execute, hold.
Nothing is learnt. Ctrl-C stops the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from wam_power_ros.client.robot import Robot
from wam_power_ros.client.rollouts import Executed
from wam_power_ros.console.prompt import ask, let_go_after, show
from wam_power_ros.console.replay import SETTLE_TIME
from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.comparison import DECIDED, ERROR, Comparison
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import ServiceError
from wam_power_ros.tasks.task import Assessment, Pose, Task

NAMES = ("A", "B")  # of the policies of a comparison


def task_of(session: Session | None, name: str) -> tuple[Task | None, str]:
    """Task that scores the rollouts; None, with the reason, if it needs a session and has none."""
    if session and name == session.header.settings.task:
        return session.task, ""
    try:
        return preset(name).make_task({}), ""
    except KeyError as error:
        why = f"task {name} measures by the demonstrations of a session ({error})"
        return None, f"{why}: run the policy in its folder"


def run(
    robot: Robot,
    policies: Sequence[Policy],
    task: Task | None,
    rollouts: int,
    person: bool,
    comparison: Comparison | None = None,
) -> int:
    """Execute a policy as often as asked, or compare two; returns the exit status.

    Args:
        policies: One policy, or the two of the comparison.
        task: Scores the rollouts; None for no returns.
        rollouts: Number of rollouts; of a comparison that of pairs, at most.
        person: Whether to ask the person beside a real arm before each rollout.
        comparison: Judges pairs of rollouts; ends them once it knows the better policy.

    Raises:
        ServiceError: A service does not appear, does not answer in time, or refuses.
    """
    robot.stop()  # succeeds once the controller is active
    called = " and ".join(f"{each.id}, {each.basis.duration:.1f} s" for each in policies)
    show(f"Executing {called}; Ctrl-C stops the arm")
    faults = 0
    with let_go_after(person):
        try:
            for number in range(1, rollouts + 1):
                found = {}
                for which in comparison.order if comparison else (0,):
                    policy, place = policies[which], f"{number} of {rollouts}"
                    if person:
                        _agreed(policy, task, place)
                    tool = Pose(*robot.arm.tool_pose(policy.q_start))
                    ready = partial(task.ready, tool=tool) if task else lambda state: ""
                    done = robot.rollout(policy, ready)
                    faults += done.rollout.fault is not None
                    found[which] = task.assess(policy, done.rollout) if task else None
                    named = f"{place}, {NAMES[which]}" if comparison else place
                    show(f"{named}: {outcome(found[which], done)}")
                if comparison:
                    comparison.add((found[0], found[1]))
                    show(f"  {standing(comparison)}")
                    if comparison.better is not None:
                        break
        except KeyboardInterrupt:  # also at a question; `Stopped` is one
            robot.link.sleep(SETTLE_TIME)
            robot.link.call(interface.RECORD, False)  # answers that there is none if there is none
            show("Stopped: the arm holds.")
            return INTERRUPTED
        except ServiceError as error:
            show(str(error))
            return 1
    return 1 if faults and comparison is None else 0


def standing(found: Comparison) -> str:
    """What a comparison shows so far."""
    (a, b), alike = found.won, f", {found.alike} alike" if found.alike else ""
    pairs = f"pairs won: A {a}, B {b}{alike}"
    if found.better is None:
        return (
            f"{pairs}; which is better is not known (evidence {found.evidence:.2g} of {DECIDED:g})"
        )
    return (
        f"{pairs}; {NAMES[found.better]} is better, with a probability of error below {ERROR:.0%}"
    )


def _agreed(policy: Policy, task: Task | None, place: str) -> None:
    body = f"Put the {task.body} in its place. " if task and task.body else ""
    question = f"{body}The arm will move to the start of {policy.id} and execute it ({place}). "
    ask(f"{question}Press Enter: ")


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
