# SPDX-License-Identifier: Apache-2.0
"""The course of a session and its best policy, on a toss without physics."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from toss_task import (
    CANDIDATES,
    AnyArm,
    at_rest,
    demonstrated_policy,
    learner_state,
    next_trial,
    practice_of,
    record_of,
    toss,
)

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.policy import Policy, to_json
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.practice.best_policy import Best, choose_best, choose_demonstration
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session_log import Record, Trial, parse_line
from wam_power_ros.practice.settings import SessionSettings, preset
from wam_power_ros.tasks.task import Assessment, fault_assessment

Judge = Callable[[Trial], Assessment]
presets = pytest.mark.parametrize("name", ["paper", "hindsight"])


def started(name: str, seed: int = 0, **changes: object) -> Practice:
    return practice_of(CANDIDATES, preset("flip", name, **changes), seed)


def run(practice: Practice, judge: Judge | None = None, rollouts: int = 10_000) -> list[Record]:
    """Continue for a number of rollouts or to the end."""
    judge = judge or (lambda trial: toss(trial, practice.task.settings))
    records = []
    while len(records) < rollouts and (trial := practice.next_trial()) is not None:
        records.append(practice.learn_assessed(trial, judge(trial)))
    return records


def good(ret: float = 1.0, angle: float = 3.0) -> Assessment:
    flight = {"tossed": True, "seen": True, "angle": angle, "landing_error": [0.0, 0.0, 0.0]}
    flight["catch_pitch"] = 0.0
    return Assessment(ret, observation=flight, success=True)


def bad(ret: float = 0.5) -> Assessment:
    return Assessment(ret, success=False)


def image(practice: Practice) -> str:
    """State of a practice and its next trial, as text for comparison."""
    best, learner = practice.best, practice.learner
    return json.dumps(
        [
            next_trial(practice),
            None if best is None else [to_json(best.policy), best.why],
            None if learner is None else learner_state(learner),
            practice.stopped,
            practice.paused,
            practice.used,
        ]
    )


@presets
def test_every_demonstration_is_reproduced_once_and_one_is_chosen(name: str) -> None:
    practice = started(name)
    first = run(practice, rollouts=2)
    assert [record.kind for record in first] == ["reproduction"] * 2
    assert [record.demonstration for record in first] == ["flick-1", "flick-2"]
    assert not np.any([record.z for record in first])
    assert first[0].note == "" and first[1].note == practice.choice
    assert practice.choice.startswith("learns from flick-")
    assert len(practice.learner._rollouts) == 1  # the reproduction, as z = 0
    assert {record.demonstration for record in run(practice)} == {
        practice.parametrization.policy0.id
    }


@pytest.mark.parametrize("name", ["paper", "hindsight"])
@pytest.mark.requirement("S-128")
def test_replaying_the_log_rebuilds_the_practice_at_every_boundary(name: str) -> None:
    def judge(trial: Trial) -> Assessment:
        if trial.number % 7 == 3 or trial.number in (15, 16, 17):
            return Assessment(None, why="lost")
        if trial.number % 11 == 5:
            return Assessment(0.0, why="over-speed")
        return toss(trial, preset("flip", name).task_settings)

    practice = started(name, 1, budget=24, retests=3)
    images = [image(practice)]
    while (trial := practice.next_trial()) is not None:
        if trial.number in (6, 12):
            practice.refuse(trial, "stopped by a person")
            images.append(image(practice))
            practice.pause(False, "a person lets it go on")
        elif trial.number == 9 and not practice.paused:
            practice.pause(True, "stopped by a person")
        else:
            practice.learn_assessed(trial, judge(trial))
        images.append(image(practice))
    assert practice.finished and len(practice.records) > 27
    log = [parse_line(line.to_json()) for line in practice.log]
    for cut, expected in enumerate(images):
        assert image(practice_of(CANDIDATES, practice.settings, 1, log[:cut])) == expected


def test_a_session_is_a_function_of_candidates_settings_and_seed() -> None:
    a, b, other = (started("hindsight", seed) for seed in (1, 1, 2))
    for practice in (a, other):
        run(practice)
    while (trial := b.next_trial()) is not None:  # with other company
        b.learn_assessed(
            trial,
            toss(trial, b.task.settings),
            bag="x",
            truth={"caught": True},
            clock={"took": 2.0},
        )
    same = {"bag", "truth", "clock"}
    assert [r.model_dump(exclude=same) for r in a.records] == [
        r.model_dump(exclude=same) for r in b.records
    ]
    assert [r.z for r in a.records] != [r.z for r in other.records]


def test_a_rollout_that_says_nothing_is_tried_again_and_leaves_the_course_of_learning() -> None:
    settings = preset("flip", "hindsight", budget=20, confirm=0, retests=0, learner={"decay": 0.97})
    undisturbed = practice_of(CANDIDATES, settings, 3)
    run(undisturbed, lambda trial: toss(trial, settings.task_settings, noise=0.0))
    disturbed = practice_of(CANDIDATES, settings, 3)
    calls = iter(range(10_000))

    def judge(trial: Trial) -> Assessment:
        if next(calls) % 4 == 1:
            return Assessment(None, why="the pancake was never seen")
        return toss(trial, settings.task_settings, noise=0.0)

    run(disturbed, judge)
    lost = [record for record in disturbed.records if record.ret is None]
    assert len(lost) > 5
    assert not any(record.learnt for record in lost)
    assert all("the pancake was never seen" in record.note for record in lost)
    assert [(r.kind, r.z, r.ret) for r in disturbed.records if r.ret is not None] == [
        (r.kind, r.z, r.ret) for r in undisturbed.records
    ]
    assert disturbed.used == undisturbed.used == 20


def test_what_never_says_anything_is_dropped_after_some_attempts() -> None:
    practice = started("hindsight", attempts=3)
    run(practice, rollouts=3)
    hopeless = practice.next_trial()
    records = run(practice, lambda trial: Assessment(None, why="lost"), rollouts=3)
    assert [record.attempt for record in records] == [1, 2, 3]
    assert [record.z for record in records] == [hopeless.z.tolist()] * 3
    assert ["dropped" in record.note for record in records] == [False, False, True]
    assert len({record.id for record in records}) == 3
    assert practice.unusable_in_a_row == 3
    assert practice.next_trial().z.tolist() != hopeless.z.tolist()
    assert practice.next_trial().attempt == 1


def test_a_session_in_which_nothing_is_ever_seen_ends() -> None:
    practice = started("hindsight")
    records = run(practice, lambda trial: Assessment(None, why="lost"))
    assert len(records) == 6 and practice.finished and practice.best is None
    assert practice.stopped.startswith("no demonstration could be reproduced (flick-1: lost;")

    practice = started("hindsight", budget=20)
    run(practice, rollouts=4)
    records = run(practice, lambda trial: Assessment(None, why="lost"))
    assert practice.finished and len(practice.records) < 3 * 20 + 3 * 10 + 3
    assert "only 4 were usable" in practice.stopped


def test_the_mean_runs_every_fifth_time_and_counts() -> None:
    practice = started("hindsight", budget=32)
    records = []
    while not practice.stopped:
        mean = None if practice.learner is None else practice.learner.mean.tolist()
        trial = practice.next_trial()
        records.append(practice.learn_assessed(trial, bad(0.1 + 0.01 * (trial.number % 5))))
        assert (trial.z.tolist() == mean) == (trial.kind == "mean")
    kinds = [record.kind for record in records if record.kind in ("explore", "mean")]
    assert kinds == (["explore"] * 4 + ["mean"]) * 6
    means = [record for record in records if record.kind == "mean"]
    assert all(record.learnt for record in means)


def test_a_mean_that_succeeds_is_run_again_unchanged_until_it_fails_or_is_confirmed() -> None:
    practice = started("hindsight", confirm=4, retests=2)
    run(practice, lambda trial: bad(), rollouts=6)
    streak = run(practice, lambda trial: good(), rollouts=3)
    assert [record.kind for record in streak] == ["mean"] * 3
    assert len({tuple(record.z) for record in streak}) == 1
    assert streak[-1].note == "3 of 3 succeeded"
    (failed,) = run(practice, lambda trial: bad(), rollouts=1)
    assert failed.z == streak[0].z and failed.note == "3 of 4 succeeded"
    assert practice.next_trial().kind == "explore"

    run(practice, lambda trial: bad() if trial.kind == "explore" else good())
    assert "confirmed: 4 of 4 succeeded: at least 47% will (95% confidence)" in practice.stopped
    assert practice.confirmed == 4
    *_, confirmed, again, last = practice.records
    assert (confirmed.kind, again.kind, last.kind) == ("mean", "retest", "retest")
    assert confirmed.z == again.z == last.z
    assert practice.used == len(practice.records) - 2


@presets
def test_the_budget_ends_learning_and_the_answer_is_retested_unlearnt(name: str) -> None:
    practice = started(name, budget=15, retests=4)
    records = run(practice, lambda trial: bad(0.3 + 0.01 * trial.number))
    assert practice.stopped == "budget of 15 rollouts used" and practice.finished
    assert [record.kind for record in records[15:]] == ["retest"] * 4
    assert not any(record.learnt for record in records[15:])
    assert len(practice.learner._rollouts) == 14  # one reproduction was of the other demonstration
    assert records[15].z == practice.parametrization.clip(practice.learner.mean).tolist()
    assert practice.best.policy.id == "trial-0016" and len(practice.best.returns) == 4


def test_time_ends_learning_at_the_next_rollout_also_after_a_resumption() -> None:
    practice = started("hindsight", minutes=2, retests=2)
    lines: list[str] = []
    while (trial := practice.next_trial()) is not None:
        record = practice.learn_assessed(trial, bad(), clock={"took": 25.0})
        lines.append(record.to_json())
        practice = practice_of(CANDIDATES, practice.settings, 0, [parse_line(x) for x in lines])
    kinds = [parse_line(line).kind for line in lines]
    assert kinds.index("retest") == 5 and len(kinds) == 7  # after 125 s
    assert practice.stopped == "budget of 2 min used"


@pytest.mark.parametrize("seed", range(2))
def test_sessions_with_our_settings_learn_a_caught_flip(seed: int) -> None:
    practice = started("hindsight", seed)
    run(practice)
    retests = [record.success for record in practice.records if record.kind == "retest"]
    assert len(retests) == 10 and sum(retests) >= 8


@pytest.mark.parametrize("seed", range(2))
def test_sessions_with_the_papers_settings_raise_the_return(seed: int) -> None:
    practice = started("paper", seed, confirm=0, budget=80)
    returns = [record.ret for record in run(practice) if record.kind == "explore"]
    assert np.mean(returns[-10:]) > np.mean(returns[:10]) + 0.05


def reproduced(id: str, ret: float | None, fault: str = "") -> Record:
    practice = practice_of([demonstrated_policy(id)], preset("flip", "hindsight"), 0)
    assessment = Assessment(ret, why="seen or not")
    return practice.learn_assessed(practice.next_trial(), assessment, fault=fault)


def test_the_demonstration_is_chosen_by_how_it_reproduces() -> None:
    weak, good, nice = (reproduced(f"d{k}", ret) for k, ret in enumerate((0.5, 0.9, 0.4)))
    blind, faulty = reproduced("blind", None), reproduced("faulty", 1.0, "tool at 9 m/s")
    chosen, why = choose_demonstration([weak, good, nice, blind, faulty])
    assert chosen is good and why == "highest return of 5 reproductions, 0.900"
    assert choose_demonstration([blind, weak])[0] is weak
    chosen, why = choose_demonstration([blind])
    assert chosen is None and "(blind: seen or not)" in why


def test_a_torque_that_stays_unexplained_when_a_policy_is_run_again_is_the_policys_doing() -> None:
    practice = started("hindsight")
    run(practice, rollouts=3)
    hopeless, usable = practice.next_trial(), practice.used

    def learn(kind: FaultKind) -> Record:
        trial = practice.next_trial()
        pan, pancake = at_rest(trial.id, 0.5, np.arange(0.01, 0.5, 1 / 30))
        return practice.learn(trial, Rollout(pan, pancake, Fault(kind, "38 N m at joint 2")))

    lost, first = learn(FaultKind.STATES_LOST), learn(FaultKind.STATES_LOST)
    assert (lost.ret, first.ret) == (None, None)  # says nothing about the policy, however often
    third = learn(FaultKind.EXTERNAL_TORQUE)
    assert third.ret == 0.0 and third.learnt and third.z == hopeless.z.tolist()
    assert "again" in third.why and practice.used == usable + 1
    practice.learn_assessed(practice.next_trial(), Assessment(None, why="not seen"))
    first, second = learn(FaultKind.EXTERNAL_TORQUE), learn(FaultKind.EXTERNAL_TORQUE)
    assert first.ret is None and not first.learnt and "tried again" in first.note
    assert second.ret == 0.0 and second.learnt and second.z == first.z


@pytest.mark.parametrize("told", [None, 0.5])
def test_what_a_task_assesses_must_be_an_assessment(
    told: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    practice = started("paper")
    trial = practice.next_trial()
    monkeypatch.setattr(practice.task, "assess", lambda policy, rollout: told)
    with pytest.raises(TypeError, match=f"assess of task 'flip' told {told}: no Assessment"):
        practice.learn(trial, Rollout(*at_rest(trial.id, 1.86, np.arange(0.01, 1.85, 1 / 30))))
    assert not practice.records and practice.next_trial() is trial


def test_paths_and_trials_that_are_not_due_are_refused_without_a_trace() -> None:
    practice = started("hindsight")
    trial = practice.next_trial()
    pan, pancake = at_rest(trial.id, 1.86, np.arange(0.0, 1.85, 1 / 30))
    with pytest.raises(ValueError, match="body path of rollout 'other'"):
        practice.learn(trial, Rollout(pan, replace(pancake, id="other")))
    with pytest.raises(ValueError, match="paths are of rollout 'other'"):
        practice.learn(trial, Rollout(replace(pan, id="other"), replace(pancake, id="other")))
    with pytest.raises(ValueError, match="'trial-0009' is not the one that is due"):
        practice.learn_assessed(replace(trial, id="trial-0009"), bad())
    with pytest.raises(ValueError, match="ret"):
        practice.learn_assessed(trial, bad(math.nan))
    assert practice.next_trial() is trial and practice.records == ()


def test_records_of_another_session_are_refused() -> None:
    practice = started("hindsight", 1)
    records = run(practice, rollouts=10)
    settings = practice.settings
    mean, short = preset("flip", "hindsight", mean_every=3), {"budget": 6, "retests": 0}
    for candidates, other, seed, taken, reason in [
        (CANDIDATES, settings, 2, records, "record 1: the generator is not this session's"),
        (CANDIDATES[::-1], settings, 1, records, "record 1: demonstration is 'flick-1'"),
        (CANDIDATES, preset("flip", "paper"), 1, records, "record 1: z is not"),
        (CANDIDATES, mean, 1, records, "record 5: kind is 'explore'"),
        (CANDIDATES, settings, 1, records[1:], "record 1: number is 2"),
        (CANDIDATES, preset("flip", "hindsight", **short), 1, records, "record 7 .* after"),
    ]:
        with pytest.raises(ValueError, match=reason):
            practice_of(candidates, other, seed, taken)


def test_settings_and_candidates_that_cannot_be_are_refused() -> None:
    for changes, why in (
        ({"learner": {"name": "pwoer"}}, "learner 'pwoer' is not one of .*power"),
        ({"budget": 0}, "practice.budget = 0: .*"),
        ({"nonsense": 3}, "task_settings.nonsense = 3: Extra"),
        ({"return_noise": math.nan}, "practice.return_noise = nan: .*finite"),
    ):
        with pytest.raises(ValueError, match=rf"invalid settings of task 'flip': {why}") as no:
            preset("flip", "hindsight", **changes)
        assert "\n" not in str(no.value) and len(str(no.value)) < 400
    with pytest.raises(ValueError, match="'quick' of 'flip' is not one of model_based, "):
        preset("flip", "quick")
    with pytest.raises(ValueError, match=r"gain 0.7 needs parameters .* 'planar'"):
        preset("flip", "hindsight", variant="full")
    with pytest.raises(ValueError, match="a success needs"):
        preset("flip", "paper", success_return=0.0)
    with pytest.raises(ValueError, match="at least one demonstration"):
        practice_of([], preset("flip", "hindsight"), 0)
    with pytest.raises(ValueError, match="different ids"):
        practice_of([CANDIDATES[0]] * 2, preset("flip", "hindsight"), 0)
    with pytest.raises(ValueError, match="budget of 2 rollouts leaves none"):
        practice_of(CANDIDATES, preset("flip", "hindsight", budget=2), 0)


def test_a_preset_changes_only_what_is_named() -> None:
    changed = preset("flip", "hindsight", learner={"sigma": 3}, budget=10)
    assert changed.learner_settings.sigma == 3
    assert changed.learner_settings.weights == "sharpened"
    assert changed.practice.budget == 10
    noisy = preset("flip", "hindsight", noise={"wrist_amplitude": 0.1})
    assert noisy.task_settings.noise.wrist_amplitude == 0.1
    other = preset("flip", "hindsight", learner={"name": "cma_es", "population": 8})
    assert other.learner == "cma_es" and other.learner_settings.population == 8
    for settings in (changed, other):
        assert SessionSettings.model_validate(settings.model_dump(mode="json")) == settings


def test_a_record_is_one_line_of_strict_json_and_comes_back_exactly() -> None:
    practice = started("hindsight")
    run(practice, rollouts=4)
    trial = practice.next_trial()
    record = practice.learn_assessed(
        trial,
        Assessment(0.1 + 0.2, {"a": 1 / 3, "b": math.nan}, None, False, "x\ny"),
        truth={"angle": np.float64(1.5), "n": np.arange(2), "ok": np.bool_(True)},
        clock={"took": 1.25},
    )
    line = record.to_json()
    assert "\n" not in line and json.loads(line)["schema"] == "wam_power_ros/rollout/3"
    again = parse_line(line)
    assert again == record and again.to_json() == line
    assert again.terms["b"] is None
    assert again.truth == {"angle": 1.5, "n": [0, 1], "ok": True}
    old = json.loads(line)
    del old["refused"]  # of a session before anybody could refuse
    assert parse_line(json.dumps(old)) == record
    for damage in (
        line[:-20],
        line.replace('"learnt": true', '"learnt": false'),
        line.replace("rollout/3", "rollout/2"),
    ):
        assert damage != line
        with pytest.raises(ValueError):
            parse_line(damage)


class SlowModel(AnyArm):
    """Model of an arm that records the unpredicted limit stops at each simulation."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[int] = []

    def infeasible(self, policy: Policy, limit_stops: int = 0) -> Fault | None:
        """See `practice.ArmModel`."""
        self.asked.append(limit_stops)
        return None


