# SPDX-License-Identifier: Apache-2.0
"""Page of a session and main loop of `wam-power view`: its records; its nodes while it runs."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np

from wam_power_ros.durable_files import is_locked
from wam_power_ros.params import overlay
from wam_power_ros.practice import session
from wam_power_ros.practice.failure import why_failed
from wam_power_ros.practice.session_log import KIND_NAMES, Kind, Record
from wam_power_ros.reporting.terminal import failed, number, returned, term_names
from wam_power_ros.ros.node_runner import participant
from wam_power_ros.tasks.task import Task
from wam_power_ros.view.guarded_server import GuardedServer
from wam_power_ros.view.live import LiveState, View
from wam_power_ros.view.page import LIGHT_ORANGE, ORANGE, Page, plain
from wam_power_ros.view.skeleton import Skeleton

KINDS: tuple[str, ...] = get_args(Kind)
NEWEST_COUNT = 4  # rollouts in the text
PERIOD = 0.1  # [s] between updates
CHECK_PERIOD = 1.0  # [s] between checks whether the session runs
TRAIL_LENGTH = 40  # tool positions in the trail, ten a second
STILL = 1e-4  # [rad] between two updates: less is noise of the encoders
STATE_TIMEOUT = 1.0  # [s of wall time] after which a missing joint state is reported
RUNNING, ENDED = "running", "not running: records only"
REWARD, PUNISH, PAUSE, CONTINUE = "Reward", "Punish", "Pause", "Continue"
RATINGS = {f"Rate {key}": key / 9.0 for key in (0, 3, 5, 7, 9)}  # of the task `rated`
TEACH, END_TEACHING, STOP = "Teach again", "End of movement", "STOP the arm"


def curve(records: Sequence[Record]) -> tuple[np.ndarray, ...]:
    """Rollout numbers, measured returns of each kind (NaN for other rollouts), best so far."""
    numbers = np.array([float(record.number) for record in records])
    returns = np.array([np.nan if rec.ret is None else rec.ret for rec in records])
    kinds = np.array([record.kind for record in records])
    best = np.fmax.accumulate(returns) if len(returns) else returns
    return (numbers, *(np.where(kinds == kind, returns, np.nan) for kind in KINDS), best)


def newest(records: Sequence[Record], task: Task) -> str:
    """The newest rollouts as Markdown, newest first: outcomes, then the terms of their returns."""
    shown = records[: -NEWEST_COUNT - 1 : -1]
    lines = [f"**{plain(label(record))}** {plain(task.outcome(record))}  " for record in shown]
    rows = [["", *(str(record.number) for record in shown)], ["---"] * (len(shown) + 1)]
    for term in term_names(records):
        rows.append([plain(term), *(number(record.terms.get(term)) for record in shown)])
    return "\n".join([*lines, "", *(f"| {' | '.join(row)} |" for row in rows)])


def label(record: Record) -> str:
    """Label of a rollout: number, kind and return with its ratings."""
    return f"{record.number} {KIND_NAMES[record.kind]} {returned(record)}"


def running(folder: Path) -> bool:
    """Whether a launcher or a learner uses the folder of a session."""
    return any(map(is_locked, (folder / "logs" / ".lock", folder / ".lock")))


def parameters(folder: Path) -> overlay.Setup:
    """Parameters of each node of a session, as launched; the default ones if not recorded."""
    file = folder / "logs" / "parameters.yaml"
    return overlay.read(file) if file.is_file() else overlay.setup()


class SessionPage:
    """Page of one session: drawings, progress and buttons.

    Raises:
        ValueError: The session cannot be read.
    """

    def __init__(self, server: GuardedServer, folder: Path) -> None:
        task = session.read(folder).task
        self._folder, self._task = folder, task
        self._page = Page(server, folder.name)
        self._node: View | None = None
        self._drawn = LiveState()
        self._skeleton: Skeleton | None = None  # of the live arm
        self._trail: deque[np.ndarray] = deque(maxlen=TRAIL_LENGTH)
        self._still = 0  # number of updates since the arm has moved
        self._teaching: threading.Event | None = None  # set at the end of the movement
        self._leading = False  # whether a person moves the arm now
        last = "the last finished rollout"
        rated = {
            REWARD: ("green", last, partial(self._give, REWARD, "reward")),
            PUNISH: ("orange", last, partial(self._give, PUNISH, "punish")),
        }
        if task.rated:
            hint = "the rollout that waits for it; 0 worst, 9 as it should be"
            rated = {
                label: ("green", hint, partial(self._give, label, "rate", value))
                for label, value in RATINGS.items()
            }
        buttons = {
            **rated,
            PAUSE: ("blue", "after the current trial", partial(self._give, PAUSE, "pause")),
            CONTINUE: ("blue", "after a pause", partial(self._give, CONTINUE, "continue")),
            TEACH: ("violet", "pause, guide the arm by hand, learn from it", self._teach),
            END_TEACHING: ("violet", "the demonstration is complete", self._end_teaching),
            STOP: ("red", "no safety function", partial(self._give, STOP, "stop")),
        }
        self._buttons = self._page.add_buttons(buttons)
        self._size = -1  # of the log that is shown [byte]
        self._chart = self._page.add_curve(KINDS)
        self._records: tuple[Record, ...] = ()
        self._failed: list[str] = []  # why the session has failed
        self._page.add_legend(task.body)
        self._enable_buttons()

    def tick(self) -> None:
        """Update the page."""
        self._show_new_rollouts()
        self._enable_buttons()
        if self._node is not None:
            self._draw(self._node.update())
        self._page.state(self._lines())

    def _show_new_rollouts(self) -> None:
        log = self._folder / session.LOG
        size = log.stat().st_size if log.exists() else 0
        if size == self._size:
            return
        found = session.read(self._folder)
        self._size, self._records = size, found.records
        settings = found.header.settings
        self._failed = failed(why_failed(self._records, self._task, settings, found.start))
        self._chart.data = curve(self._records)
        self._page.terms.content = newest(self._records, self._task)

    def connect(self, node: View | None) -> None:
        """Follow a running session through a node; None once it has ended."""
        self._node, self._skeleton = node, None
        self._end_teaching()

    def _enable_buttons(self) -> None:
        """Enable the buttons whose requests would be heard now."""
        practises = self._node is not None and is_locked(self._folder / ".lock")
        learns = practises and all(r.kind != "retest" for r in self._records)
        usable = {STOP: self._node is not None, PAUSE: practises, CONTINUE: practises}
        rated = learns and bool(self._records)
        usable |= {REWARD: rated, PUNISH: rated, TEACH: learns, END_TEACHING: self._leading}
        usable |= dict.fromkeys(RATINGS, learns)
        for label, button in self._buttons.items():
            if button.disabled == usable[label]:
                button.disabled = not usable[label]

    def _draw(self, state: LiveState) -> None:
        node, page = self._node, self._page
        if state.q is None or not node.urdf:
            return
        if self._skeleton is None:
            self._skeleton = Skeleton(node.urdf, node.model_joint_names, node.base_frame)
            self._drawn = LiveState()
            self._trail.clear()
            page.show_arm(self._skeleton)
        drawn = self._drawn
        rests = drawn.q is not None and np.abs(state.q - drawn.q).max() < STILL
        self._still = self._still + 1 if rests else 0
        shown = drawn.q if self._still > TRAIL_LENGTH else state.q
        if shown is not drawn.q:  # a browser renders the scene at every change
            self._trail.append(page.pose(shown))
            page.show_path("executed/trail", np.array(self._trail), LIGHT_ORANGE)
        page.place_body(state.body)
        if state.policy is not None and state.policy is not drawn.policy:
            start = self._skeleton.placements(state.policy.q_start)[0][-1]
            page.show_policy(state.policy, start)
        if state.tool_path is not None and state.tool_path is not drawn.tool_path:
            page.show_path("executed/path", state.tool_path, ORANGE)
        self._drawn = replace(state, q=shown)

    def _lines(self) -> dict[str, str]:
        records = self._records
        returns = [record.ret for record in records if record.ret is not None]
        lines = {
            "session": f"{self._folder.name} ({ENDED if self._node is None else RUNNING})",
            "rollouts": f"{len(records)}, best return {max(returns, default=0.0):.3f}",
        }
        lines |= dict(text.split(": ", 1) for text in self._failed)
        if self._node is not None:
            state = self._node.state
            age = time.monotonic() - state.receipt_time
            if state.q is None:
                lines["arm"] = "no joint state yet"
            elif age > STATE_TIMEOUT:
                lines["arm"] = f"no joint state for {age:.0f} s"
            else:
                lines["arm"] = "receiving joint states"
            for name, (level, text) in state.diagnostics.items():
                text = text.replace(f"{self._folder}/", "")
                lines[name.replace("_", " ")] = text if level == "ok" else f"⚠ {level}: {text}"
        return lines

    # Button callbacks, in threads of viser

    def _notify(self, label: str, text: str, good: bool = True) -> None:
        self._page.server.draw(partial(self._page.notify, label, text, good))

    def _give(self, label: str, kind: str, value: float | None = None) -> None:
        """Give feedback to the session and show the answer in the browser."""
        if (node := self._node) is None:
            self._notify(label, "the session is not running", good=False)
            return
        answer = node.give(kind, value)
        self._notify(label, answer.message, answer.success)

    def _teach(self) -> None:
        if self._teaching is None and self._node is not None:
            self._teaching = threading.Event()
            given = self._node, self._teaching
            threading.Thread(target=self._run_teaching, args=given, daemon=True).start()

    def _run_teaching(self, node: View, ended: threading.Event) -> None:
        def wait_for_end() -> None:
            self._notify(TEACH, "guide the arm by hand, then press End of movement")
            self._leading = True
            ended.wait()

        answer = node.teach(wait_for_end, partial(self._notify, TEACH))
        self._teaching, self._leading = None, False
        self._notify(TEACH, answer.text, answer.success)

    def _end_teaching(self) -> None:
        self._leading = False
        if self._teaching is not None:
            self._teaching.set()


def of_session(
    server: GuardedServer,
    folder: Path,
    ready: Callable[[], object],
    domain_of: Callable[[Path], int | None],
) -> None:
    """Show a session until interrupted, and call `ready` when the page can be opened.

    `domain_of` returns the DDS domain of a session in simulation by its folder; None on an arm.

    Raises:
        ValueError: The session cannot be read.
    """
    page = server.draw(lambda: SessionPage(server, folder))
    server.draw(page.tick)
    ready()
    while True:
        if not running(folder):
            _draw_until(server, page.tick, lambda: running(folder))
        setup = parameters(folder)
        make = partial(View, setup["torque_controller"], setup["pancake_tracker"]["body"])
        domain = domain_of(folder)
        with participant(make, domain, on_loopback=domain is not None) as node, node.link:
            server.draw(partial(page.connect, node))
            _draw_until(server, page.tick, lambda: not running(folder))
            server.draw(partial(page.connect, None))


def _draw_until(
    server: GuardedServer, tick: Callable[[], object], ended: Callable[[], bool]
) -> None:
    """Draw `tick` every `PERIOD` until `ended()`, which is called once every `CHECK_PERIOD`."""
    checked = time.monotonic()
    while True:
        time.sleep(PERIOD)
        server.draw(tick)
        if time.monotonic() - checked > CHECK_PERIOD:
            if ended():
                return
            checked = time.monotonic()
