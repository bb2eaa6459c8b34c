# SPDX-License-Identifier: Apache-2.0
"""Options that name or begin a session: checked before anything starts, repeated to resume it."""

from __future__ import annotations

import argparse
from pathlib import Path

from wam_power_ros.cli.launcher import UsageError, arm_of, now, task_setup, task_stems
from wam_power_ros.params import overlay

SESSIONS = Path("sessions")
TASK = "flip"  # the default


def existing_session(folder: Path | None) -> Path:
    """Folder of a session, by default that of the newest one."""
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
    """Folder to begin or resume; refuses options that differ from what the session began with."""
    from wam_power_ros.practice.session import Session, read

    if options.resume:
        folder = existing_session(options.session)
    else:
        folder = (options.session or SESSIONS / f"{now()}-seed-{options.seed or 0}").resolve()
    if Session.exists(folder):
        header, _, _ = read(folder)
        if options.seed is not None and options.seed != header.seed:
            raise UsageError(f"{folder} was begun with seed {header.seed}; leave seed out")
        if options.task not in (None, header.settings.task):
            raise UsageError(f"{folder} was begun with task {header.settings.task}")
        given = [name for name in ("learner", "preset", "trials", "bags") if getattr(options, name)]
        if given:
            raise UsageError(f"{folder} was begun already; leave {', '.join(given)} out")
    return folder


def check_names(task: str, options: argparse.Namespace) -> None:
    """Refuse what is unknown or belongs to another task before anything starts.

    Raises:
        ValueError: When task, learner or preset is not known; lists the known names. When a bag is
            none, or not of this arm.
        UsageError: When a bag is a demonstration of another task, or the budget leaves nothing to
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
    """Refuse an arm that its URDF is not, and bags that are no demonstrations of a task by it."""
    from wam_power_ros.bags import reader, takes

    names, arm = arm_of(overlay.setup(options.config, options.simulate, task_setup(task)))
    tasks = task_stems()
    for bag in options.bags or []:
        reader.read_demonstration(bag, names, arm=arm and arm.identity())
        of_bag = tasks.get(takes.kind_of(bag), {task})
        if task not in of_bag:
            known = ", ".join(of_bag)
            raise UsageError(f"{bag} is a demonstration of {known}, not of {task}: give --task")


def given_options(options: argparse.Namespace) -> list[str]:
    """Command-line words of what a new session was asked for."""
    words = []
    for name in ("task", "learner", "preset", "trials", "seed", "demonstrations"):
        value = getattr(options, name)
        words += [] if value is None else [f"--{name}", str(value)]
    return [*words, "--bags", *map(str, options.bags)] if options.bags else words
