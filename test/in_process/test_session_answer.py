# SPDX-License-Identifier: Apache-2.0
"""The final policy of a session is executed again in the scene of its task."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from reach_task import taught_scenario

from wam_power_ros.in_process import session_answer
from wam_power_ros.params import overlay
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset


def begun(folder: Path, radius: float, *names: str) -> Path:
    """A session of reaching under set-ups, its best policy so far the demonstrated one."""
    scenario = taught_scenario()
    place = [*scenario.obstacle.tolist(), radius]
    context = {"demonstrated": scenario.demonstrated.tolist(), "obstacle": place}
    settings = preset("reach")
    with Session.begin(folder, settings, 3, [scenario.policy], context=context) as session:
        session.save_policy(scenario.policy)
    nothing = {"rollouts": 0, "bytes": 0, "sha256": hashlib.sha256(b"").hexdigest()}
    (folder / "acknowledged.json").write_text(json.dumps(nothing))  # with an empty log
    setup = overlay.setup(names, simulated=True, task="reach")
    (folder / "logs").mkdir()
    file = folder / "logs" / "parameters.yaml"
    changes = {node: {"guarded_region": place} for node in ("torque_controller", "wam_sim")}
    file.write_text(overlay.text(setup.changed(changes)))
    return folder


def test_the_answer_of_a_reach_meets_the_obstacle_of_its_session(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s", radius := 0.09)
    shown = session_answer.run(folder, film=False)
    assert shown.rollout.body is None and shown.film is None
    assert "touched the obstacle" in shown.caption
    away = np.linalg.norm(shown.rollout.tool.position - taught_scenario().obstacle, axis=1)
    assert away.min() > radius - 0.03
    assert session_answer.main([str(folder), "--no-film", "no <OpenGL>"]) == 0
    html = (folder / "report.html").read_text()
    assert "No film: no &lt;OpenGL&gt;" in html and "Ground truth" in html


def test_the_answer_of_an_unknown_world_is_executed_in_that_world(tmp_path: Path) -> None:
    folders = [begun(tmp_path / "s", 0.0), begun(tmp_path / "u", 0.0, "unknown_world")]
    paths = [session_answer.run(each, film=False).rollout.tool.position for each in folders]
    apart = np.linalg.norm(paths[0] - paths[1], axis=1)
    assert apart.max() > 1e-3


def test_a_session_without_a_policy_is_refused(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s", 0.0)
    (folder / "policy.json").unlink()
    with pytest.raises(ValueError, match="no policy yet"):
        session_answer.run(folder, film=False)


def test_a_session_that_does_not_say_in_which_set_up_it_ran_is_not_executed(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s", 0.0)
    (folder / "logs" / "parameters.yaml").unlink()
    with pytest.raises(ValueError, match=r"parameters.yaml, the set-up .*, is missing"):
        session_answer.run(folder, film=False)