@pytest.mark.requirement("S-31")
@pytest.mark.parametrize(
    ("kind", "counted"), [(FaultKind.JOINT_SPEED, 3), (FaultKind.STATES_LOST, 0)]
)
def test_each_rollout_that_the_arm_itself_was_too_fast_in_leaves_less_of_the_limits(
    kind: FaultKind, counted: int
) -> None:
    arm = SlowModel()
    settings = preset("flip", "hindsight", budget=20, retests=0)
    practice = practice_of(CANDIDATES[:1], settings, 3, arm=arm)
    for number in range(12):
        if number == 8:
            arm.asked.clear()
        trial = practice.next_trial()
        fault = fault_assessment(Fault(kind, "why"))
        judged = fault if 2 <= number < 5 else toss(trial, practice.task.settings)
        text = fault.why if judged is fault else ""
        practice.learn_assessed(trial, judged, fault=text)
    assert set(arm.asked) == {counted}


def parity(policy: Policy) -> str:
    return "odd" if int(policy.attractors[0, 0] * 1e6) % 2 else ""


@pytest.mark.requirement("S-31")
def test_when_everything_is_infeasible_only_what_ran_before_is_run_again() -> None:
    practice = practice_of(
        CANDIDATES,
        preset("flip", "hindsight", budget=8, retests=2),
        3,
        arm=AnyArm(lambda policy: "no"),
    )
    records = run(practice)
    assert len(records) == 10
    after = [record for record in records if record.kind != "reproduction"]
    ran = {tuple(record.z) for record in records if record.kind == "reproduction"}
    assert after and {tuple(record.z) for record in after} <= ran
    assert {record.rejections for record in after if record.kind == "explore"} == {25}


