# SPDX-License-Identifier: Apache-2.0
"""Dependencies point one way: command line, experiments and nodes -> core; stand-ins -> core."""

import ast
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
}
SIMULATOR = {"hardware_sim", "mujoco"}
# May import ROS: all that speaks it, beside nodes/.
ROS_EDGE = {
    *("access", "interface", "messages", "params", "real_time", "late_service", "service_calls"),
    *("teaching", "replaying", "playing", "enabling", "tell", "wire"),
}
# Files, clocks, processes and sockets are theirs; every other module is the core.
TELLING = {"cli", "lessons", "live", "figures", "study_figures", "page", "report"}
BAGS = {"bags", "recording", "recovery"}
MACHINE = {"dds_ports", "processes", "resources"}
EDGE = ROS_EDGE | TELLING | BAGS | MACHINE | {"setups", "session", "workbench"}
OUTSIDE_WORLD = {"socket", "subprocess", "threading", "multiprocessing", "os", "time", "datetime"}

MODULES = sorted([*PACKAGE.rglob("*.py"), *STAND_INS.rglob("*.py")])
CORE = [path for path in PACKAGE.glob("*.py") if path.stem not in {*EDGE, "__init__"}]


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


def label(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_there_is_something_to_check() -> None:
    assert len(CORE) > 5
    assert {"power", "primitive", "policy"} <= {path.stem for path in CORE}


@pytest.mark.parametrize("path", CORE, ids=label)
def test_the_core_knows_neither_ros_nor_simulator_nor_the_outside_world(path: Path) -> None:
    assert not roots(imports(path)) & (ROS | SIMULATOR | OUTSIDE_WORLD)


@pytest.mark.parametrize("path", CORE, ids=label)
def test_the_core_imports_nothing_of_what_stands_around_it(path: Path) -> None:
    around = {f"wam_power_ros.{name}" for name in (*EDGE, "nodes", "experiments")}
    assert not {name for name in imports(path) if name.startswith(tuple(around))}


@pytest.mark.parametrize("path", CORE, ids=label)
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
def test_ros_is_spoken_only_at_the_edge(path: Path) -> None:
    at_edge = path.parent == PACKAGE / "nodes" or path.parent == STAND_INS
    if not at_edge and path.stem not in ROS_EDGE:
        assert not roots(imports(path)) & ROS


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=label)
def test_only_in_process_experiments_import_the_stand_ins(path: Path) -> None:
    if path.parent != PACKAGE / "experiments":
        assert not roots(imports(path)) & SIMULATOR


@pytest.mark.parametrize("path", sorted(STAND_INS.rglob("*.py")), ids=label)
def test_the_stand_ins_know_no_node_and_no_learner(path: Path) -> None:
    known = {name.split(".")[1] for name in imports(path) if name.startswith("wam_power_ros.")}
    assert not known & {"nodes", "experiments", "cli", "practice", "power", "session", "controller"}


@pytest.mark.parametrize("path", MODULES, ids=label)
def test_every_module_says_its_licence_in_one_line(path: Path) -> None:
    assert path.read_text().splitlines()[0] == "# SPDX-License-Identifier: Apache-2.0"


LOADED_AS_CODE = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "imp", "runpy"}
RUNS_TEXT = {"eval", "exec", "compile", "__import__"}
UNSAFE = {"yaml": {"load", "load_all", "full_load", "unsafe_load"}, "os": {"system", "popen"}}
ANYWHERE = sorted([*MODULES, *(ROOT / "benchmark").rglob("*.py"), *(ROOT / "launch").rglob("*.py")])
ALLOWED = {("bags.py", "yaml", "load")}  # with a loader that is checked below


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
            if (path.name, owner, name) not in ALLOWED:
                assert name not in UNSAFE.get(owner, ())
        for keyword in node.keywords:  # of np.load, of subprocess
            if keyword.arg in ("allow_pickle", "shell"):
                assert isinstance(keyword.value, ast.Constant) and keyword.value.value is False


def test_the_loader_of_bags_knows_nothing_but_data() -> None:
    import yaml

    from wam_power_ros import bags

    assert issubclass(bags.LOADER, (yaml.SafeLoader, getattr(yaml, "CSafeLoader", yaml.SafeLoader)))
