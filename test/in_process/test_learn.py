# SPDX-License-Identifier: Apache-2.0
"""Sessions without nodes: resumed, of another arm, refused."""

from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import yaml

from wam_power_ros.cli import main
from wam_power_ros.control.arm import Arm
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.in_process import learn
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.params import overlay
from wam_power_ros.practice import session
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import SessionSettings, preset
from wam_power_ros.tasks.flip.task import Flip


def rows(folder: Path) -> list[str]:
    return [record.to_json() for record in session.read(folder).records]


def sessions(folder: Path, name: str = "", seed: int = 3) -> learn.Iterator[Session]:
    setup = overlay.setup([name] if name else [], True, "reach").changed({"wam_sim": {"seed": 3}})
    settings = preset("reach", budget=3, retests=1)
    return learn.run(folder, setup, settings, seed, 1)


def test_a_session_that_is_cut_short_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    for _ in islice(sessions(tmp_path / "cut"), 3):  # as it begins, and two rollouts
        pass
    assert len(rows(tmp_path / "cut")) == 2
    for folder in ("cut", "whole"):
        *_, last = sessions(tmp_path / folder)
        assert (tmp_path / folder / "policy.json").is_file()
    assert rows(tmp_path / "cut") == rows(tmp_path / "whole")
    assert last.records[0].kind == "reproduction"
    assert last.records[-1].kind == "retest"


def test_a_session_of_another_arm_is_refused_and_left_unlocked(tmp_path: Path) -> None:
    next(sessions(tmp_path)).close()
    with pytest.raises(ValueError, match="belongs to another arm: wam7"):
        next(sessions(tmp_path, "ur"))
    Session.open(tmp_path).close()


def test_demonstrations_that_leave_no_rollout_are_refused_before_they_are_recorded(
    tmp_path: Path,
) -> None:
    settings = preset("flip", budget=2)
    with pytest.raises(ValueError, match="a budget of 2 rollouts"):
        next(learn.run(tmp_path, overlay.setup(task="flip"), settings, 0, 2))
    assert not Session.exists(tmp_path)


def test_a_demonstration_without_a_movement_is_left_out_and_the_others_keep_their_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, count = Flip.demonstration_of, iter(range(9))

    def second_only(arm: Arm, *recorded: np.ndarray) -> Demonstration:
        if next(count) != 1:
            raise ValueError("no movement")
        return read(arm, *recorded)

    monkeypatch.setattr(Flip, "demonstration_of", second_only)
    setup, settings = overlay.setup(task="flip"), preset("flip", budget=4)
    begun = next(learn.run(tmp_path, setup, settings, 0, 3))
    assert [policy.id for policy in begun.candidates] == ["demonstration-2"]
    begun.close()
    with pytest.raises(ValueError, match="no demonstration can be reproduced: no movement"):
        next(learn.run(tmp_path / "none", setup, settings, 0, 1))
    assert not Session.exists(tmp_path / "none")


def test_a_demonstration_in_which_the_arm_faults_is_left_out_with_the_reason(
    tmp_path: Path,
) -> None:
    limit = {"torque_controller": {"teaching_tool_speed_max": 0.3}}
    setup = overlay.setup(task="reach").changed(limit)
    with pytest.raises(ValueError, match="no demonstration can be reproduced: hold refused: fault"):
        next(learn.run(tmp_path, setup, preset("reach", budget=4), 0, 1))


def test_a_demonstration_whose_reproduction_would_fault_is_not_learnt_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = Fault(FaultKind.JOINT_SPEED, "joint 4 too fast")
    monkeypatch.setattr(Environment, "infeasible", lambda *_: fault)
    with pytest.raises(ValueError, match="would end in a fault: joint 4 too fast"):
        next(learn.run(tmp_path, overlay.setup(task="flip"), preset("flip", budget=4), 0, 1))


def test_a_set_up_has_the_settings_that_are_not_typed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, begun = tmp_path / "lab.yaml", []
    given = {"preset": "diagonal", "changes": '{"budget": 9, "retests": 1}'}
    file.write_text(yaml.safe_dump({"/**/learner": {"ros__parameters": given}}))

    def run(folder: Path, setup: object, settings: SessionSettings, *_: int) -> None:
        begun.append(settings)
        raise ValueError("enough")

    monkeypatch.setattr(learn, "run", run)
    typed = ["--simulate", "--config", str(file), "--task", "reach", "--trials", "2"]
    assert main.main(["learn", "--in-process", "--session", str(tmp_path / "s"), *typed]) == 2
    assert begun == [preset("reach", "diagonal", budget=2, retests=1)]


def test_what_needs_nodes_is_refused_in_process(refusal: Callable[..., str]) -> None:
    for words in (["--config", "wam_can"], ["--bags", "bags/demo_1"]):
        assert "wam-power: " in refusal("learn", "--in-process", "--session", "s", *words)
