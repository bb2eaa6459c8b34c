# SPDX-License-Identifier: Apache-2.0
"""A running session is drawn from its newest states."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from toss_task import demonstrated_policy

from wam_power_ros.params.resources import share
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset

pytest.importorskip("viser")
from wam_power_ros.view.guarded_server import open_server
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
