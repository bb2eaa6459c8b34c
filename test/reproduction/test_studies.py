# SPDX-License-Identifier: Apache-2.0
"""The command of the studies with a line for each place and learner."""

from pathlib import Path
from typing import Any

import pytest

from reproduction.studies import __main__ as studies
from reproduction.studies import equal_knowledge


@pytest.mark.parametrize("name", studies.STUDIES)
def test_every_learner_at_every_place_has_runs_of_its_own(name: str) -> None:
    table = studies.STUDIES[name]
    jobs = table.jobs([1, 2], [*table.places], [*table.told])
    assert len({job.name for job in jobs}) == len(jobs)
    results: dict[str, Any] = {}
    for job in jobs:  # each way to begin has its own part of a session with a new goal
        results.setdefault(job.study, {})[job.key] = {way: (job.name, way) for way in table.told}
    lines = [[*table.runs(results, p, each).values()] for p in table.places for each in table.told]
    assert all(lines) and len({str(line) for line in lines}) == len(lines)


def test_a_study_prints_what_each_learner_is_told_and_its_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(equal_knowledge, "ROLLOUTS", 2)
    words = ["equal_knowledge", "--only", "noisy returns", "--learners", "nothing", "power"]
    studies.main([*words, "--seeds", "2", "--folder", str(tmp_path)])
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("noisy returns, nothing (learns from nothing: the demonstration): {")
    assert second.startswith("noisy returns, power (learns from return): {'mean': 0.")