@pytest.mark.requirement("S-31")
@pytest.mark.parametrize("on_model", ["", "no"])
def test_a_policy_that_a_limit_of_the_arm_has_ended_is_not_run_again(on_model: str) -> None:
    settings = preset("flip", "hindsight", budget=30, retests=0, mean_every=2, confirm=0)
    said = [""]
    practice = practice_of(CANDIDATES[:1], settings, 3, arm=AnyArm(lambda policy: said[0]))
    run(practice, rollouts=8)
    said[0] = on_model
    ended: list[list[float]] = []
    fault = fault_assessment(Fault(FaultKind.JOINT_SPEED, "too fast"))
    while (trial := practice.next_trial()) is not None:
        assert trial.z.tolist() not in ended
        if len(ended) < 5 and trial.number % 2:  # as at a limit: it may have run before
            ended.append(trial.z.tolist())
            practice.learn_assessed(trial, fault, fault=fault.why)
        else:
            practice.learn_assessed(trial, toss(trial, practice.task.settings))
    assert len(ended) == 5


@pytest.mark.requirement("S-31")
def test_what_is_infeasible_is_shrunk_to_what_ran_and_in_a_replay_not_simulated_again() -> None:
    def never(policy: Policy) -> str:
        raise AssertionError(f"asked about {policy.id}")

    settings = preset("flip", "hindsight", budget=24, retests=1, mean_every=4, confirm=0)
    shrunk = 0
    for seed in range(2):
        practice = practice_of(CANDIDATES[:1], settings, seed, arm=AnyArm(parity))
        while (trial := practice.next_trial()) is not None:
            assert trial.kind == "reproduction" or not parity(trial.policy)
            shrunk += trial.kind == "mean" and trial.rejections > 0
            practice.learn_assessed(trial, toss(trial, practice.task.settings))
        assert any(record.rejections for record in practice.records if record.kind == "explore")
        again = practice_of(CANDIDATES[:1], settings, seed, practice.records, AnyArm(never))
        assert again.records == practice.records and again.next_trial() is None
    assert shrunk > 0


