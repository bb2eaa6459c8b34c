# SPDX-License-Identifier: Apache-2.0
"""`wam-power score`: return of recorded rollouts under any task and preset, without nodes."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
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
    from wam_power_ros.tasks.task import Assessment, Task


def add_to(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    text = "print the return of bags or of a whole session under any task and preset"
    parser = add_command(subparsers, "score", score, text)
    parser.add_argument("recorded", type=Path, nargs="+", help="bags, or folder of a session")
    task_option(parser, f"the session's, else {DEFAULT_TASK}")
    preset_option(parser)


def score(recorded: Sequence[Path], task: str | None, preset: str) -> int:
    """Score bags, or each rollout of sessions beside its logged return."""
    from wam_power_ros.practice import session
    from wam_power_ros.practice.session_log import KIND_NAMES

    installed.task_type(task or DEFAULT_TASK)  # an unknown name is refused before a bag is read
    failed = 0
    for path in recorded:
        if not session.Session.exists(path):
            scored, text = _scored(path, task or DEFAULT_TASK, preset)
            print(f"{path}: {text}", flush=True)
            failed += not scored
            continue
        found = session.read(path)
        name = task or found.header.settings.task
        print(f"{path}: logged return; return under {name}, preset {preset or 'first'}")
        for record in found.records:
            logged = "–" if record.ret is None else f"{record.ret:.3f}"
            text = "no bag"
            if record.bag:
                _, text = _scored(path / "bags" / record.bag, name, preset)
            kind = KIND_NAMES[record.kind]
            print(f"{record.number:4d}  {kind:12}  {logged:>6}  {text}", flush=True)
    return 1 if failed else 0


def _scored(path: Path, name: str, chosen: str) -> tuple[bool, str]:
    """Whether a bag has a return, and it with its terms, or why there is none."""
    from wam_power_ros.bags.bag import Bag

    try:
        bag = Bag(path)
        task = _task(name, chosen, _context(bag))
        assessed = task.assess(*recorded_rollout(bag, task))
    except ValueError as error:
        return False, f"no return: {error}"
    terms = ", ".join(f"{term} {value:.3f}" for term, value in assessed.terms.items())
    return assessed.ret is not None, _outcome(assessed) + (f" ({terms})" if terms else "")


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
    body_topic = interface.rollout_topic(task.body) if task.body else ""
    tool_topics = (interface.ROLLOUT_END_EFFECTOR, interface.ROLLOUT_END)
    names = (interface.POLICY, *tool_topics, body_topic)
    wanted = {topic: name for name in names if name and (topic := _topic(topics, name))}
    for topic, _, data in bag.messages(wanted):
        found[wanted[topic]] = layout.decoded(data, topics[topic].msgtype)
    if interface.POLICY not in found or interface.ROLLOUT_END_EFFECTOR not in found:
        raise ValueError("no rollout: the bag has no policy, or no path of the tool")
    if not hasattr(found[interface.POLICY], "text"):
        raise ValueError(f"{interface.POLICY} is no wam_power_interfaces/msg/Policy")
    policy = policies.from_json(found[interface.POLICY].text)
    path = pose_messages.path(found[interface.ROLLOUT_END_EFFECTOR])
    tool = EndEffectorPath(policy.id, *path[1:])
    body = None
    if task.body:
        if body_topic not in found:
            raise ValueError(f"no path of the {task.body} on {body_topic}")
        start_ns, *body_path = pose_messages.path(found[body_topic])
        if start_ns != path.start_ns:
            raise ValueError(f"the path of the {task.body} is of another rollout than the tool's")
        body = BodyPath(policy.id, *body_path)
    rollout = Rollout(tool, body)
    if interface.ROLLOUT_END in found:
        end = Ended.of(found[interface.ROLLOUT_END])
        if (end.policy_id, end.start_ns) != (policy.id, path.start_ns):
            raise ValueError(f"the paths do not belong to the policy {policy.id}")
        if cut_short(policy, rollout, task.settle_time):
            rollout = replace(rollout, fault=end.fault, stopped_in=end.region)
    return policy, rollout


def _topic(topics: Iterable[str], name: str) -> str:
    """Topic of a bag with this name, in any namespace; empty if there is none."""
    return next((topic for topic in topics if f"/{topic}".endswith(f"/{name}")), "")


def _context(bag: Bag) -> dict[str, Any]:
    """Context of the session that a bag belongs to; empty if it is in none."""
    from wam_power_ros.practice.session import Session, read

    folder = bag.path.resolve().parent.parent
    return read(folder).context if Session.exists(folder) else {}


def _task(name: str, chosen: str, context: dict[str, Any]) -> Task:
    from wam_power_ros.practice.settings import preset

    try:
        return preset(name, chosen).make_task(context)
    except KeyError as error:
        raise ValueError(f"task {name} needs {error} of a session of its own") from None


def _outcome(assessed: Assessment) -> str:
    ret = "no return" if assessed.ret is None else f"return {assessed.ret:.3f}"
    success = "success" if assessed.success else "no success"
    return ", ".join(filter(None, (ret, success, assessed.why)))
