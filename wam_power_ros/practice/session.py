# SPDX-License-Identifier: Apache-2.0
"""Session folder: everything learnt is on disk at any moment.

    session.yaml     settings and seed; written last when a session begins, so it marks a complete
                     session
    candidates/      policies fitted to the demonstrations, one JSON file each
    task.json        data of the demonstrations that the task needs, see `Task.context_of`
    rollouts.jsonl   one `Record`, `Rating` or `NewDemonstration` per line, append-only, on disk
                     before it is acknowledged
    acknowledged.json  size and SHA-256 of the log at the last acknowledgement; a log that is
                     missing, shorter or different is damaged
    policy.json      best policy so far, replaced atomically
    bags/            recordings
    .lock            locked while a learner writes

After a kill at any moment, `Session.open(folder).practice(arm)` resumes bit for bit.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from wam_power_ros import durable_files
from wam_power_ros.learning import policy as policy_module
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.course import check_candidates
from wam_power_ros.practice.improvement import ArmModel
from wam_power_ros.practice.log_file import LogFile, read_lines
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session_files import (
    SessionError,
    SessionHeader,
    lock,
    read_head,
    versions,
    write_header,
)
from wam_power_ros.practice.session_log import Line, NewDemonstration, Record, with_ratings
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.tasks.task import Task


class Session:
    """A session folder, locked for writing; close it, or use it as a context manager.

    Attributes:
        folder: Folder of the session.
        header: Contents of session.yaml.
        context: Contents of task.json.
        candidates: Policies that the session began with.
        bags: Folder of the recordings.
    """

    def __init__(self, folder: Path, lock_file: int) -> None:
        """Use `begin` or `open`."""
        self.folder = folder
        self.bags = folder / "bags"
        self._lock: int | None = lock_file
        self.header, self.candidates, self.context = read_head(folder)
        self._log = LogFile(folder)
        self._compare_versions()

    @staticmethod
    def exists(folder: Path | str) -> bool:
        """Whether a folder holds a session, to be opened instead of begun."""
        return (Path(folder) / "session.yaml").is_file()

    @staticmethod
    def task_of(folder: Path | str) -> str:
        """Name of the task of a session.

        Raises:
            SessionError: There is no session, or it is malformed.
        """
        return read_head(Path(folder))[0].settings.task

    @classmethod
    def begin(
        cls,
        folder: Path | str,
        settings: SessionSettings,
        seed: int,
        candidates: Sequence[Policy],
        *,
        context: Mapping[str, Any] | None = None,
        demonstrations: Sequence[str] = (),
        clock: Mapping[str, Any] | None = None,
    ) -> Session:
        """Begin a session in a new folder, or in one whose creation was interrupted.

        Args:
            folder: Folder of the session; created with its parents.
            settings: Settings of the session.
            seed: Seed of the exploration.
            candidates: Policies fitted to the demonstrations.
            context: Data of the demonstrations that the task needs, see `Task.context_of`.
            demonstrations: Bags that the candidates were fitted to.
            clock: Wall-clock figures.

        Raises:
            SessionError: The folder holds a session already, or another process has locked it.
            ValueError: `check_candidates` refuses the candidates.
        """
        check_candidates(candidates, settings.practice)
        folder = Path(folder)
        new = [folder, *(parent for parent in folder.parents if not parent.exists())]
        folder.mkdir(parents=True, exist_ok=True)
        lock_file = lock(folder)
        try:
            if cls.exists(folder) or (folder / "rollouts.jsonl").exists():
                raise SessionError(f"{folder} holds a session already; open it, or name another")
            header = SessionHeader(
                seed=seed,
                settings=settings,
                candidates=[policy.id for policy in candidates],
                demonstrations=list(demonstrations),
                versions=versions(),
                clock=dict(clock or {}),
            )
            (folder / "candidates").mkdir(exist_ok=True)
            (folder / "bags").mkdir(exist_ok=True)
            for policy in candidates:
                path = folder / "candidates" / f"{policy.id}.json"
                durable_files.replace(path, policy_module.to_json(policy))
            durable_files.replace(folder / "task.json", json.dumps(dict(context or {})) + "\n")
            write_header(folder, header)
            for each in new:
                durable_files.sync(each.parent)
            return cls(folder, lock_file)
        except BaseException:
            os.close(lock_file)
            raise

    @classmethod
    def open(cls, folder: Path | str) -> Session:
        """Open a session to resume it; an incomplete last line is cut off, with a warning.

        If versions of the software differ from those at the beginning, they are recorded, with a
        warning.

        Raises:
            SessionError: There is no session, another process has locked it, a file is malformed,
                or the log has lost acknowledged lines; names the file and line.
        """
        folder = Path(folder)
        if not cls.exists(folder):
            raise SessionError(f"{folder} holds no session: there is no session.yaml")
        lock_file = lock(folder)
        try:
            return cls(folder, lock_file)
        except BaseException:
            os.close(lock_file)
            raise

    @property
    def settings(self) -> SessionSettings:
        """Settings of the session."""
        return self.header.settings

    @property
    def seed(self) -> int:
        """Seed of the exploration."""
        return self.header.seed

    @property
    def log(self) -> tuple[Line, ...]:
        """All log lines on disk, oldest first."""
        return tuple(self._log.lines)

    @property
    def records(self) -> tuple[Record, ...]:
        """The rollouts on disk, oldest first, with their ratings."""
        return with_ratings(self._log.lines)

    def practice(self, arm: ArmModel) -> Practice:
        """The practice as it was after the last line on disk.

        Args:
            arm: Model of the arm for the rest of the session.

        Raises:
            SessionError: The log does not follow from this session's settings and seed.
        """
        try:
            return Practice(
                self.settings, self.context, self.candidates, self.seed, arm, self._log.lines
            )
        except ValueError as error:
            raise SessionError(f"{self.folder / 'rollouts.jsonl'}: {error}") from error

    def append(self, entry: Line) -> None:
        """Append a line to the log; see `LogFile.append`."""
        self._log.append(entry)

    def save_policy(self, policy: Policy) -> None:
        """Replace policy.json atomically: a reader sees the old or the new policy."""
        durable_files.replace(self.folder / "policy.json", policy_module.to_json(policy))

    def close(self) -> None:
        """Unlock the folder; may be called twice."""
        self._log.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _compare_versions(self) -> None:
        """Warn of versions that differ from those at the beginning, and record them."""
        begun, now = self.header.versions, versions()
        changed = [
            f"{name} {begun.get(name, 'none')}, now {now.get(name, 'none')}"
            for name in sorted(begun.keys() | now.keys())
            if begun.get(name) != now.get(name)
        ]
        if changed:
            logging.getLogger(__name__).warning(
                "%s was begun with other versions: %s. Its next policies may differ from those "
                "with the old versions",
                self.folder,
                "; ".join(changed),
            )
        if now != [begun, *self.header.resumed][-1]:
            resumed = [*self.header.resumed, now]
            self.header = self.header.model_copy(update={"resumed": resumed})
            write_header(self.folder, self.header)


def read_task(folder: Path | str) -> Task:
    """Task of a session, for reports.

    Raises:
        SessionError: There is no session, or its header, task or context is malformed.
    """
    header, _, context = read_head(Path(folder))
    try:
        return header.settings.make_task(context)
    except (ValueError, KeyError) as error:
        raise SessionError(f"{folder}: {error}") from error


def read(folder: Path | str) -> tuple[SessionHeader, tuple[Policy, ...], tuple[Record, ...]]:
    """Header, candidates and rollouts of a session, read without locking or changing it.

    Candidates include those added later; rollouts have their ratings. A learner may be writing
    meanwhile; an incomplete line is not returned.

    Raises:
        SessionError: There is no session, or a file is malformed; names the file and line.
    """
    header, candidates, _ = read_head(Path(folder))
    log, _ = read_lines(Path(folder))
    added = [line.candidate() for line in log if isinstance(line, NewDemonstration)]
    return header, (*candidates, *added), with_ratings(log)


def read_log(folder: Path | str) -> tuple[Line, ...]:
    """All lines of a session's log, read without locking or changing it.

    Raises:
        SessionError: As `read`.
    """
    read_head(Path(folder))
    return tuple(read_lines(Path(folder))[0])