def test_a_correction_that_the_arm_cannot_follow_is_made_in_part_and_keeps_no_other_back() -> None:
    first = CANDIDATES[0].attractors

    def infeasible(policy: Policy) -> str:
        slow = np.allclose(policy.attractors[1], first[1])  # moved by the amplitude alone
        return "" if slow and policy.attractors[-1, 0] < first[-1, 0] + 0.02 else "too far"

    practice = practice_of(
        CANDIDATES[:1], preset("flip", "hindsight", budget=2, retests=0), 3, arm=AnyArm(infeasible)
    )
    settings = practice.task.settings
    flight = {"tossed": True, "seen": True, "angle": 2.0, "landing_error": [0.1, 0.0, 0.0]}
    flight["catch_pitch"] = 0.0
    record = practice.learn_assessed(practice.next_trial(), Assessment(0.5, observation=flight))
    amplitude, wrist_amplitude, shift, tempo = np.array(record.z_corrected)[-4:]
    assert amplitude == 0.0 < tempo
    assert 0.0 < wrist_amplitude <= 0.3 / settings.noise.wrist_amplitude
    # a quarter of 0.7 * 0.1 m: the whole and the half are infeasible
    assert shift == pytest.approx(0.25 * settings.gain * 0.1 / settings.noise.catch_shift)


