# SPDX-License-Identifier: Apache-2.0
"""The report of a session agrees with its records and needs no other file."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from toss_task import ANY_ARM, demonstrated_policy
from toss_task import session_of as begun

from wam_power_ros.cli.commands import _print_summary
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.practice import session
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.reporting import session_report, terminal

TURNS = [math.radians(degrees) for degrees in (60, 100, 150, 170, 175, 180)]


def a_rollout(id: str, angle: float) -> Rollout:
    """A still pan; the pancake rests, rises by .45 m, turns by `angle` and lies in the pan."""
    t = np.arange(0.0, 1.86, 0.01)
    place = np.array([0.7, 0.0, 0.4])
    pan = EndEffectorPath(id, t, np.tile(place, (len(t), 1)), np.tile([0.0, 0, 0, 1], (len(t), 1)))
    frames = np.arange(0.0, 1.86, 1 / 30)
    flight = 2.0 * math.sqrt(2.0 * 0.45 / 9.81)
    part = np.clip((frames - 0.3) / flight, 0.0, 1.0)
    position = np.tile(place, (len(frames), 1))
    position[:, 2] += 4.0 * 0.45 * part * (1.0 - part)
    half = 0.5 * angle * part
    half[part == 1.0] = 0.5 * math.pi * round(angle / math.pi)  # comes to lie flat
    quat = np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], axis=1)
    return Rollout(pan, BodyPath(id, frames, position, quat))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of six rollouts that turn the pancake further and further."""
    return session_of(tmp_path_factory.mktemp("report"), TURNS)


