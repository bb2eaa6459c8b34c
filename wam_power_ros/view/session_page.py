# SPDX-License-Identifier: Apache-2.0
"""The page of a session: from its records, and while it runs from its nodes as well."""

from __future__ import annotations

import fcntl
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
import viser

from wam_power_ros.learning.policy_shapes import plan
from wam_power_ros.params import overlay, parameter_file
from wam_power_ros.practice import session
from wam_power_ros.ros import interface
from wam_power_ros.view import recorded, teach_again
from wam_power_ros.view.live import Seen, View
from wam_power_ros.view.page import EXECUTED, NO_SAFETY, PLANNED, TRAIL, Page
from wam_power_ros.view.player import Player
from wam_power_ros.view.progress import Progress
from wam_power_ros.view.skeleton import Skeleton

TRAIL_LENGTH = 40  # looks at the arm, ten a second, whose tool positions are joined
SILENCE = 1.0  # without a joint state, after which the arm counts as silent [s of wall time]
RUNNING, ENDED = "running", "not running: its records"
REWARD, PUNISH, PAUSE, CONTINUE = "Reward", "Punish", "Pause", "Continue"
TEACH, TAUGHT, STOP = "Teach again", "End of movement", "STOP the arm"


def running(folder: Path) -> bool:
    """Whether a launcher or a learner is at work in the folder of a session."""
    return any(map(_held, (folder / "logs" / ".lock", folder / ".lock")))


def _held(path: Path) -> bool:
    try:
        with path.open() as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def parameters(folder: Path) -> overlay.Setup:
    """Parameters by node that a session was launched with; the plain ones if it does not say."""
    file = folder / "logs" / "parameters.yaml"
    if not file.is_file():
        return overlay.setup()
    return parameter_file.of_nodes(file)


