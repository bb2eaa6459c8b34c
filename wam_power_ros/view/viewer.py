# SPDX-License-Identifier: Apache-2.0
"""Main loops of `wam-power view`, for a bag and for a session."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from wam_power_ros.ros.node_runner import participant
from wam_power_ros.view import recorded
from wam_power_ros.view.guarded_server import GuardedServer
from wam_power_ros.view.live import View
from wam_power_ros.view.page import Page
from wam_power_ros.view.player import Player
from wam_power_ros.view.session_page import SessionPage, parameters, running

PLAYBACK_PERIOD = 0.05  # [s] between updates while nothing runs
LIVE_PERIOD = 0.1  # [s] between updates of a running session
CHECK_PERIOD = 1.0  # [s] between checks whether the session runs


def of_bag(server: GuardedServer, bag: Path, ready: Callable[[], object]) -> None:
    """Show a bag until interrupted.

    Raises:
        ValueError: The bag cannot be read.
    """
    movement = recorded.read(bag)

    def made() -> Player:
        page = Page(server, bag.name)
        player = Player(page, lambda name: movement)
        page.add_legend(movement.body, movement.policy is not None)
        kind = "demonstration" if movement.policy is None else f"rollout of {movement.policy.id}"
        page.state({"bag": bag.name, "it is": kind, "length": f"{movement.duration:.2f} s"})
        player.offer([bag.name])
        return player

    player = server.draw(made)
    ready()
    _draw_until(server, player.advance, PLAYBACK_PERIOD, lambda: False)


def of_session(
    server: GuardedServer,
    folder: Path,
    ready: Callable[[], object],
    domain_of: Callable[[Path], int | None],
) -> None:
    """Show a session, its rollouts and its learning curve until interrupted.

    Args:
        ready: Called when the page can be opened.
        domain_of: Returns the DDS domain of a session in simulation by its folder; None on an arm.

    Raises:
        ValueError: The session cannot be read.
    """
    page = server.draw(lambda: SessionPage(server, folder))
    server.draw(lambda: page.tick(0.0))
    ready()
    while True:
        if not running(folder):
            _draw_until(server, page.tick, PLAYBACK_PERIOD, lambda: running(folder))
        setup = parameters(folder)
        body = setup["pancake_tracker"]["body"]
        make = partial(View, setup["torque_controller"], body)
        domain = domain_of(folder)
        with participant(make, domain, on_loopback=domain is not None) as node, node.link:
            server.draw(partial(page.connect, node))
            _draw_until(server, page.tick, LIVE_PERIOD, lambda: not running(folder))
            server.draw(partial(page.connect, None))


def _draw_until(
    server: GuardedServer,
    tick: Callable[[float], None],
    period: float,
    ended: Callable[[], bool],
) -> None:
    """Draw `tick` of the time since the last one, every `period` [s], until `ended()`.

    `ended` is called once a second.
    """
    last = checked = time.monotonic()
    while True:
        time.sleep(period)
        now = time.monotonic()
        server.draw(partial(tick, now - last))
        last = now
        if now - checked > CHECK_PERIOD:
            if ended():
                return
            checked = now