def stopped(practice: Practice) -> Record:
    """A person stops the rollout of the next trial."""
    return practice.refuse(practice.next_trial(), "stopped by a person")


@pytest.mark.requirement("S-128")
@presets
def test_a_policy_that_a_person_stops_counts_as_return_0_and_is_not_run_again(name: str) -> None:
    practice = started(name, budget=30, retests=2)
    run(practice, rollouts=4)
    before = len(practice.learner._rollouts)
    record = stopped(practice)
    assert (record.ret, record.learnt, record.refused) == (0.0, True, True)
    assert len(practice.learner._rollouts) == before + 1
    assert practice.paused == "stopped by a person; Continue goes on"
    practice.pause(False, "a person lets it go on")
    assert practice.paused == ""
    assert practice.next_trial().attempt == 1
    later = run(practice)
    assert later and record.z not in [other.z for other in later]


@pytest.mark.requirement("S-128")
def test_a_mean_that_a_person_stopped_is_neither_run_again_nor_the_answer() -> None:
    settings = preset("flip", "hindsight", budget=8, retests=1, learner={"sigma": 1})
    practice = practice_of(CANDIDATES[:1], settings, 0)
    run(practice, lambda trial: good(angle=math.pi), rollouts=1)  # nothing to correct
    assert practice.next_trial().kind == "mean"  # of the reproduction, whose policy it is
    refused = stopped(practice)
    assert practice.best is None  # no other policy has run without exploration
    later = run(practice, lambda trial: bad(0.1))  # so that the mean stays where it is
    assert {record.kind for record in later} >= {"explore", "retest"}
    assert refused.z not in [record.z for record in later]
    reproduced = practice.parametrization.policy(np.array(refused.z), "any")[0]
    assert practice.best.policy.attractors.tolist() != reproduced.attractors.tolist()