class SessionPage:
    """What the page shows of one session, and what its buttons do.

    Args:
        server: An open server.
        folder: Folder of the session.

    Raises:
        SessionError: It cannot be read.
    """

    def __init__(self, server: viser.ViserServer, folder: Path) -> None:
        task = session.read_task(folder)
        self._folder = folder
        self._page = Page(server, folder.name)
        self._node: View | None = None
        self._drawn: Seen = Seen()
        self._trail: deque[np.ndarray] = deque(maxlen=TRAIL_LENGTH)
        self._teaching = False
        practice = {
            REWARD: (
                "green",
                "the last finished rollout",
                self._asking(REWARD, interface.LEARNER_REWARD),
            ),
            PUNISH: (
                "orange",
                "the last finished rollout",
                self._asking(PUNISH, interface.LEARNER_PUNISH),
            ),
            PAUSE: (
                "blue",
                "after the trial under way",
                self._asking(PAUSE, interface.LEARNER_PAUSE, True),
            ),
            CONTINUE: (
                "blue",
                "after a pause",
                self._asking(CONTINUE, interface.LEARNER_PAUSE, False),
            ),
            TEACH: ("violet", "pause, lead the arm, learn from it", self._teach),
            TAUGHT: ("violet", "you have led the arm", self._taught),
            STOP: ("red", "no safety function", self._asking(STOP, interface.STOP)),
        }
        self._buttons = self._page.add_buttons("Practice", practice, NO_SAFETY)
        self._follow = server.gui.add_checkbox("follow the arm", True)
        self._player = Player(self._page, [], self._movement)
        self._player.on_choice = self._unfollow
        self._progress = Progress(self._page, folder, task)
        self._page.add_legend(task.body)
        self._enable()

    def _movement(self, name: str) -> recorded.Movement:
        if name not in self._progress.bags:
            raise ValueError(f"{name!r} has no bag")
        return recorded.read(self._progress.bags[name])

    # What is shown

    def tick(self, elapsed: float) -> None:
        """Show what has changed in a time [s]."""
        if self._progress.refresh():
            self._player.offer([*self._progress.bags])
        seen = None if self._node is None else self._node.look()
        if seen is not None and self._follow.value:
            self._draw(seen)
        else:
            self._player.redraw()
            self._player.advance(elapsed)
        self._page.state(self._lines())

    def connect(self, node: View | None) -> None:
        """Follow a running session by its node, None when it has ended."""
        self._node, self._drawn = node, Seen()
        self._teaching = False
        self._enable()

    def _enable(self) -> None:
        for button in self._buttons.values():
            button.disabled = self._node is None
        self._buttons[TAUGHT].disabled = True
        self._follow.disabled = self._node is None

    def _draw(self, seen: Seen) -> None:
        drawn, node, page = self._drawn, self._node, self._page
        if seen.q is None or not node.urdf:
            return
        if drawn.q is None or not self._player.stale:  # a movement was played
            drawn = Seen()
            self._trail.clear()
            page.show_arm(Skeleton(node.urdf, node.model_joint_names))
            self._player.stale = True
        self._trail.append(page.pose(seen.q))
        page.show_path("trail", np.array(self._trail), TRAIL)
        page.place_body(seen.body)
        if seen.policy is not None and seen.policy is not drawn.policy:
            start = page.skeleton.placements(seen.policy.q_start)[0][-1]
            page.show_path("planned", plan(seen.policy, start), PLANNED)
            page.show_attractors(seen.policy)
        if seen.tool_path is not None and seen.tool_path is not drawn.tool_path:
            page.show_path("executed", seen.tool_path, EXECUTED)
        self._drawn = Seen(**vars(seen))

    def _unfollow(self) -> None:
        self._follow.value = False

    def _lines(self) -> dict[str, str]:
        records = self._progress.records
        returns = [r.rated_return for r in records if r.rated_return is not None]
        lines = {
            "session": f"{self._folder.name} ({ENDED if self._node is None else RUNNING})",
            "rollouts": f"{len(records)}, best return {max(returns, default=0.0):.3f}",
        }
        if self._node is not None:
            age = time.monotonic() - self._node.seen.heard
            silent = (
                "no joint state yet" if self._node.seen.q is None else f"silent for {age:.0f} s"
            )
            lines["arm"] = silent if age > SILENCE else "heard"
            for name, (level, text) in self._node.seen.diagnoses.items():
                text = text.replace(f"{self._folder}/", "")
                lines[name.replace("_", " ")] = text if level == "ok" else f"⚠ {level}: {text}"
        return lines

    # What the buttons do, in threads of viser

    def _ask(self, label: str, name: str, on: bool | None = None) -> None:
        """Call a service of the session, and show the answer in the browser."""
        node = self._node
        if node is None:
            self._page.tell(label, "the session is not running", good=False)
            return
        answer = node.ask(name, on)
        self._page.tell(label, answer.text or answer.code.value, good=answer.success)

    def _asking(self, label: str, name: str, on: bool | None = None) -> Callable[[], object]:
        return lambda: self._ask(label, name, on)

    def _teach(self) -> None:
        if self._teaching or self._node is None:
            return
        self._teaching = True
        threading.Thread(target=self._teach_now, args=(self._node,), daemon=True).start()

    def _teach_now(self, node: View) -> None:
        try:
            teach_again.begin(node, lambda text: self._page.tell(TEACH, text))
            if node.offered(interface.DEMONSTRATE):
                self._taught()
            else:
                self._buttons[TAUGHT].disabled = False
        except teach_again.NotTaughtError as error:
            self._teaching = False
            self._page.tell(TEACH, str(error), good=False)

    def _taught(self) -> None:
        if not self._teaching or self._node is None:
            return
        self._buttons[TAUGHT].disabled = True
        try:
            self._page.tell(TEACH, teach_again.finish(self._node))
        except teach_again.NotTaughtError as error:
            self._page.tell(TEACH, str(error), good=False)
        finally:
            self._teaching = False
