# SPDX-License-Identifier: Apache-2.0
"""Options that select or start a session: checks before anything starts, words to resume it."""

from __future__ import annotations

import argparse
from pathlib import Path

from wam_power_ros.cli.launcher import UsageError, arm_of, task_setup, task_stems, timestamp
from wam_power_ros.params import overlay

SESSIONS = Path("sessions")
DEFAULT_TASK = "flip"


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
    if not Session.exists(folder):
        raise UsageError(f"{folder} holds no session")
    return folder.resolve()


def session_folder(options: argparse.Namespace) -> Path:
    """Folder of the session to start or resume.

    Raises:
        UsageError: An option differs from what the session was started with, or there is no session
            to resume.
    """
    from wam_power_ros.practice.session import Session, read

    if options.resume:
        folder = existing_session(options.session)
    else:
        folder = (options.session or SESSIONS / f"{timestamp()}-seed-{options.seed or 0}").resolve()
    if Session.exists(folder):
        header = read(folder).header
        if options.seed is not None and options.seed != header.seed:
            raise UsageError(f"{folder} was begun with seed {header.seed}; omit the seed")
        if options.task not in (None, header.settings.task):
            raise UsageError(f"{folder} was begun with task {header.settings.task}; omit the task")
        given = [name for name in ("learner", "preset", "trials", "bags") if getattr(options, name)]
        if given:
            raise UsageError(f"{folder} was begun with its own settings; omit {', '.join(given)}")
    return folder


def check_names(task: str, options: argparse.Namespace) -> None:
    """Check the options of a new session before anything starts.

    Raises:
        ValueError: Task, learner or preset is unknown (the message lists the known ones), or a bag
            cannot be read or is of another arm.
        UsageError: A bag is a demonstration of another task, or the budget leaves no rollout to
            practise.
    """
    from wam_power_ros.practice import plugins
    from wam_power_ros.practice.settings import preset

    if options.learner:
        plugins.learner_type(options.learner)
    learner = {"name": options.learner} if options.learner else None
    changes = {} if options.trials is None else {"budget": options.trials}
    budget = preset(task, options.preset or "", learner, **changes).practice.budget
    count = len(options.bags) if options.bags else options.demonstrations
    reproductions = 1 if plugins.task_type(task).single_policy else count
    if budget <= reproductions:
        raise UsageError(
            f"a budget of {budget} rollouts leaves none to practise after "
            f"{reproductions} reproductions of demonstrations; raise --trials"
        )
    _check_arm_and_bags(task, options)


def _check_arm_and_bags(task: str, options: argparse.Namespace) -> None:
    """Check that the URDF fits the set-up and that the bags are demonstrations by that arm."""
    from wam_power_ros.bags import reader
    from wam_power_ros.bags.bag import Bag

    names, arm = arm_of(overlay.setup(options.config, options.simulate, task_setup(task)))
    tasks = task_stems()
    for path in options.bags or []:
        bag = Bag(path)
        reader.read_states(bag, names, arm=arm and arm.identity())
        tasks_of_bag = tasks.get(bag.kind, {task})
        if task not in tasks_of_bag:
            names_ = ", ".join(tasks_of_bag)
            raise UsageError(f"{path} is a demonstration of {names_}, not of {task}: use --task")


def given_options(options: argparse.Namespace) -> list[str]:
    """Command-line words that repeat the options of a new session."""
    words = []
    for name in ("task", "learner", "preset", "trials", "seed", "demonstrations"):
        value = getattr(options, name)
        words += [] if value is None else [f"--{name}", str(value)]
    return [*words, "--bags", *map(str, options.bags)] if options.bags else words
