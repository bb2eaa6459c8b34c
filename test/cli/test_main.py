# SPDX-License-Identifier: Apache-2.0
"""The command line: same entry points as ros2 run, errors that say what to do instead."""

import io
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml
from rich.console import Console
from toss_task import demonstrated_policy, some_records

from wam_power_ros.cli import main
from wam_power_ros.cli.launcher import Devices, UsageError
from wam_power_ros.cli.session_options import SessionOptions, chosen
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.reporting import terminal

ROOT = Path(__file__).resolve().parents[2]
TASK = preset("flip", "hindsight").make_task({})
OUTCOME = TASK.outcome


def begun_session(folder: Path, seed: int = 5) -> Path:
    Session.begin(folder, preset("flip", "hindsight"), seed, [demonstrated_policy()]).close()
    return folder


def test_wam_power_run_starts_what_ros2_run_starts() -> None:
    setup = (ROOT / "setup.py").read_text().replace("{NAME}", "wam_power_ros")
    points = dict(re.findall(r'"([\w-]+) = (wam_power_ros\.entry:\w+)"', setup))
    assert points.pop("wam-power") == "wam_power_ros.entry:wam_power"
    assert points == {name: point.value for name, point in main.NODES.items()}


@pytest.mark.parametrize("node", main.NODES)
def test_every_node_has_a_module(node: str) -> None:
    assert find_spec(main.NODES[node].load().args[0]) is not None


def test_a_node_gets_its_arguments_from_the_command_line() -> None:
    command = [sys.executable, "-m", "wam_power_ros.cli", "run", "learner"]
    ended = subprocess.run(
        [*command, "--ros-args", "-p", "seed:=-1"], cwd=ROOT, capture_output=True, timeout=60
    )
    assert ended.returncode != 0
    assert b"seed = -1: Input should be greater than or equal to 0" in ended.stdout + ended.stderr
    assert b"is missing" not in ended.stdout + ended.stderr
    assert b"Started without a parameter file" in ended.stdout + ended.stderr


def test_an_unknown_node_is_refused_with_the_known_ones(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main.main(["run", "torque_controler"])
    message = capsys.readouterr().err
    assert all(node in message for node in main.NODES)


def test_seed_and_settings_of_a_session_cannot_be_changed(
    tmp_path: Path, refusal: Callable[..., str]
) -> None:
    begun_session(tmp_path / "s")
    for words, own in (
        ("--seed 6", "seed 5; omit seed"),
        ("--trials 9", "trials 60; omit trials"),
        ("--minutes 9", "minutes 0; omit minutes"),
        ("--task reach", "task flip; omit task"),
        ("--learner cma_es", "learner power; omit learner"),
        ("--preset paper", "other settings than preset paper; omit preset"),
    ):
        assert f"was begun with {own}" in refusal("learn", "--session", "s", *words.split())


def test_the_command_that_began_a_session_resumes_it(tmp_path: Path) -> None:
    bags = [tmp_path / "a", tmp_path / "b"]
    asked = SessionOptions("flip", "cma_es", "paper", trials=20, minutes=30, seed=5, bags=bags)
    settings = preset("flip", "paper", {"name": "cma_es"}, budget=20, minutes=30)
    Session.begin(
        tmp_path / "s", settings, 5, [demonstrated_policy()], demonstrations=[str(bags[1])]
    ).close()  # the first bag was of no use
    assert chosen(tmp_path / "s", asked, Devices()) == (5, "flip")
    with pytest.raises(UsageError, match="omit bags"):
        chosen(tmp_path / "s", replace(asked, bags=bags[:1]), Devices())


def test_resuming_needs_a_session(refusal: Callable[..., str]) -> None:
    assert "holds no session" in refusal("learn", "--resume", "--session", "none")


def test_no_controller_starts_on_an_arm_without_a_person_to_confirm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    arguments = ["teach", "--folder", str(tmp_path / "taught"), "--config", "geodude"]
    assert main.main(arguments) == 2
    message = capsys.readouterr().err
    assert "hand on the pendant" in message
    assert "no answer: standard input is closed" in message


def test_an_unknown_set_up_starts_nothing(refusal: Callable[..., str]) -> None:
    message = refusal("learn", "--session", "s", "--config", "geodud")
    assert "no set-up 'geodud'" in message


def test_the_parameters_of_a_set_up_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["config", "--config", "geodude", "--simulate"]) == 0
    nodes = yaml.safe_load(capsys.readouterr().out)
    assert nodes["/**/wam_sim"]["ros__parameters"]["joint_names"][6] == "right_j7"


def test_a_report_needs_a_session(refusal: Callable[..., str]) -> None:
    assert "no session.yaml" in refusal("report", ".")


def test_the_report_command_writes_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = begun_session(tmp_path / "s")
    assert main.main(["report", str(folder)]) == 0
    assert str(folder / "report.html") in capsys.readouterr().out
    assert (folder / "report.html").stat().st_size > 1000


def test_a_log_shows_every_rollout_once_on_a_line_of_its_own() -> None:
    records = some_records(9)
    text = io.StringIO()
    with terminal.Display(Console(file=text, width=80)) as display:
        for count in (0, 2, 2, 9):
            display.show(records[:count], preset("flip", "hindsight"), TASK)
    _, *lines = text.getvalue().splitlines()
    assert [int(line.split()[0]) for line in lines] == list(range(1, 10))
    assert all(f"return {record.ret:.3f}" in line for record, line in zip(records, lines, strict=1))


def test_a_terminal_shows_the_newest_rollouts_and_the_best_return_so_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    records = some_records(40)
    monkeypatch.setattr(terminal, "ROLLOUTS_SHOWN", 5)
    table = terminal.rollout_table(records, OUTCOME)
    numbers, bests = (list(table.columns[place].cells) for place in (0, -2))
    assert numbers == ["36", "37", "38", "39", "40"]
    assert bests[-1] == f"{max(record.ret or 0.0 for record in records):.3f}"
    text = io.StringIO()
    with terminal.Display(Console(file=text, width=120, force_terminal=True)) as display:
        display.show(records, preset("flip", "hindsight", budget=60), TASK)
    assert "40 of at most 60 rollouts" in re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text.getvalue())


def test_the_summary_counts_the_retests_by_tracker_and_by_truth() -> None:
    record = some_records(3)[-1]
    good = {**(record.observation or {}), "resting": True, "flipped": True, "angle": 3.0}
    truth = {"caught": True, "flipped": False}
    tests = [
        record.model_copy(update={"kind": "retest", "observation": good, "truth": truth}),
        record.model_copy(update={"kind": "retest", "observation": {**good, "resting": False}}),
    ]
    text = terminal.summary(tests, TASK)
    assert "1 of 2 flipped" in text
    assert "simulator's ground truth: 0 of 1" in text
