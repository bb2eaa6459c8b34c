# SPDX-License-Identifier: Apache-2.0
"""The command line: same entry points as ros2 run; sessions are begun, resumed and reported."""

import io
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest
from conftest import ROOT
from toss_task import session_of

from wam_power_ros.cli import main
from wam_power_ros.cli.launcher import Devices, UsageError
from wam_power_ros.cli.session_options import SessionOptions, chosen
from wam_power_ros.practice.settings import preset


@pytest.fixture
def begun(tmp_path: Path) -> Path:
    """A session that has just begun."""
    return session_of(tmp_path / "s", preset("flip", "hindsight"), 0, seed=5)


def test_wam_power_run_starts_what_ros2_run_starts() -> None:
    setup = (ROOT / "setup.py").read_text().replace("{NAME}", "wam_power_ros")
    points = dict(re.findall(r'"([\w-]+) = (wam_power_ros\.entry:\w+)"', setup))
    assert points.pop("wam-power") == "wam_power_ros.entry:wam_power"
    assert points == {name: point.value for name, point in main.NODES.items()}
    assert all(find_spec(point.load().args[0]) for point in main.NODES.values())


def test_seed_and_settings_of_a_session_cannot_be_changed(
    begun: Path, refusal: Callable[..., str]
) -> None:
    for words, own in (
        ("--seed 6", "seed 5; omit seed"),
        ("--trials 9", "trials 60; omit trials"),
        ("--minutes 9", "minutes 0; omit minutes"),
        ("--task reach", "task flip; omit task"),
        ("--learner cma_es", "learner power; omit learner"),
        ("--preset paper", "other settings than preset paper; omit preset"),
    ):
        assert f"was begun with {own}" in refusal("learn", "--session", begun.name, *words.split())


def test_the_command_that_began_a_session_resumes_it(tmp_path: Path) -> None:
    bags = [tmp_path / "a", tmp_path / "b"]
    asked = SessionOptions("flip", "cma_es", "paper", trials=20, minutes=30, seed=5, bags=bags)
    settings = preset("flip", "paper", {"name": "cma_es"}, budget=20, minutes=30)
    used = [str(bags[1])]  # the first bag was of no use
    session_of(tmp_path / "s", settings, 0, seed=5, demonstrations=used)
    assert chosen(tmp_path / "s", asked, Devices()) == (5, "flip")
    with pytest.raises(UsageError, match="omit bags"):
        chosen(tmp_path / "s", replace(asked, bags=bags[:1]), Devices())


def test_no_controller_starts_on_an_arm_without_a_person_to_confirm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    arguments = ["teach", "--folder", str(tmp_path / "taught"), "--config", "geodude"]
    assert main.main(arguments) == 2
    message = capsys.readouterr().err
    assert "hand on the pendant" in message
    assert "no answer: standard input is closed" in message
