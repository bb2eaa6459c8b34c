# SPDX-License-Identifier: Apache-2.0
"""Options that select or start a session: checks before anything starts."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wam_power_ros.cli.launcher import Devices, UsageError, task_stems
from wam_power_ros.durable_files import check_name

if TYPE_CHECKING:
    from wam_power_ros.practice.session import SessionHeader

SESSIONS = Path("sessions")
POLICY = "policy.json"  # in the folder of a session
DEFAULT_TASK = "flip"


@dataclass(frozen=True)
class SessionOptions:
    """What a person asks of a session; None or empty for what is not asked."""

    task: str | None = None
    learner: str = ""
    preset: str = ""
    trials: int | None = None
    minutes: int | None = None
    seed: int | None = None
    demonstrations: int = 0  # number of demonstrations to record
    bags: Sequence[Path] = ()  # demonstrations to learn from instead
    origin: Path | None = None  # session whose policy is where this one begins
    goal: Sequence[tuple[str, float]] = ()  # new values of the goal of that session, by name


def existing_session(folder: Path | None) -> Path:
    """Folder of a session, by default the newest one.

    Raises:
        UsageError: There is no session.
    """
    from wam_power_ros.practice.session import Session

    if folder is None:
        sessions = [path for path in SESSIONS.glob("*") if Session.exists(path)]
        if not sessions:
            raise UsageError(f"no session in {SESSIONS.resolve()}; name one with --session")
        folder = max(sessions, key=lambda path: (path / "session.yaml").stat().st_mtime)
    check_name(folder)
    if not Session.exists(folder):
        raise UsageError(f"{folder} holds no session")
    return folder.resolve()


def chosen(folder: Path, asked: SessionOptions, devices: Devices) -> tuple[int, str]:
    """Seed and task of the session to start or resume in a folder.

    Raises:
        UsageError: What is asked differs from what the session was begun with, or a bag is a
            demonstration of another task.
        ValueError: A name is unknown or cannot work, or a bag cannot be read or is of another arm.
    """
    from wam_power_ros.practice import session

    if not session.Session.exists(folder):
        task = asked.task or DEFAULT_TASK
        _check_new(folder, task, asked, devices)
        return asked.seed or 0, task
    header = session.read(folder).header
    try:
        header.settings.check(len(header.candidates))
    except ValueError as error:  # begun by another version
        raise UsageError(f"{folder} cannot go on: {error}. Begin another session") from None
    for difference in _differences(asked, header, devices):
        raise UsageError(f"{folder} was begun with {difference}")
    return header.seed, header.settings.task


def with_origin(asked: SessionOptions, devices: Devices) -> SessionOptions:
    """The options with task and demonstrations of the session that a new one begins from.

    Raises:
        UsageError: It has no policy yet, is of another task, or bags are named as well.
        ValueError: Its policy is one of another arm, or its task has no such goal.
    """
    if asked.origin is None:
        if asked.goal:
            raise UsageError("--goal needs the session to predict from: add --from SESSION")
        return asked
    from wam_power_ros.practice import new_goal, session

    folder = existing_session(asked.origin)
    known = session.read(folder)
    header, policy = known.header, folder / POLICY
    task = header.settings.task
    if not policy.is_file():
        raise UsageError(f"the session in {folder} has learnt no policy yet")
    if asked.task not in (None, task):
        raise UsageError(f"the policy in {folder} is one of {task}, not of {asked.task}")
    if asked.bags:
        raise UsageError("--from brings its own demonstrations: omit --bags")
    if asked.goal:
        new_goal.context_for(header.settings, known.context, dict(asked.goal))  # or refuses
    if (arm := devices.parameters(task).arm()) is not None:
        session.read_policy(policy, arm.identity())
    return replace(asked, task=task, bags=[*map(Path, header.demonstrations)], origin=folder)


def learner_parameters(folder: Path, asked: SessionOptions, seed: int, task: str) -> dict[str, Any]:
    """Parameters of the learner of a session; one that is resumed keeps its own settings."""
    return {
        "session": str(folder),
        "seed": seed,
        **chosen_settings(asked, task),
        "demonstrations": [str(bag.resolve()) for bag in asked.bags] or [""],
        "policy": "" if asked.origin is None else str(asked.origin / POLICY),
        "goal": json.dumps(dict(asked.goal)) if asked.goal else "",
    }


def chosen_settings(asked: SessionOptions, task: str) -> dict[str, Any]:
    """Parameters of the learner that settings follow from; a set-up has those not asked for."""
    given = {"learner": asked.learner, "preset": asked.preset}
    given |= {"trials": asked.trials, "minutes": asked.minutes}
    return {"task": task, **{name: value for name, value in given.items() if value}}


def _differences(asked: SessionOptions, header: SessionHeader, devices: Devices) -> Iterator[str]:
    """What a session was begun with and is asked otherwise, with what to do."""
    from wam_power_ros.practice.settings import of_parameters

    own, limits = header.settings, header.settings.practice
    begun = {"seed": header.seed, "task": own.task, "learner": own.learner}
    begun |= {"trials": limits.budget, "minutes": limits.minutes}
    for name, value in begun.items():
        if getattr(asked, name) not in (None, "", value):
            yield f"{name} {value}; omit {name}"
    if asked.preset:
        same = replace(asked, learner=own.learner, trials=limits.budget, minutes=limits.minutes)
        given = devices.parameters(own.task)["learner"] | chosen_settings(same, own.task)
        if of_parameters(given) != own:
            yield f"other settings than preset {asked.preset}; omit preset"
    used = set(header.demonstrations)  # without those that were of no use
    if asked.bags and not used <= {str(bag.resolve()) for bag in asked.bags}:
        yield f"the demonstrations {' '.join(header.demonstrations)}; omit bags"


def _check_new(folder: Path, task: str, asked: SessionOptions, devices: Devices) -> None:
    from wam_power_ros.bags import reader, series
    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.practice.settings import of_parameters

    setup = devices.parameters(task)
    settings = of_parameters(setup["learner"] | chosen_settings(asked, task))
    taught = max(asked.demonstrations, len(series.read(folder / series.FILE)))
    settings.check(1 if asked.origin else len(asked.bags) or taught)
    tasks, arm, stem = task_stems(), setup.arm(), setup["demonstration_recorder"]["stem"]
    for path in asked.bags:
        bag = Bag(path)
        reader.read_states(bag, setup.joint_names, arm=arm and arm.identity())
        known = tasks.get(bag.kind, {task})
        if task not in known and bag.kind != stem:
            of = ", ".join(known)
            raise UsageError(f"{path} is a demonstration of {of}, not of {task}: use --task")
