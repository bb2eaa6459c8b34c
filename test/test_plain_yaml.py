# SPDX-License-Identifier: Apache-2.0
"""YAML of bags and sessions: plain data is returned, anything else is refused, naming the file."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_ros import plain_yaml

TEXT = st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), max_size=10)
DATA = st.recursive(
    TEXT | st.integers(-(2**128), 2**128) | st.booleans() | st.none(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=12,
)


@settings(max_examples=40)
@given(DATA)
def test_plain_data_comes_back(data: object) -> None:
    assert plain_yaml.parse(yaml.safe_dump(data).encode(), "x") == data


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"a: &x [1]\nb: *x", r"line 2: references \(\*name\) are refused"),
        (b"[" * 30 + b"]" * 30, "nested deeper"),
        (b"a: !!python/object/apply:os.getcwd []", "not plain YAML"),
        (b"\xff\xfe\x00", "not plain YAML"),
    ],
)
def test_anything_else_is_refused_with_its_origin(text: bytes, says: str) -> None:
    with pytest.raises(ValueError, match=f"the record.*{says}"):
        plain_yaml.parse(text, "the record")


@pytest.mark.requirement("S-18")
@pytest.mark.parametrize(
    "number",
    [
        "1" + 400 * "0",  # no float is that large
        str(2**128 + 1),
        "0x" + 5000 * "f",
        ":".join(300 * ["1"]) + ".5",  # sexagesimal
        "1.0e+400",
        ".nan",
    ],
)
def test_a_number_that_no_parameter_can_have_is_refused_by_name(number: str) -> None:
    for text in (f"oven: {{heat: {number}}}", f"oven:\n  heat:\n  - 1\n  - {number}"):
        with pytest.raises(ValueError, match=r"oven: heat.* no finite number of") as no:
            plain_yaml.parse(text.encode(), "the record")
        assert len(str(no.value)) < 100
    with pytest.raises(ValueError, match="a key of the record"):
        plain_yaml.parse(f"? {number}\n: 1".encode(), "the record")


def test_a_file_that_is_too_large_is_not_even_read(tmp_path: Path) -> None:
    file = tmp_path / "metadata.yaml"
    file.write_bytes(b"a" * (plain_yaml.SIZE_MAX + 1))
    with pytest.raises(ValueError, match=r"metadata\.yaml has 1000001 bytes"):
        plain_yaml.read(file)
    file.write_text("a: 1")
    assert plain_yaml.read(file) == {"a": 1}
