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
    """Score bags or sessions."""
    from wam_power_ros.practice.session import Session

    installed.task_type(task or DEFAULT_TASK)  # an unknown name is refused before a bag is read
    failed = 0
    for path in recorded:
        if Session.exists(path):
            _score_session(path, task, preset)
        else:
            failed += not _score_bag(path, task or DEFAULT_TASK, preset)
    return 1 if failed else 0


def _score_bag(path: Path, name: str, chosen: str) -> bool:
    """Print the score of a bag; return False if it has none."""
    from wam_power_ros.bags.bag import Bag

    try:
        bag = Bag(path)
        task = _task(name, chosen, _context(bag))
        assessed = task.assess(*recorded_rollout(bag, task))
    except ValueError as error:
        print(f"{path}: no return: {error}")
        return False
    terms = ", ".join(f"{term} {value:.3f}" for term, value in assessed.terms.items())
    print(f"{path}: {_outcome(assessed)}" + (f" ({terms})" if terms else ""))
    return assessed.ret is not None


def _score_session(folder: Path, task_name: str | None, chosen: str) -> None:
    """Print each rollout of a session with its logged return and its return under the preset."""
    import numpy as np

    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.practice import session
    from wam_power_ros.practice.session_log import KIND_NAMES

    found = session.read(folder)
    name = task_name or found.header.settings.task
    task = _task(name, chosen, found.context)
    print(f"{folder}: logged return; return and success under {name}, preset {chosen or 'first'}")
    by_kind: dict[str, list[tuple[float, float]]] = {}
    for record in found.records:
        logged = "–" if record.ret is None else f"{record.ret:.3f}"
        bag = folder / "bags" / record.bag
        if record.fault:
            outcome = f"fault: {record.fault}"
        elif not record.bag or not bag.is_dir():
            outcome = "no bag"
        else:
            try:
                assessed = task.assess(*recorded_rollout(Bag(bag), task))
            except ValueError as error:
                outcome = str(error)
            else:
                outcome = _outcome(assessed)
                if name == found.header.settings.task:  # a drop may have a high return
                    outcome += f"; {task.outcome(record)}"
                if record.ret is not None and assessed.ret is not None:
                    pair = record.ret, assessed.ret
                    by_kind.setdefault(KIND_NAMES[record.kind], []).append(pair)
        kind = KIND_NAMES[record.kind]
        print(f"{record.number:4d}  {kind:12}  {logged:>6}  {outcome}", flush=True)
    for kind, pairs in by_kind.items():
        before, now = np.mean(pairs, axis=0)
        print(f"{kind}, mean return of {len(pairs)}: {before:.3f} logged, {now:.3f} now")


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
