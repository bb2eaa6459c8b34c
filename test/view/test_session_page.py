# SPDX-License-Identifier: Apache-2.0
"""A running session is drawn from its newest states."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from toss_task import demonstrated_policy, practice_of, toss

from wam_power_ros.params.resources import share
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset

pytest.importorskip("viser")
from wam_power_ros.view.guarded_server import close, open_server
from wam_power_ros.view.live import LiveState
from wam_power_ros.view.session_page import SessionPage
from wam_power_ros.view.skeleton import Skeleton


def test_the_path_of_the_tool_is_drawn_while_the_arm_moves(tmp_path: Path) -> None:
    folder, urdf = tmp_path / "s", share("urdf/wam7.urdf").read_text()
    with Session.begin(folder, preset("flip"), 0, [demonstrated_policy()]):
        pass
    arm = Skeleton(urdf)
    state = LiveState(q=np.zeros(len(arm.joint_names)), receipt_time=np.inf)
    node = SimpleNamespace(
        state=state, update=lambda: state, urdf=urdf, model_joint_names=arm.joint_names
    )
    server = open_server("127.0.0.1", 8080)
    try:
        page = SessionPage(server, folder)
        page.connect(node)
        postures = np.linspace(0.0, 0.5, 3)[:, None] * np.ones(len(arm.joint_names))
        for q in postures:
            state.q = q
            page.tick(0.1)
        drawn = server.scene.get_handle_by_name("/trail").points
    finally:
        server.stop()
    path = arm.tool_path(postures)
    np.testing.assert_allclose(drawn, np.stack([path[:-1], path[1:]], axis=1), atol=1e-6)


def test_playback_follows_the_newest_rollout_and_ratings_end_with_the_learning(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "s"
    settings, policies = preset("flip", budget=4, confirm=0, retests=2), [demonstrated_policy()]
    practice = practice_of(policies, settings, seed=0)
    server = open_server("127.0.0.1", 8080)
    try:
        with Session.begin(folder, settings, 0, policies) as session:
            page = SessionPage(server, folder)
            page.connect(SimpleNamespace(state=LiveState(), update=LiveState))

            def run() -> str:
                """Execute a rollout; returns the chosen movement."""
                trial = practice.next_trial()
                ended = toss(trial, practice.task.settings)
                session.append(practice.learn_assessed(trial, ended, bag=f"rollout_{trial.id}"))
                page.tick(0.1)
                return page._player._choice.value.split()[0]

            rate, pause = page._buttons["Reward"], page._buttons["Pause"]
            page.tick(0.1)
            assert rate.disabled and not pause.disabled  # there is nothing to rate
            assert [run() for _ in range(3)] == ["1", "2", "3"] and not rate.disabled
            page._player._choose()
            session.append(practice.rate(0.3))
            assert run() == "3"  # a person has chosen
            run()
            assert rate.disabled and not pause.disabled  # a re-test is not learnt from
        page.tick(0.1)
        assert pause.disabled  # the learner has ended
    finally:
        close(server)
