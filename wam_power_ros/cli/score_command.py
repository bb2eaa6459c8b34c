# SPDX-License-Identifier: Apache-2.0
"""`wam-power score`: return of recorded movements under any task and preset, without nodes."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wam_power_ros import installed
from wam_power_ros.cli.launcher import UsageError
from wam_power_ros.cli.parser import add_command, config_option, preset_option
from wam_power_ros.cli.session_options import DEFAULT_TASK
from wam_power_ros.params import overlay

if TYPE_CHECKING:
    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.control.arm import Arm
    from wam_power_ros.learning.policy import Policy
    from wam_power_ros.learning.rollout import Rollout
    from wam_power_ros.tasks.task import Assessment, Task


def add_to(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    text = "print the return of bags or of a whole session under any task and preset"
    parser = add_command(subparsers, "score", score, text)
    parser.add_argument("recorded", type=Path, nargs="+", help="bags, or folder of a session")
    default = f"task (default: the session's, else {DEFAULT_TASK})"
    parser.add_argument("--task", metavar="NAME", help=default)
    preset_option(parser)
    config_option(parser, "set-up")


def score(recorded: Sequence[Path], task: str | None, preset: str, config: Sequence[str]) -> int:
    """Score bags or sessions."""
    from wam_power_ros.practice.session import Session

    failed = 0
    for path in recorded:
        if Session.exists(path):
            _score_session(path, task, preset, config)
        else:
            failed += not _score_bag(path, task or DEFAULT_TASK, preset, config)
    return 1 if failed else 0


def _score_bag(path: Path, name: str, chosen: str, config: Sequence[str]) -> bool:
    """Print the score of a bag; return False if it has none."""
    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.practice.settings import preset

    setup, arm = _set_up(name, config)
    try:
        bag = Bag(path)
        context = _context(bag, name, setup, arm)
        task = preset(name, chosen).make_task(context)
        assessed = task.assess(*recorded_rollout(bag, task, setup.joint_names, arm))
    except ValueError as error:
        print(f"{path}: no return: {error}")
        return False
    terms = ", ".join(f"{term} {value:.3f}" for term, value in assessed.terms.items())
    print(f"{path}: {_outcome(assessed)}" + (f" ({terms})" if terms else ""))
    return assessed.ret is not None


def _score_session(folder: Path, task_name: str | None, chosen: str, config: Sequence[str]) -> None:
    """Print each rollout of a session with its logged return and its return under the preset."""
    import numpy as np

    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.practice import session
    from wam_power_ros.practice.session_log import KIND_NAMES
    from wam_power_ros.practice.settings import preset

    found = session.read(folder)
    name = task_name or found.header.settings.task
    setup, arm = _set_up(name, config)
    task = preset(name, chosen).make_task(found.context)
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
                assessed = task.assess(*recorded_rollout(Bag(bag), task, setup.joint_names, arm))
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


def _set_up(task: str, config: Sequence[str]) -> tuple[overlay.Setup, Arm]:
    setup = overlay.setup(config, task=task)
    if (arm := setup.arm()) is None:
        raise UsageError("the set-up has no URDF file of the arm: choose one with --config")
    return setup, arm


def recorded_rollout(
    bag: Bag, task: Task, joint_names: list[str], arm: Arm
) -> tuple[Policy, Rollout]:
    """Policy and rollout of a bag; for a demonstration, the policy fitted to it and its own path.

    Raises:
        ValueError: The bag cannot be read, or has neither a rollout nor a demonstration.
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
        return _as_rollout(bag, task, joint_names, arm)
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


def _as_rollout(bag: Bag, task: Task, joint_names: list[str], arm: Arm) -> tuple[Policy, Rollout]:
    """Demonstration as a rollout of the policy fitted to it."""
    import numpy as np

    from wam_power_ros import rotations
    from wam_power_ros.bags import layout, reader
    from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
    from wam_power_ros.ros import interface

    states = reader.read_states(bag, joint_names)
    stamps, q = states.stamps, states.q
    demonstration = task.demonstration_of(arm, stamps, q)
    policy = task.policy_of([demonstration], "demonstration")
    # From the start of the movement, at the rate of the paths that the controller publishes.
    near = np.abs(q - demonstration.q[0]).sum(axis=1)
    peak = int(np.abs(np.diff(q, axis=0)).sum(axis=1).argmax())
    first = int(near[: peak + 1].argmin())
    kept = slice(first, None, max(1, round(0.01 / np.median(np.diff(stamps * 1e-9)))))
    poses = [arm.tool_pose(row) for row in q[kept]]
    position = np.array([pose[0] for pose in poses])
    quat = rotations.quat_xyzw(np.array([pose[1] for pose in poses]))
    t = (stamps[kept] - stamps[first]) * 1e-9
    tool, body = EndEffectorPath(policy.id, t, position, quat), None
    if task.body:
        state = interface.body_topic(task.body, "state")
        if not (topic := _topic(bag.topics, state)):
            raise ValueError(f"no state of the {task.body} on {state}")
        rows = {}
        for _, _, data in bag.messages([topic]):
            message = layout.decoded(data, "nav_msgs/msg/Odometry")
            at, pose = message.header.stamp, message.pose.pose
            when = at.sec * 1_000_000_000 + at.nanosec - int(stamps[first])
            p, o = pose.position, pose.orientation
            rows[when] = (p.x, p.y, p.z, o.x, o.y, o.z, o.w)
        times = np.array(sorted(when for when in rows if when >= 0), dtype=np.int64)
        values = np.array([rows[int(when)] for when in times]).reshape(-1, 7)
        body = BodyPath(policy.id, times * 1e-9, values[:, :3], values[:, 3:])
    return policy, Rollout(tool, body)


def _topic(topics: Iterable[str], name: str) -> str:
    """Topic of a bag with this name, in any namespace; empty if there is none."""
    return next((topic for topic in topics if f"/{topic}".endswith(f"/{name}")), "")


def _context(bag: Bag, task: str, setup: overlay.Setup, arm: Arm) -> dict[str, Any]:
    """Context of the session that a bag belongs to, else of a session on this bag alone."""
    from wam_power_ros.bags import reader
    from wam_power_ros.params.torque_controller_params import TorqueControllerParams
    from wam_power_ros.practice.session import Session, read

    folder = bag.path.resolve().parent.parent
    if Session.exists(folder) and (found := read(folder)).header.settings.task == task:
        return found.context
    kind, states = installed.task_type(task), reader.read_states(bag, setup.joint_names)
    demonstration = kind.demonstration_of(arm, states.stamps, states.q)
    controller = TorqueControllerParams.of_setup(setup)
    return kind.context_of([demonstration], controller.region)


def _outcome(assessed: Assessment) -> str:
    ret = "no return" if assessed.ret is None else f"return {assessed.ret:.3f}"
    success = "success" if assessed.success else "no success"
    return ", ".join(filter(None, (ret, success, assessed.why)))
