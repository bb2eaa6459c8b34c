# SPDX-License-Identifier: Apache-2.0
"""Loops of `wam-power view`: of a bag, and of a session."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import viser

from wam_power_ros.practice import session
from wam_power_ros.view import recorded
from wam_power_ros.view.page import Page
from wam_power_ros.view.player import Player
from wam_power_ros.view.progress import Progress

PERIOD = 0.05  # of playback [s]


def of_bag(server: viser.ViserServer, bag: Path, ready: Callable[[], object]) -> None:
    """Show a bag until it is interrupted.

    Args:
        server: An open server.
        bag: Folder of the bag.
        ready: Called when the page can be opened.

    Raises:
        ValueError: It cannot be read.
    """
    movement = recorded.read(bag)
    page = Page(server, bag.name)
    player = Player(page, [bag.name], lambda name: movement)
    page.add_legend(movement.body, movement.policy is not None)
    kind = "demonstration" if movement.policy is None else f"rollout of {movement.policy.id}"
    page.state({"bag": bag.name, "it is": kind, "length": f"{movement.duration:.2f} s"})
    player.show(bag.name)
    last = time.monotonic()
    ready()
    while True:
        time.sleep(PERIOD)
        now = time.monotonic()
        player.advance(now - last)
        last = now


def of_session(server: viser.ViserServer, folder: Path, ready: Callable[[], object]) -> None:
    """Show a session, its rollouts and its learning curve until it is interrupted.

    Args:
        server: An open server.
        folder: Folder of the session.
        ready: Called when the page can be opened.

    Raises:
        SessionError: It cannot be read.
    """
    task = session.read_task(folder)
    page = Page(server, folder.name)
    player = Player(page, [], lambda name: recorded.read(progress.bags[name]))
    progress = Progress(page, folder, task)
    page.add_legend(task.body)
    ready()
    last = time.monotonic()
    while True:
        if progress.refresh():
            player.offer([*progress.bags])
            page.state(_summary(folder, progress))
            if player.movement is None and progress.bags:
                player.show(next(iter(progress.bags)))
        time.sleep(PERIOD)
        now = time.monotonic()
        player.advance(now - last)
        last = now


def _summary(folder: Path, progress: Progress) -> dict[str, str]:
    returns = [r.rated_return for r in progress.records if r.rated_return is not None]
    best = f"{max(returns):.3f}" if returns else "none yet"
    return {"session": folder.name, "rollouts": str(len(progress.records)), "best return": best}
