# SPDX-License-Identifier: Apache-2.0
"""The final policy of a session is executed again in the scene of its task."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from reproduction.studies.reaching_arm import taught_scenario
from wam_power_ros.in_process import session_answer
from wam_power_ros.params import overlay
from wam_power_ros.practice.session import Session, SessionError
from wam_power_ros.practice.settings import preset


def begun(folder: Path, radius: float) -> Path:
    """A session of reaching whose best policy so far is the demonstrated one."""
    scenario = taught_scenario()
    place = [*scenario.obstacle.tolist(), radius]
    context = {"demonstrated": scenario.demonstrated.tolist(), "obstacle": place}
    settings = preset("reach")
    with Session.begin(folder, settings, 3, [scenario.policy], context=context) as session:
        session.save_policy(scenario.policy)
    nothing = {"rollouts": 0, "bytes": 0, "sha256": hashlib.sha256(b"").hexdigest()}
    (folder / "acknowledged.json").write_text(json.dumps(nothing))  # with an empty log
    return folder


@pytest.mark.parametrize("radius", [0.0, 0.09])
def test_the_answer_of_a_reach_meets_the_obstacle_of_its_session(
    tmp_path: Path, radius: float
) -> None:
    folder = begun(tmp_path / "s", radius)
    shown = session_answer.run(folder, film=False)
    assert shown.rollout.body is None and shown.film is None
    assert ("touched the obstacle" in shown.caption) == (radius > 0.0)
    away = np.linalg.norm(shown.rollout.tool.position - taught_scenario().obstacle, axis=1)
    assert away.min() > radius - 0.03
    assert session_answer.main([str(folder), "--no-film", "no <OpenGL>"]) == 0
    html = (folder / "report.html").read_text()
    assert "No film: no &lt;OpenGL&gt;" in html and "Ground truth" in html


def test_the_answer_of_an_unknown_world_is_executed_in_that_world(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s", 0.0)
    (folder / "logs").mkdir()
    paths = []
    for unknown in (False, True):
        setup = overlay.setup(["unknown_world"] if unknown else [], simulated=True, task="reach")
        (folder / "logs" / "parameters.yaml").write_text(overlay.text(setup))
        paths.append(session_answer.run(folder, film=False).rollout.tool.position)
    apart = np.linalg.norm(paths[0] - paths[1], axis=1)
    assert apart.max() > 1e-3


def test_a_session_without_a_policy_is_refused(tmp_path: Path) -> None:
    folder = begun(tmp_path / "s", 0.0)
    (folder / "policy.json").unlink()
    with pytest.raises(SessionError, match="no policy yet"):
        session_answer.run(folder, film=False)
