# SPDX-License-Identifier: Apache-2.0
"""`wam-power score`: return of recorded rollouts under any task and preset, without nodes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wam_power_ros import installed
from wam_power_ros.cli.parser import add_command, preset_option, task_option
from wam_power_ros.cli.session_options import DEFAULT_TASK

if TYPE_CHECKING:
    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.learning.policy import Policy
    from wam_power_ros.learning.rollout import Rollout
    from wam_power_ros.tasks.task import Task


def add_to(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    text = "print the return of bags or of a whole session under any task and preset"
    parser = add_command(subparsers, "score", score, text)
    parser.add_argument("recorded", type=Path, nargs="+", help="bags, or folder of a session")
    task_option(parser, f"the session's, else {DEFAULT_TASK}")
    preset_option(parser)


def score(recorded: Sequence[Path], task: str | None, preset: str) -> int:
    """Print the return of bags, and of each bag of a session beside its logged return."""
    from wam_power_ros.practice import session
    from wam_power_ros.reporting.terminal import number

    installed.task_type(task or DEFAULT_TASK)  # an unknown name is refused before a bag is read
    failed = 0
    for path in recorded:
        bags, name = {path: ""}, task or DEFAULT_TASK
        if session.Session.exists(path):
            found = session.read(path)
            name = task or found.header.settings.task
            bags = {
                path / "bags" / record.bag: f"logged {number(record.ret)}, "
                for record in found.records
                if record.bag
            }
        for bag, logged in bags.items():
            try:
                scored = _scored(bag, name, preset)
            except ValueError as error:
                failed, scored = failed + 1, f"no return: {error}"
            print(f"{bag}: {logged}{scored}", flush=True)
    return 1 if failed else 0


def _scored(path: Path, name: str, chosen: str) -> str:
    """Return of a bag with its terms, or why there is none.

    Raises:
        ValueError: The bag cannot be read, has no rollout, or the task needs its own session.
    """
    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.practice.session import Session, read
    from wam_power_ros.practice.settings import preset

    folder = path.resolve().parent.parent
    context = read(folder).context if Session.exists(folder) else {}
    try:
        task = preset(name, chosen).make_task(context)
    except KeyError as error:
        raise ValueError(f"task {name} needs {error} of a session of its own") from None
    assessed = task.assess(*recorded_rollout(Bag(path), task))
    words = ["no return" if assessed.ret is None else f"return {assessed.ret:.3f}"]
    words += ["success" if assessed.success else "no success", assessed.why]
    words += [f"{term} {value:.3f}" for term, value in assessed.terms.items()]
    return ", ".join(filter(None, words))


def recorded_rollout(bag: Bag, task: Task) -> tuple[Policy, Rollout]:
    """Policy and rollout of a bag.

    Raises:
        ValueError: The bag cannot be read, or has no rollout.
    """
    from wam_power_ros.bags import layout
    from wam_power_ros.learning import policy as policies
    from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
    from wam_power_ros.ros import interface, pose_messages
    from wam_power_ros.ros.outcomes import Ended
    from wam_power_ros.tasks.task import cut_short

    found: dict[str, Any] = {}
    topics = bag.topics
    names = [interface.POLICY, interface.ROLLOUT_END_EFFECTOR, interface.ROLLOUT_END]
    names += [interface.rollout_topic(task.body)] if task.body else []
    wanted = {topic: name for topic in topics for name in names if f"/{topic}".endswith(f"/{name}")}
    for topic, _, data in bag.messages(wanted):  # the last of each: earlier ones were latched
        found[wanted[topic]] = layout.decoded(data, topics[topic].msgtype)
    if missing := [name for name in names if name not in found]:
        raise ValueError(f"no rollout: the bag has no {', '.join(missing)}")
    policy = policies.from_json(found[interface.POLICY].text)
    path = pose_messages.path(found[interface.ROLLOUT_END_EFFECTOR])
    end, body = Ended.of(found[interface.ROLLOUT_END]), None
    starts = {end.start_ns, path.start_ns}
    if task.body:
        start_ns, *body_path = pose_messages.path(found[interface.rollout_topic(task.body)])
        body, starts = BodyPath(policy.id, *body_path), starts | {start_ns}
    if end.policy_id != policy.id or len(starts) > 1:
        raise ValueError(f"the paths do not belong to the policy {policy.id}")
    rollout = Rollout(EndEffectorPath(policy.id, *path[1:]), body)
    if cut_short(policy, rollout, task.settle_time):
        rollout = replace(rollout, fault=end.fault, stopped_in=end.region)
    return policy, rollout
