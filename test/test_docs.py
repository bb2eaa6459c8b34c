# SPDX-License-Identifier: Apache-2.0
"""The documentation names what there is, and what it names is there."""

import importlib
import importlib.util
import math
import re
import shlex
import textwrap
from pathlib import Path

import pytest
import yaml
from packaging.specifiers import SpecifierSet

import wam_power_ros
from wam_power_ros.cli import main
from wam_power_ros.cli.main import NODES
from wam_power_ros.faults import FaultKind
from wam_power_ros.params import overlay
from wam_power_ros.practice.settings import preset
from wam_power_ros.ros import interface

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
NODES_PAGE = (ROOT / "docs/nodes.md").read_text()
METHOD = (ROOT / "docs/method.md").read_text()
PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "examples/README.md",
    *(str(path.relative_to(ROOT)) for path in ROOT.glob("docs/**/*.md")),
]
CITATION = re.compile(r"\[([A-Z][A-Za-z]+(?:19|20)\d\d)[],]")
SOURCES = [
    path
    for folder in ("wam_power_ros", "hardware_sim", "reproduction", "benchmark", "docs", "config")
    for path in (ROOT / folder).rglob("*")
    if path.suffix in (".py", ".md", ".yaml")
]
NAMES = sorted(
    [
        f"/{name.lstrip('/')}"  # without a namespace
        for name in (
            *(
                value
                for key, value in vars(interface).items()
                if key.isupper() and isinstance(value, str) and not key.endswith("_FRAME")
            ),
            *(interface.body_topic("pancake", leaf) for leaf in interface.BODY_LEAVES),
            interface.rollout_topic("pancake"),
        )
        if name != interface.SCENE
    ]
)
TESTS = "\n".join(path.read_text() for path in (ROOT / "test").rglob("test_*.py"))
PAPER = re.search(r"\| paper \| code \| test \|\n(.*?)\n\n", METHOD, re.DOTALL)


def rows(table: str) -> list[list[str]]:
    lines = [line for line in table.splitlines() if not re.fullmatch(r"[|\-]+", line)]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def test_every_topic_service_and_node_is_documented() -> None:
    assert len(NAMES) > 15
    assert [name for name in NAMES if f"`{name}`" not in NODES_PAGE] == []
    assert [node for node in NODES if f"\n| `{node}` |" not in NODES_PAGE] == []


def is_there(module: str, name: str) -> bool:
    """Whether a module has this name, or a package this module, imported or not."""
    found = importlib.import_module(module)
    return hasattr(found, name) or (
        hasattr(found, "__path__") and importlib.util.find_spec(f"{module}.{name}") is not None
    )


@pytest.mark.parametrize("row", rows(PAPER.group(1)), ids=lambda row: row[0])
def test_code_and_test_of_every_equation_are_there(row: list[str]) -> None:
    code = re.findall(r"`([\w.]+)\.(\w+)`", row[1])
    assert code
    for module, name in code:
        assert is_there(f"wam_power_ros.{module}", name)
    for name in re.findall(r"`(\w+)`", row[2]):
        assert f"def {name}(" in TESTS


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_somewhere_and_every_test_that_is_named_is_there(page: str) -> None:
    folder, text = (ROOT / page).parent, (ROOT / page).read_text()
    links = re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", text)
    assert [link for link in links if not (folder / link).exists()] == []
    named = re.findall(r"`(test_\w+)`", text)
    assert [name for name in named if f"def {name}(" not in TESTS] == []


@pytest.mark.parametrize("page", PAGES)
def test_every_name_of_a_module_is_there(page: str) -> None:
    named = re.findall(r"`(?:wam_power_ros\.)?([a-z_.]+)\.(\w+)`", (ROOT / page).read_text())
    for module, name in named:
        package = "" if module.startswith(("hardware_sim", "reproduction")) else "wam_power_ros."
        if importlib.util.find_spec(f"{package}{module}") is not None:
            assert is_there(f"{package}{module}", name), (module, name)


def test_the_method_states_the_numbers_of_the_presets() -> None:
    text = " ".join(METHOD.split())
    paper, ours = (preset("flip", name) for name in ("paper", "hindsight"))
    settings, course = ours.task_settings, ours.practice
    stated = (
        f"{100 * paper.task_settings.noise.attractor:.0f} cm for each",
        f"budget {paper.practice.budget}",
        f"σ = {paper.learner_settings.sigma} ",
        f"R ≥ {paper.task_settings.success_return}, confirmed",
        f"{1000 * settings.noise.attractor:.0f} mm, {settings.noise.rotation} rad",
        f"moved by `gain`, {settings.gain}, of what would take",
        f"at least {math.degrees(settings.success_angle):.0f} degrees",
        f"or {course.confirm} of {course.confirm} times, or after {course.budget} rollouts",
    )
    assert [words for words in stated if words not in text] == []


def test_every_citation_is_in_the_references() -> None:
    cited = {key for path in SOURCES for key in CITATION.findall(path.read_text())}
    listed = set(re.findall(r"^\* \[(\w+)\]", (ROOT / "docs/references.md").read_text(), re.M))
    assert {"Kormushev2010", "Hansen2016"} <= cited
    assert cited - listed == set()


def test_every_kind_of_fault_is_explained() -> None:
    page = (ROOT / "docs/troubleshooting.md").read_text()
    table = re.search(r"(\| kind \|.*?)\n\n", page, re.DOTALL)
    assert table is not None
    kinds = " ".join(row[0] for row in rows(table.group(1)))
    assert set(re.findall(r"`(\w+)`", kinds)) == {kind.value for kind in FaultKind}


def blocks(page: str, language: str) -> list[str]:
    """Blocks of code of a page, wherever they are indented."""
    pattern = rf"^( *)```{language}\n(.*?)^ *```"
    found = re.findall(pattern, (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)
    return [textwrap.dedent(text) for _, text in found]


@pytest.mark.parametrize("page", PAGES)
def test_every_example_of_the_pages_runs(
    page: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    for block in blocks(page, "python"):
        exec(compile(block, page, "exec"), names)
    for block in blocks(page, "yaml"):
        file = tmp_path / block.partition("\n")[0].removeprefix("# ")
        file.write_text(block)
        setup = overlay.setup([str(file)], simulated=True)
        for node, values in yaml.safe_load(block).items():
            assert values["ros__parameters"].items() <= setup[node].items()


def commands(page: str) -> list[list[str]]:
    """Commands of wam-power in the blocks of a page, without comments and redirections."""
    text = "\n".join(blocks(page, "bash")).replace("\\\n", " ")
    split = [shlex.split(line, comments=True) for line in text.splitlines() if "wam-power" in line]
    return [words[words.index("wam-power") + 1 :] for words in split if "wam-power" in words]


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_the_pages_is_one_of_the_command_line(page: str) -> None:
    for words in commands(page):
        main._parser().parse_args(words)


def test_the_workflow_runs_every_python_that_the_package_names() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    (allowed,) = re.findall(r'python_requires="(.*)"', (ROOT / "setup.py").read_text())
    wanted = [f"3.{minor}" for minor in range(20) if f"3.{minor}" in SpecifierSet(allowed)]
    assert workflow["jobs"]["python"]["strategy"]["matrix"]["python"] == wanted
    assert {"run": ".ci/run"} in workflow["jobs"]["python"]["steps"]


def test_the_citation_names_the_paper_and_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == wam_power_ros.__version__
    references = " ".join((ROOT / "docs/references.md").read_text().split())
    assert citation["preferred-citation"]["title"] in references
