# SPDX-License-Identifier: Apache-2.0
"""A running session is drawn from its newest states."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from toss_task import demonstrated_policy, practice_of, session_of, toss

from wam_power_ros.params.resources import share
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset

pytest.importorskip("viser")
from wam_power_ros.view.guarded_server import GuardedServer
from wam_power_ros.view.live import LiveState
from wam_power_ros.view.page import Page
from wam_power_ros.view.session_page import RATINGS, SessionPage
from wam_power_ros.view.skeleton import Skeleton


@pytest.fixture(scope="module")
def server() -> Iterator[GuardedServer]:
    server = GuardedServer("127.0.0.1", 8080)
    yield server
    server.stop()


def test_the_path_of_the_tool_is_drawn_while_the_arm_moves(
    server: GuardedServer, tmp_path: Path
) -> None:
    folder, urdf = tmp_path / "s", share("urdf/wam7.urdf").read_text()
    session_of(folder, preset("flip"), 0)
    arm = Skeleton(urdf)
    state = LiveState(q=np.zeros(len(arm.joint_names)), receipt_time=np.inf)
    arm_of_node = {"urdf": urdf, "model_joint_names": arm.joint_names, "base_frame": ""}
    page = SessionPage(server, folder)
    page.connect(SimpleNamespace(state=state, update=lambda: state, **arm_of_node))
    postures = np.linspace(0.0, 0.5, 3)[:, None] * np.ones(len(arm.joint_names))
    for q in postures:
        state.q = q
        page.tick()
    drawn = server.scene.get_handle_by_name("/executed/trail").points
    path = np.array([arm.placements(q)[0][-1] for q in postures])
    np.testing.assert_allclose(drawn, np.stack([path[:-1], path[1:]], axis=1), atol=1e-6)


def test_an_arm_without_shapes_is_drawn_as_sticks_from_joint_to_joint(
    server: GuardedServer,
) -> None:
    urdf = share("urdf/wam7.urdf").read_text()
    arm = Skeleton(re.sub(r"<visual>.*?</visual>", "", urdf, flags=re.DOTALL))
    page = Page(server, "sticks")
    page.show_arm(arm)
    page.pose(np.full(7, 0.3))
    drawn = server.scene.get_handle_by_name("/arm/sticks").points
    np.testing.assert_allclose(drawn[:, 1], arm.placements(np.full(7, 0.3))[0][1:], atol=1e-6)


def test_ratings_begin_with_a_rollout_and_end_with_the_learning(
    server: GuardedServer, tmp_path: Path
) -> None:
    settings, policies = preset("flip", budget=4, confirm=0, retests=2), [demonstrated_policy()]
    practice = practice_of(policies, settings, seed=0)
    with Session.begin(tmp_path / "s", settings, 0, policies) as session:
        page = SessionPage(server, session.folder)
        page.connect(SimpleNamespace(state=LiveState(), update=LiveState))

        def run() -> None:
            trial = practice.next_trial()
            session.append(practice.learn_assessed(trial, toss(trial, practice.task.settings)))
            page.tick()

        rate, pause = page._buttons["Reward"], page._buttons["Pause"]
        page.tick()
        assert rate.disabled and not pause.disabled  # there is nothing to rate
        for _ in range(4):
            run()
            assert not rate.disabled
        run()
        assert rate.disabled and not pause.disabled  # a re-test is not learnt from
    page.tick()
    assert pause.disabled  # the learner has ended
    page.connect(None)
    page.tick()
    assert all(button.disabled for button in page._buttons.values())


def test_a_body_of_one_marker_is_drawn_as_a_ball_and_one_that_turns_as_a_disc(
    server: GuardedServer,
) -> None:
    page = Page(server, "body")
    ball, disc = (server.scene.get_handle_by_name(f"/body/at/{n}") for n in ("ball", "disc"))
    place = np.array([0.5, 0.0, 0.5])
    page.place_body((place, np.array([1.0, 0.0, 0.0, 0.0])))
    assert ball.visible and not disc.visible
    page.place_body((place, np.array([0.6, 0.8, 0.0, 0.0])))
    page.place_body((place, np.array([1.0, 0.0, 0.0, 0.0])))  # by chance
    assert disc.visible and not ball.visible


def test_a_session_that_a_person_rates_has_buttons_for_ratings_that_are_passed_on(
    server: GuardedServer, tmp_path: Path
) -> None:
    given: list[tuple[str, float]] = []
    answer = SimpleNamespace(message="rated", success=True)
    node = SimpleNamespace(
        state=LiveState(),
        update=LiveState,
        give=lambda kind, value: given.append((kind, value)) or answer,
    )
    with Session.open(session_of(tmp_path / "s", preset("rated"), 0)):
        page = SessionPage(server, tmp_path / "s")
        assert "Reward" not in page._buttons
        page.connect(node)
        page.tick()
        assert not page._buttons["Rate 9"].disabled
        for label in ("Rate 0", "Rate 9"):
            page._give(label, "rate", RATINGS[label])
    assert given == [("rate", 0.0), ("rate", 1.0)]
