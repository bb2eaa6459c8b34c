# SPDX-License-Identifier: Apache-2.0
"""Main loop of `wam-power view`."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from wam_power_ros.ros.node_runner import participant
from wam_power_ros.view.guarded_server import GuardedServer
from wam_power_ros.view.live import View
from wam_power_ros.view.session_page import SessionPage, parameters, running

PERIOD = 0.1  # [s] between updates
CHECK_PERIOD = 1.0  # [s] between checks whether the session runs


def of_session(
    server: GuardedServer,
    folder: Path,
    ready: Callable[[], object],
    domain_of: Callable[[Path], int | None],
) -> None:
    """Show a session and its learning curve until interrupted.

    Args:
        ready: Called when the page can be opened.
        domain_of: Returns the DDS domain of a session in simulation by its folder; None on an arm.

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
        body = setup["pancake_tracker"]["body"]
        make = partial(View, setup["torque_controller"], body)
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
