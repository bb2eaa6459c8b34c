# SPDX-License-Identifier: Apache-2.0
"""Loops of `wam-power view`: of a bag, and of a session."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import viser
from rclpy.signals import SignalHandlerOptions

from wam_power_ros.params import parameter_file
from wam_power_ros.ros.node_runner import participant
from wam_power_ros.view import recorded
from wam_power_ros.view.live import View
from wam_power_ros.view.page import Page
from wam_power_ros.view.player import Player
from wam_power_ros.view.session_page import SessionPage, parameters, running

LOOK_PERIOD = 0.05  # of playback [s]
LIVE_PERIOD = 0.1  # between two looks at a running session [s]
CHECK_PERIOD = 1.0  # between two checks that it runs [s]


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
        time.sleep(LOOK_PERIOD)
        now = time.monotonic()
        player.advance(now - last)
        last = now


def of_session(
    server: viser.ViserServer,
    folder: Path,
    ready: Callable[[], object],
    environment: Callable[[Path], dict[str, str]],
) -> None:
    """Show a session, its rollouts and its learning curve until it is interrupted.

    Args:
        server: An open server.
        folder: Folder of the session.
        ready: Called when the page can be opened.
        environment: Variables that lead to the DDS domain of a running session.

    Raises:
        SessionError: It cannot be read.
    """
    exported = dict(os.environ)
    page = SessionPage(server, folder)
    page.tick(0.0)
    ready()
    while True:
        if not running(folder):
            _tick(page, LOOK_PERIOD, lambda: running(folder))
        enter(environment(folder), exported)
        setup = parameters(folder)
        namespace = parameter_file.namespace(folder / "logs/parameters.yaml")
        whose = setup["pancake_tracker"]["body"], namespace
        make = partial(View, setup["torque_controller"], *whose)
        with participant(make, SignalHandlerOptions.NO) as node:
            page.connect(node)
            _tick(page, LIVE_PERIOD, lambda: not running(folder))
            page.connect(None)


def enter(wanted: Mapping[str, str], exported: Mapping[str, str]) -> None:
    """Set variables of this process, and give those of the session before their exported values.

    Args:
        wanted: Variables of the session; one on a real arm has none.
        exported: Variables that this process was started with.
    """
    for name in os.environ.keys() - exported.keys():
        del os.environ[name]
    os.environ.update({**exported, **wanted})


def _tick(page: SessionPage, period: float, ended: Callable[[], bool]) -> None:
    """Keep the page up to date every `period` [s] until `ended()`, which is asked once a second."""
    last = asked = time.monotonic()
    while True:
        time.sleep(period)
        now = time.monotonic()
        page.tick(now - last)
        last = now
        if now - asked > CHECK_PERIOD:
            if ended():
                return
            asked = now
