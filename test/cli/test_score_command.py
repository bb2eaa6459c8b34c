# SPDX-License-Identifier: Apache-2.0
"""A recorded rollout gets its logged return again, and another return under another preset."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from bag_samples import LATCHED
from rclpy.serialization import serialize_message
from test_session_report import a_rollout
from toss_task import ANY_ARM, demonstrated_policy

from wam_power_interfaces.msg import Policy as PolicyMessage
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.cli import main
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.policy import Policy, to_json
from wam_power_ros.learning.rollout import EndEffectorPath, Rollout
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros.outcomes import Ended
from wam_power_ros.ros.pose_messages import path_message

ROOT = Path(__file__).resolve().parents[2]
START = 1_700_000_000_000_000_000


def recorded(
    path: Path, policy: Policy, rollout: Rollout, executed: str = "", fault: Fault | None = None
) -> Path:
    """Bag of a rollout, with paths of the one before it at its beginning, as latched topics are."""
    writer = BagWriter(path)
    writer.add("/policy", "wam_power_interfaces/msg/Policy", LATCHED)
    text = PolicyMessage(id=policy.id, text=to_json(policy))
    writer.write("/policy", START, serialize_message(text))
    paths = {"/rollout/end_effector": rollout.tool, "/rollout/pancake": rollout.body}
    before = a_rollout("trial-0099", 0.1)
    old = {"/rollout/end_effector": before.tool, "/rollout/pancake": before.body}
    for topic in paths:
        writer.add(topic, "nav_msgs/msg/Path", LATCHED)
        for stamp, found in ((START, old[topic]), (START + 10**9, paths[topic])):
            writer.write(topic, stamp, serialize_message(path_message(found, stamp, "base")))
    writer.add("/rollout/end", "wam_power_interfaces/msg/RolloutEnd", LATCHED)
    end = Ended(executed or policy.id, START + 10**9, fault)
    writer.write("/rollout/end", START + 10**9, serialize_message(end.message()))
    return writer.close({})


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A session of two rollouts, with their bags."""
    folder, settings = tmp_path / "s", preset("flip", "hindsight", budget=2, confirm=0, retests=0)
    with Session.begin(folder, settings, 5, [demonstrated_policy("demonstration-1")]) as begun:
        practice = begun.practice(ANY_ARM)
        for angle in (100.0, 175.0):
            trial = practice.next_trial()
            rollout = a_rollout(trial.id, math.radians(angle))
            bag = recorded(folder / "bags" / f"rollout_{trial.id}", trial.policy, rollout)
            begun.append(practice.learn(trial, rollout, bag=bag.name))
    return folder


def test_a_session_scored_again_has_its_logged_returns(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["score", str(session)]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[1:3]]
    assert len(rows) == 2
    for row in rows:
        assert row[2] == row[4].rstrip(",")


def test_another_preset_gives_its_own_return(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["score", str(session), "--preset", "paper"]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [line.split() for line in lines[1:3]]
    assert all(row[2] != row[4].rstrip(",") for row in rows)


def test_a_bag_is_scored_as_its_rollout_was_logged(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = session / "bags" / "rollout_trial-0002"
    assert main.main(["score", str(bag)]) == 0
    told = capsys.readouterr().out
    assert main.main(["score", str(session)]) == 0
    logged = capsys.readouterr().out.splitlines()[2].split()[2]
    assert f"return {logged}" in told and "rotation" in told


def test_a_bag_whose_paths_are_of_another_policy_has_no_return(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy, rollout = demonstrated_policy("trial-0002"), a_rollout("trial-0002", 3.0)
    bag = recorded(session / "bags" / "rollout_x", policy, rollout, executed="trial-0001")
    assert main.main(["score", str(bag)]) == 1
    assert "the paths do not belong to the policy trial-0002" in capsys.readouterr().out


@pytest.mark.parametrize(("samples", "told"), [(100, "joint 4 at 9.0 rad/s"), (186, "rotation")])
def test_a_fault_counts_only_if_it_ended_the_rollout(
    samples: int, told: str, session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy, whole = demonstrated_policy("trial-0002"), a_rollout("trial-0002", 3.0)
    path = (whole.tool.t, whole.tool.position, whole.tool.quat_xyzw)
    tool = EndEffectorPath("trial-0002", *(values[:samples] for values in path))
    fault = Fault(FaultKind.JOINT_SPEED, "joint 4 at 9.0 rad/s")
    bag = recorded(session / "bags/rollout_x", policy, Rollout(tool, whole.body), fault=fault)
    assert main.main(["score", str(bag)]) == 0
    assert told in capsys.readouterr().out


def test_a_bag_without_a_rollout_is_an_error_that_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = min((ROOT / "bags").glob("demo_*"))
    assert main.main(["score", str(bag)]) == 1
    assert "no rollout: the bag has no policy" in capsys.readouterr().out


def test_a_task_that_needs_data_of_its_own_session_names_them(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = session / "bags" / "rollout_trial-0002"
    assert main.main(["score", str(bag), "--task", "reach"]) == 1
    assert "task reach needs 'demonstrated' of a session of its own" in capsys.readouterr().out
