# SPDX-License-Identifier: Apache-2.0
"""The house: which folder may import which, held as a table; and what each folder keeps out."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE, STAND_INS = ROOT / "wam_power_ros", ROOT / "hardware_sim"
ROS = {
    "rclpy",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "lifecycle_msgs",
    "nav_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "trajectory_msgs",
    "visualization_msgs",
}
SIMULATOR = {"mujoco"}
OUTSIDE_WORLD = {"socket", "subprocess", "threading", "multiprocessing", "os", "time", "datetime"}

# Folder -> the folders it may import, beside itself. Nothing else is allowed; no circle can form
# because each folder only names folders above it.
ALLOWED: dict[str, set[str]] = {
    "durable_files": set(),  # a root module that every folder with files may import
    "entry": set(),  # imported first by every process
    "rotations": set(),
    "arm_identity": set(),
    "bags": {"durable_files", "arm_identity"},
    "learning": {"rotations", "arm_identity"},
    "control": {"rotations", "arm_identity", "learning"},
    "tracking": {"rotations", "learning"},
    "tasks": {"rotations", "learning"},
    "practice": {"durable_files", "learning", "tasks"},
    "params": {"durable_files", "rotations", "learning", "control", "tracking"},
    "conformance": {"rotations", "learning", "control", "tracking"},
    "ros": {"entry", "rotations", "learning", "params", "bags"},
    "reporting": {"rotations", "learning", "tasks", "practice"},
}
BELOW = set(ALLOWED)
ALLOWED["view"] = {*BELOW, "console"} - {"conformance"}
ALLOWED["nodes"] = BELOW - {"reporting"}
ALLOWED["console"] = BELOW - {"reporting", "practice", "tasks"}
ALLOWED["hardware_sim"] = BELOW - {"bags", "practice", "conformance", "reporting"}
ALLOWED["experiments"] = {*BELOW, "hardware_sim"} - {"ros"}
ALLOWED["cli"] = {*BELOW, "nodes", "console", "experiments", "view"}
ALLOWED["robot"] = {"bags", "control", "learning", "params", "ros", "nodes", "cli"}
ALLOWED["benchmark"] = {*ALLOWED, "cli"}
PURE = ("rotations", "arm_identity", "learning", "control", "tracking", "tasks", "conformance")
SPEAK_ROS = {"params", "ros", "nodes", "console", "view", "robot", "hardware_sim", "benchmark"}
SIMULATE = {"hardware_sim", "experiments", "benchmark"}

MODULES = sorted([*PACKAGE.rglob("*.py"), *STAND_INS.rglob("*.py")])
BENCHMARKS = sorted((ROOT / "benchmark").rglob("*.py"))


def imports(path: Path) -> set[str]:
    """Dotted names a module imports, anywhere in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: relative imports hide where they point"
            names.add(node.module or "")
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def roots(names: set[str]) -> set[str]:
    return {name.partition(".")[0] for name in names}


