# SPDX-License-Identifier: Apache-2.0
"""The README names what there is, and what it names is there."""

import importlib
import re
from pathlib import Path

import pytest

from wam_power_ros import interface
from wam_power_ros.cli import NODES

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
NAMES = sorted(
    value
    for name, value in vars(interface).items()
    if name.isupper() and isinstance(value, str) and value.startswith("/")
)
PAPER = re.search(r"\| paper \| code \| test \|\n(.*?)\n\n", README, re.DOTALL)


def rows(table: str) -> list[list[str]]:
    lines = [line for line in table.splitlines() if not re.fullmatch(r"[|\-]+", line)]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def test_there_are_topics_and_a_paper_table_to_check() -> None:
    assert len(NAMES) > 15
    assert PAPER is not None and len(rows(PAPER.group(1))) > 5


@pytest.mark.parametrize("name", NAMES)
def test_every_topic_and_service_is_in_the_readme(name: str) -> None:
    assert f"`{name}`" in README


@pytest.mark.parametrize("node", NODES)
def test_every_node_has_a_row_in_the_readme(node: str) -> None:
    assert f"\n| `{node}` |" in README


@pytest.mark.parametrize("row", rows(PAPER.group(1)) if PAPER else [], ids=lambda row: row[0])
def test_code_and_test_of_every_equation_are_there(row: list[str]) -> None:
    code = re.findall(r"`(\w+)\.(\w+)`", row[1])
    assert code
    for module, name in code:
        assert hasattr(importlib.import_module(f"wam_power_ros.{module}"), name)
    tests = "\n".join(path.read_text() for path in (ROOT / "test").glob("test_*.py"))
    for name in re.findall(r"`(\w+)`", row[2]):
        assert f"def {name}(" in tests


@pytest.mark.parametrize("link", sorted(set(re.findall(r"\]\((?!https?:)([^)#]+)\)", README))))
def test_every_link_of_the_readme_leads_somewhere(link: str) -> None:
    assert (ROOT / link).exists()


@pytest.mark.parametrize("target", re.findall(r"^make (\w+)", README, re.MULTILINE))
def test_every_make_target_of_the_readme_is_there(target: str) -> None:
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)
