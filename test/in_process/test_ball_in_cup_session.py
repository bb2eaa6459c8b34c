# SPDX-License-Identifier: Apache-2.0
"""Ball-in-a-cup is practised in one process without a hand."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from wam_power_ros.in_process.environment import Environment
from wam_power_ros.params import overlay
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.ball_in_cup.task import BallInCup

SEED = 3001  # whose reproduction misses the cup


def test_the_arm_puts_the_ball_back_between_rollouts(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = overlay.setup(task="ball_in_cup").changed({"wam_sim": {"seed": SEED}})
    environment = Environment.of(setup)
    script = environment.world.scene.script(np.random.default_rng([SEED, 0]))
    stamps_ns, q = environment.demonstrate(script, "demonstration-0")
    demonstration = BallInCup.demonstration_of(environment.arm, stamps_ns, q)
    policy = BallInCup.policy_of([demonstration], "demonstration-1")
    practice = Practice(preset("ball_in_cup"), {}, [policy], SEED, environment)
    placed = []
    monkeypatch.setattr(environment, "place", lambda *given: placed.append(given))
    records = [*islice(environment.practise(practice, scene_reset=False), 2)]
    assert placed == []  # nobody was needed
    assert {record.clock["reset"]["by"] for record in records} == {"arm"}
    assert not any(record.fault for record in records)
    assert records[1].kind == "mean" and records[1].z != records[0].z  # the miss was corrected