@pytest.mark.requirement("S-128")
def test_a_session_ends_when_a_person_has_refused_the_only_policy_that_is_feasible() -> None:
    known = CANDIDATES[0].attractors
    narrow = AnyArm(lambda policy: "" if np.array_equal(policy.attractors, known) else "too fast")
    practice = practice_of(CANDIDATES[:1], preset("flip", "hindsight"), 0, arm=narrow)
    run(practice, lambda trial: good(angle=math.pi), rollouts=1)  # nothing to correct
    stopped(practice)
    assert practice.next_trial() is None and practice.finished
    assert practice.stopped == "no policy is left that no person has refused"


@pytest.mark.requirement("S-128")
def test_a_retest_that_a_person_stops_has_failed_and_is_the_last() -> None:
    practice = started("hindsight", budget=6, retests=5)
    while practice.next_trial().kind != "retest":
        run(practice, lambda trial: bad(), rollouts=1)
    run(practice, lambda trial: good(), rollouts=1)
    record = stopped(practice)
    assert record.kind == "retest" and not record.success and not record.learnt
    assert practice.finished and practice.next_trial() is None
    assert [r.success for r in practice.records if r.kind == "retest"] == [True, False]


@pytest.mark.requirement("S-128")
def test_a_session_whose_demonstrations_a_person_stopped_ends() -> None:
    practice = started("hindsight")
    stopped(practice)
    run(practice, lambda trial: bad(0.0), rollouts=1)
    assert practice.choice.startswith("learns from flick-2")  # not the one that was refused
    alone = practice_of(CANDIDATES[:1], preset("flip"), 0)
    stopped(alone)
    assert alone.finished and "stopped by a person" in alone.stopped