@pytest.fixture(scope="module")
def html(folder: Path) -> str:
    """Its report."""
    return session_report.write(folder).read_text()


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports whose figures are not drawn, which takes seconds each."""
    monkeypatch.setattr(session_report.plotting, "svg", lambda figure: b"<svg/>")


def session_of(tmp_path: Path, turns: list[float]) -> Path:
    settings = preset("flip", budget=len(turns), confirm=0, retests=0)
    truth = {"caught": True, "flipped": True, "peak_elbow_speed": 0.4, "peak_forearm_speed": 1.37}
    folder, policies = tmp_path / "session", [demonstrated_policy("demonstration-1")]
    with Session.begin(folder, settings, 5, policies) as session:
        practice = session.practice(ANY_ARM)
        for angle in turns:
            trial = practice.next_trial()
            session.append(practice.learn(trial, a_rollout(trial.id, angle), truth=truth))
        session.save_policy(practice.best.policy)
    return folder


def test_a_report_lists_every_rollout_with_its_angle_and_needs_no_other_file(
    folder: Path, html: str
) -> None:
    assert not re.search(r'(src|href)="(?!data:)', html)
    assert "<script" not in html
    assert f"Before learning: return {session.read(folder).records[0].ret:.3f}" in html
    rows = re.findall(r"<tr(?: class=\"good\")?><td.*?</tr>", html)
    assert len(rows) == len(TURNS)
    angles = [int(re.search(r">(\d+)° ", row).group(1)) for row in rows]
    # at t_f = .12 m over the pan the turning is not over yet
    assert angles == sorted(angles)
    assert angles[-1] == pytest.approx(180.0 * 0.93, abs=6.0)
    assert "Rollout 4 was the first that flipped the pancake" in html  # 100 degrees topple over


@pytest.mark.usefixtures("undrawn")
def test_every_picture_is_described_and_what_is_too_wide_says_that_it_scrolls(folder: Path) -> None:
    shown = session_report.ShownRollout("caught.", a_rollout("trial-0006", TURNS[5]), b"film")
    html = session_report.write(folder, shown).read_text()
    described = re.findall(r'<img alt="([^"]*)"', html)
    assert len(described) == html.count("<img") == 5 == len({*described})
    assert all(len(text.split()) > 3 for text in described)
    pictures = re.findall(r'<div class="wide picture" tabindex="0"><img', html)
    assert len(pictures) == 4 and "scroll sideways" in html


@pytest.mark.usefixtures("undrawn")
def test_page_and_terminal_say_the_same_of_the_retests(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = session.read(folder)
    records, task = found.records, found.task
    tests = [r.model_copy(update={"kind": "retest"}) if r.number > 3 else r for r in records]
    monkeypatch.setattr(Session, "records", tests)
    html = session_report.render(found, None)
    assert re.search(r"after it: mean return \d\.\d{3}, \d of 3 re-tests succeeded", html)
    label = "median error of the re-tests: rotation"
    shown = re.search(rf"<b>(\d+\.\d°)</b><span>{label}", html)
    assert f"{label} {shown.group(1)}" in terminal.summary(tests, task)


@pytest.mark.usefixtures("undrawn")
def test_terminal_and_report_say_why_a_session_failed(
    html: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "hy it failed" not in html
    other = session_of(tmp_path / "other", TURNS[:2] * 3)
    why = "t failed: PoWER chose 4 of 6 rollouts, because no plan on the measured errors"
    assert why in session_report.write(other).read_text()
    _print_summary(session.read(other))
    assert why in " ".join(capsys.readouterr().out.split())  # whatever the width of the terminal


def test_the_same_session_gives_the_same_report(folder: Path, html: str) -> None:
    assert session_report.write(folder).read_text() == html


@pytest.fixture
def reach(tmp_path: Path) -> Path:
    """A session of reaching, three rollouts around the obstacle, the first of them stopped."""
    part = np.linspace(0.0, 1.0, 201)  # of the movement
    way = np.stack([0.4 + 0 * part, -0.25 + 0.5 * part, 0.5 + 0 * part], axis=1)
    context = {"demonstrated": way.tolist(), "obstacle": [0.4, 0.0, 0.5, 0.09]}
    settings = preset("reach", budget=4, confirm=0, retests=0)
    policies = [demonstrated_policy("reach")]
    with Session.begin(tmp_path / "r", settings, 5, policies, context=context) as session:
        practice = session.practice(ANY_ARM)
        for aside in (0.0, 0.12, 0.15):
            trial = practice.next_trial()
            path = way + np.outer(np.sin(np.pi * part), [aside, 0.0, 0.0])
            duration = trial.policy.basis.duration
            t = np.append(part * duration, duration + practice.task.settle_time + 0.01)
            quat = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
            rollout = Rollout(EndEffectorPath(trial.id, t, np.vstack([path, path[-1:]]), quat))
            truth = {"touched": aside == 0.0}
            session.append(practice.learn(trial, rollout, truth=truth))
        session.save_policy(trial.policy)
    return tmp_path / "r"


@pytest.mark.usefixtures("undrawn")
def test_a_report_of_a_reach_speaks_of_the_obstacle_and_of_no_pancake(reach: Path) -> None:
    rollout = Rollout(
        EndEffectorPath("trial-0003", [0.0, 1.0], [[0.4, -0.2, 0.5]] * 2, [[0, 0, 0, 1.0]] * 2)
    )
    shown = session_report.ShownRollout("done", rollout)
    html = session_report.write(reach, shown, "no <OpenGL> here").read_text()
    assert "no &lt;OpenGL&gt; here" in html
    visible = re.sub(r"<style>.*?</style>", "", html, flags=re.DOTALL)
    for word in ("pancake", "flip", "Eq. 5", "caught"):
        assert word not in visible
    assert "Rollout 2 was the first that succeeded." in html
    said = "obstacle was touched: measurements and the simulator&#39;s ground truth agree in 3 of 3"
    assert said in html
    # The final policy, learning curve, errors, stiffness.
    assert html.count("data:image/svg+xml;base64,") == 4


def test_a_session_without_rollouts_has_a_report(tmp_path: Path) -> None:
    begun(tmp_path, preset("flip", "paper"), 0)
    assert "session.yaml" in session_report.write(tmp_path).read_text()
