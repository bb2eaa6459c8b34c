# SPDX-License-Identifier: Apache-2.0
"""Between two rollouts: who puts the body back, and when a rollout may begin."""

from __future__ import annotations

import numpy as np
import pytest

from wam_power_ros.tasks.reset import MOVES_MAX, SETTLE_TIME, Action, BodyState, Move, Resetting

MOVE = Move(np.linspace(0.0, 1.0, 5), np.zeros((5, 7)))
FRAME = 33_000_000  # [ns]


class Course:
    """Answers of a task to the states of a body, which follow one another by a frame."""

    def __init__(self, action: Action = "person", rest_time: float = 0.0) -> None:
        self.missing, self.action, self.asked, self.now_ns = "on the floor", action, 0, 10**9
        self.resetting = Resetting(lambda state: self.missing, self._reset, rest_time)

    def _reset(self, state: BodyState | None) -> Action:
        self.asked += 1
        return self.action

    def go_on(self, seconds: float) -> None:
        """Let states come for a time."""
        for _ in range(round(seconds * 1e9 / FRAME)):
            self.now_ns += FRAME
            self.resetting.add(None, self.now_ns)


def test_a_body_must_have_been_ready_without_a_break_for_its_time_of_rest() -> None:
    course = Course("wait", rest_time=0.6)
    for _ in range(3):  # as a swinging ball is at its ends
        course.missing = ""
        course.go_on(0.4)
        assert not course.resetting.done
        course.missing = "it swings"
        course.go_on(0.2)
    course.missing = ""
    course.go_on(0.7)
    assert course.resetting.done and course.resetting.by == "none"


def test_states_of_before_the_reset_do_not_count_however_late_they_come() -> None:
    course = Course()
    course.missing, course.resetting.since_ns = "", course.now_ns + 10 * FRAME
    course.go_on(10 * FRAME * 1e-9)
    assert not course.resetting.done
    course.go_on(3 * FRAME * 1e-9)
    assert course.resetting.done


def test_a_person_counts_only_once_the_body_has_had_time_to_come_to_rest() -> None:
    course = Course("person")
    course.go_on(SETTLE_TIME - 0.5)
    assert course.resetting.by == "none" and not course.resetting.waits
    course.go_on(1.0)
    assert course.resetting.by == "person"
    course.missing = ""
    course.go_on(1.0)
    assert course.resetting.done and course.resetting.by == "person"


def test_the_arm_does_one_movement_at_a_time_and_states_meanwhile_are_not_judged() -> None:
    course = Course(MOVE)
    course.go_on(1.0)
    assert course.resetting.move is MOVE and course.resetting.by == "arm" and course.asked == 1
    course.missing = ""
    course.go_on(1.0)
    assert not course.resetting.done
    course.resetting.move = None
    course.go_on(1.0)
    assert course.resetting.done and course.resetting.by == "arm"


def test_an_arm_that_tries_in_vain_asks_for_a_person() -> None:
    course = Course(MOVE)
    for _ in range(MOVES_MAX):
        assert course.resetting.by != "person"
        course.go_on(0.1)
        course.resetting.move = None
    course.go_on(2.0 * SETTLE_TIME)
    assert course.resetting.by == "person" and course.asked == MOVES_MAX


def test_what_a_task_may_not_answer_is_refused_and_not_waited_for() -> None:
    with pytest.raises(ValueError, match="reset told 'nobody', must be a Move, 'wait' or 'pers"):
        Course("nobody").go_on(0.1)
