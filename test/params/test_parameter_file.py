# SPDX-License-Identifier: Apache-2.0
"""Parameter files: decimal numbers, unique keys, errors that name the line."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from conftest import ROOT

from wam_power_ros.params import parameter_file


def written(folder: Path, text: str) -> Path:
    file = folder / "oven.yaml"
    file.write_text("oven:\n  ros__parameters:\n" + text)
    return file


def test_the_shipped_files_read_the_same_as_plain_yaml() -> None:
    for file in (ROOT / "config").glob("*.yaml"):
        nodes = yaml.safe_load(file.read_text())
        assert parameter_file.read(file) == {
            node: section["ros__parameters"] for node, section in nodes.items()
        }


@pytest.mark.requirement("S-18")
@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1:30", "1:30"),  # plain YAML: 90
        ("010", "010"),  # 8
        ("1_000", "1_000"),  # 1000
        ("0x10", "0x10"),
        ("2026-01-01", "2026-01-01"),  # a date
        (".inf", ".inf"),
        ("0.3", 0.3),
        ("-.5e-3", -0.0005),
        ("1e3", 1000.0),  # as ROS reads it; plain YAML: text
        ("-12", -12),
        ("true", True),
        ("", None),
    ],
)
def test_a_number_is_decimal_and_all_else_is_text(tmp_path: Path, text: str, value: object) -> None:
    found = parameter_file.read(written(tmp_path, f"    heat: {text}\n"))["oven"]["heat"]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.requirement("S-18")
@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("    heat: 1.0\n    rings: 2\n    heat: 3.0\n", "heat is given twice, in line 3 and.* 5"),
        ("    heat: 1.0\noven:\n  ros__parameters: {}\n", "oven is given twice, in line 1 and.* 4"),
        ("    heat: &warm 1.0\n    rings: *warm\n", r"line 4: references \(\*name\) are refused"),
        ("    heat: [1.0\n", "oven.yaml is not plain YAML"),
        ("    - heat\n", "oven.yaml"),
    ],
)
def test_ambiguous_contents_are_refused_with_their_line(
    tmp_path: Path, text: str, why: str
) -> None:
    file = written(tmp_path, text)
    with pytest.raises(ValueError, match=why) as refused:
        parameter_file.read(file)
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_parameter_files_are_found_among_the_arguments_of_a_process() -> None:
    arguments = "node --ros-args --params-file a.yaml -r a:=b --params-file b".split()
    assert parameter_file.given(arguments) == [Path("a.yaml"), Path("b")]
    assert parameter_file.given(["node", "--params-file"]) == []


def test_a_list_that_a_launch_file_has_written_is_read(tmp_path: Path) -> None:
    # what launch_ros writes for `parameters=[{"demonstrations": ["a", "b"]}]`
    text = "/**:\n  ros__parameters:\n    demonstrations: !!python/tuple\n    - a\n    - b\n"
    (tmp_path / "launch_params").write_text(text)
    found = parameter_file.read(tmp_path / "launch_params", parameter_file.PlainLoader)
    assert found == {"/**": {"demonstrations": ["a", "b"]}}
