# SPDX-License-Identifier: Apache-2.0
"""Ball-in-a-cup is learnt in one process, from a demonstration to re-tests, and without a hand."""

from __future__ import annotations

import numpy as np
import pytest

from wam_power_ros.in_process.environment import Environment
from wam_power_ros.params import overlay
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.ball_in_cup.task import BallInCup

SEED = 3001  # whose reproduction misses the cup


@pytest.mark.long
def test_a_demonstration_that_misses_when_reproduced_is_learnt_without_a_hand(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    setup = overlay.setup(task="ball_in_cup").changed({"wam_sim": {"seed": SEED}})
    environment = Environment.of(setup)
    script = environment.world.scene.script(np.random.default_rng([SEED, 0]))
    stamps_ns, q = environment.demonstrate(script, "demonstration-0")
    demonstration = BallInCup.demonstration_of(environment.arm, stamps_ns, q)
    policy = BallInCup.policy_of([demonstration], "demonstration-1")
    settings = preset("ball_in_cup", budget=15, confirm=3, retests=3)
    practice = Practice(settings, {}, [policy], SEED, environment)
    placed = []
    monkeypatch.setattr(environment, "place", lambda *given: placed.append(given))
    records = [*environment.practise(practice, scene_reset=False)]
    assert placed == []  # nobody was needed
    assert {record.clock["reset"]["by"] for record in records} == {"arm"}
    assert not records[0].truth["caught"] and not any(record.fault for record in records)
    assert practice.confirmed == 3
    retests = [record for record in records if record.kind == "retest"]
    assert [record.truth["caught"] for record in retests] == [True] * 3
    assert practice.task.achieved(retests[0])
