# SPDX-License-Identifier: Apache-2.0
"""Answers of services: programs read the code and the values, people the sentence."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wam_power_ros.ros.outcomes import Answer, Code, read

WORD = st.from_regex(r"[A-Za-z0-9_.-]{1,20}", fullmatch=True)
KEY = st.from_regex(r"[a-z_]{1,10}", fullmatch=True)


@given(
    st.sampled_from(sorted(Code)),
    st.text().map(str.strip),
    st.dictionaries(KEY, WORD, max_size=3),
)
def test_an_answer_survives_its_message(code: Code, text: str, values: dict[str, str]) -> None:
    answer = Answer(code, text, values)
    assert read(answer.success, str(answer)) == answer


@pytest.mark.parametrize("message", ["", "fault", "[fault", "[no_such_code] x", "arm [done] x"])
def test_an_answer_of_another_form_has_no_code_but_its_success(message: str) -> None:
    assert read(False, message) == Answer(Code.UNKNOWN, message)
    assert read(True, message) == Answer(Code.DONE, message)


def test_a_sentence_that_mentions_a_code_does_not_become_one() -> None:
    assert read(False, str(Answer(Code.REFUSED, "no [fault] is latched"))).code is Code.REFUSED


def test_a_value_with_a_space_is_refused() -> None:
    with pytest.raises(ValueError, match="policy='a b'"):
        str(Answer(Code.DONE, values={"policy": "a b"}))