def folder(path: Path) -> str:
    """Row of the table that a module stands in."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return parts[1] if parts[0] == "wam_power_ros" else parts[0]


def imported_folders(path: Path) -> set[str]:
    found = set()
    for name in imports(path):
        root, _, rest = name.partition(".")
        if root == "wam_power_ros" and rest and rest != "__version__":
            found.add(rest.partition(".")[0])
        elif root in ("hardware_sim", "benchmark"):
            found.add(root)
    return found - {folder(path)}


def in_folders(*names: str) -> list[Path]:
    return [path for path in MODULES if folder(path) in names]


def label(path: Path) -> str:
    return str(path.relative_to(ROOT))


def circles(arrows: dict[str, set[str]]) -> Iterator[list[str]]:
    """Paths of modules that lead back to where they began, each once per module on it."""
    for start in arrows:
        waiting, seen = [[start]], set()
        while waiting:
            trail = waiting.pop()
            for reached in arrows.get(trail[-1], ()):
                if reached == start:
                    yield [*trail, start]
                elif reached not in seen:
                    seen.add(reached)
                    waiting.append([*trail, reached])


def module_arrows() -> dict[str, set[str]]:
    """Module -> modules of ours that it imports."""

    def dotted(path: Path) -> str:
        return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")

    known = {dotted(path) for path in MODULES}
    return {dotted(path): (imports(path) & known) - {dotted(path)} for path in MODULES}


def test_every_module_stands_in_a_folder_of_the_table() -> None:
    stray = {label(path) for path in MODULES if folder(path) not in {*ALLOWED, "__init__"}}
    assert stray == set()
    assert {"power", "dmp", "policy"} <= {path.stem for path in in_folders("learning")}


@pytest.mark.parametrize("path", [*MODULES, *BENCHMARKS], ids=label)
def test_a_module_imports_only_the_folders_that_the_table_allows(path: Path) -> None:
    assert imported_folders(path) <= ALLOWED.get(folder(path), set())


def test_no_module_imports_itself_by_way_of_others() -> None:
    assert sorted(circles(module_arrows())) == []


def test_a_circle_of_modules_would_be_found() -> None:
    assert list(circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}))


@pytest.mark.parametrize("path", in_folders(*PURE), ids=label)
def test_the_pure_folders_know_neither_ros_nor_simulator_nor_the_outside_world(path: Path) -> None:
    assert not roots(imports(path)) & (ROS | SIMULATOR | OUTSIDE_WORLD)


@pytest.mark.parametrize("path", in_folders(*PURE, "practice"), ids=label)
def test_the_core_draws_only_from_the_generator_it_is_given(path: Path) -> None:
    drawn = {
        node.attr
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Attribute)
        and node.value.attr == "random"
    }
    assert drawn <= {"Generator", "PCG64", "BitGenerator", "SeedSequence"}
    assert "random" not in roots(imports(path))


@pytest.mark.parametrize("path", MODULES, ids=label)
def test_only_some_folders_speak_ros_and_only_some_simulate(path: Path) -> None:
    if folder(path) not in SPEAK_ROS:
        assert not roots(imports(path)) & ROS
    if folder(path) not in SIMULATE:
        assert not roots(imports(path)) & SIMULATOR


@pytest.mark.parametrize("path", MODULES, ids=label)
def test_every_module_says_its_licence_in_one_line(path: Path) -> None:
    assert path.read_text().splitlines()[0] == "# SPDX-License-Identifier: Apache-2.0"


LOADED_AS_CODE = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "imp", "runpy"}
RUNS_TEXT = {"eval", "exec", "compile", "__import__"}
UNSAFE = {"yaml": {"load", "load_all", "full_load", "unsafe_load"}, "os": {"system", "popen"}}
ANYWHERE = sorted([*MODULES, *(ROOT / "benchmark").rglob("*.py"), *(ROOT / "launch").rglob("*.py")])
YAML_LOAD = {  # with loaders that are checked below
    ("plain_yaml.py", "yaml", "load"),
    ("parameter_file.py", "yaml", "load"),
}


@pytest.mark.parametrize("path", ANYWHERE, ids=label)
def test_no_file_that_is_loaded_can_run_code(path: Path) -> None:
    assert not roots(imports(path)) & LOADED_AS_CODE
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call):
            continue
        if isinstance(node.func, ast.Name):
            assert node.func.id not in RUNS_TEXT
        elif isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
            owner, name = node.func.value.id, node.func.attr
            if (path.name, owner, name) not in YAML_LOAD:
                assert name not in UNSAFE.get(owner, ())
        for keyword in node.keywords:  # of np.load, of subprocess
            if keyword.arg in ("allow_pickle", "shell"):
                assert isinstance(keyword.value, ast.Constant) and keyword.value.value is False


def test_the_loaders_of_yaml_know_nothing_but_data() -> None:
    import yaml

    from wam_power_ros.bags import plain_yaml
    from wam_power_ros.params import parameter_file

    safe = (yaml.SafeLoader, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    assert issubclass(plain_yaml.LOADER, safe)
    assert issubclass(parameter_file.Loader, safe)
