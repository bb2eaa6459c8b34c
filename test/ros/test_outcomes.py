# SPDX-License-Identifier: Apache-2.0
"""Outcomes of requests and ends of rollouts: programs read the code, people the sentence."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from wam_power_interfaces.msg import Outcome
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.ros import outcomes
from wam_power_ros.ros.outcomes import Answer, Code, Ended

CODES = sorted(set(Code) - {Code.UNKNOWN})


@given(
    st.sampled_from(CODES), st.text(), st.text(max_size=20), st.floats(0.0, 1.0) | st.just(math.nan)
)
def test_an_outcome_survives_its_message(code: Code, text: str, stop: str, speed: float) -> None:
    answer = Answer(code, text, stop, speed)
    assert repr(outcomes.read(outcomes.message(answer))) == repr(answer)  # NaN is not itself


def test_every_constant_of_the_message_is_a_code_and_a_later_one_is_unknown() -> None:
    names = [name for name in vars(type(Outcome)) if name[0].isupper()]
    numbers = {name: getattr(Outcome, name) for name in names}
    read = {name: outcomes.read(Outcome(code=number)).code for name, number in numbers.items()}
    assert read == {code.name: code for code in CODES}
    assert len(set(numbers.values())) == len(CODES)
    later = Outcome(code=max(numbers.values()) + 1, text="of a later version")
    assert outcomes.read(later).code is Code.UNKNOWN
    assert outcomes.read(Outcome()).code is Code.DONE


def test_the_end_of_a_rollout_keeps_its_id_start_fault_region_and_stop() -> None:
    for fault, stop in ((None, "17"), (Fault(FaultKind.TOOL_SPEED, "2.1 m/s"), "")):
        end = Ended("trial-0001", 1_795_640_661_883_907_267, fault, "the obstacle", stop)
        assert Ended.read(end.message()) == end