PARAMETERS = preset("flip").make_task({}).parametrization(demonstrated_policy("flick-1"))

PLACES = [np.full(PARAMETERS.size, place).tolist() for place in (0.0, 0.25, 0.5)]


def record(number: int, **changes: Any) -> Record:  # noqa: ANN401
    return record_of(number, **{"z": PLACES[1], **changes})


def best(records: list[Record], answer: np.ndarray | None = None) -> Best | None:
    return choose_best(records, {"one": PARAMETERS}, "one", answer, "it has ended", 0.2)


def several(*runs: tuple[list[float], list[float]]) -> list[Record]:
    """Records of the means at some coordinates, with their returns."""
    each = [(z, ret) for z, returns in runs for ret in returns]
    return [record(number, z=z, ret=ret) for number, (z, ret) in enumerate(each, start=1)]


def test_more_runs_count_more_than_one_that_was_lucky_and_the_later_policy_wins_a_tie() -> None:
    often = best(several((PLACES[0], [0.68]), (PLACES[1], [0.6] * 4)))
    assert often.policy.id == "trial-0002" and often.returns == (0.6,) * 4 and often.successes == 4
    assert best(several((PLACES[0], [0.98]), (PLACES[1], [0.6] * 4))).policy.id == "trial-0001"
    assert best(several((PLACES[0], [0.6]), (PLACES[1], [0.6]))).policy.id == "trial-0002"


def test_explorations_other_demonstrations_and_refused_policies_are_never_the_best() -> None:
    others = [
        record(1, kind="explore", ret=1.0),
        record(2, demonstration="two", ret=1.0),
        record(3, ret=None, success=False),
    ]
    assert best(others) is None
    refused = record(4, kind="explore", z=PLACES[2], ret=0.0, fault="stopped", refused=True)
    tried = [*others, record(4, z=PLACES[2], ret=0.9), record(5, ret=0.3)]
    assert best(tried).policy.id == "trial-0004"
    assert best([*tried, refused]).policy.id == "trial-0005"
    assert best([*tried[:-1], refused]) is None
