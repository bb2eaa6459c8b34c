# SPDX-License-Identifier: Apache-2.0
"""What is found by entry points: names that are unknown, doubled, incomplete or contradicted."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel, ConfigDict

from hardware_sim.scenes import scene_type
from hardware_sim.scenes.flip import Flip as FlipScene
from wam_power_ros import installed
from wam_power_ros.cli.launcher import Devices
from wam_power_ros.cli.session_options import method_words
from wam_power_ros.learning.power import Power
from wam_power_ros.params import overlay
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.task import Task

Lab = Callable[..., Path]
SCENE = "class Stack:\n    body = 'block'\n"
MODULE = """
from pydantic import BaseModel, ConfigDict
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.reach.settings import REACH_FIT
from wam_power_ros.tasks.task import Task

class Settings(BaseModel):
    model_config = ConfigDict(extra="forbid")
    settle_time: float = 0.5

class Stack(Task):
    name, body, single_policy, fit_settings, Settings = "stack", "block", False, REACH_FIT, Settings
    presets = {"own": {"budget": 9, "mean_every": 3, "confirm": 5, "retests": 2}}
    parametrization = assess = outcome = None

class HighFlip(Flip):
    name = "high_flip"

class Unfinished(Stack):
    name, outcome = "unfinished", Task.outcome

class Nameless(Flip):
    pass
"""
TASKS = ("stack = LAB.task:Stack", "high_flip = LAB.task:HighFlip")


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    """Function that installs a distribution with entry points, and a module `task` with tasks."""
    installed.find.cache_clear()
    monkeypatch.syspath_prepend(str(tmp_path))
    installing: list[str] = []

    def install(name: str = "my_lab", /, **points: tuple[str, ...]) -> Path:
        installing.append(name)
        (folder := tmp_path / name).mkdir()
        (folder / "__init__.py").touch()
        (folder / "task.py").write_text(MODULE)
        (folder / "scene.py").write_text(SCENE)
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        sections = (
            f"[wam_power_ros.{kind}]\n" + "\n".join(each).replace("LAB", name) + "\n"
            for kind, each in points.items()
        )
        (info / "entry_points.txt").write_text("".join(sections))
        return folder

    yield install
    installed.find.cache_clear()
    for module in [name for name in sys.modules if name.partition(".")[0] in installing]:
        del sys.modules[module]


@pytest.fixture
def stack(lab: Lab) -> Path:
    """Folder of a package with the task `stack`, its set-up and its scene."""
    folder = lab(tasks=TASKS, scenes=("stack = LAB.scene:Stack",))
    (folder / "stack.yaml").write_text(
        "demonstration_recorder: {ros__parameters: {stem: stack}}\n"
        "wam_sim: {ros__parameters: {scene: stack}}\n"
    )
    return folder


def test_a_task_that_is_not_installed_is_refused_wherever_it_is_named(
    refusal: Callable[..., str],
) -> None:
    known = "'tap' is not one of ball_in_cup, flip, reach"
    with pytest.raises(ValueError, match=known):
        overlay.setup(task="tap")
    commands = "layout rviz", "config", "teach", "learn", "plan sim", "score x", "run-policy x"
    for words in commands:
        assert known in refusal(*words.split(), "--task", "tap"), words
    with pytest.raises(ValueError, match=r"learner 'pwoer' is not one of .*, power, "):
        installed.find("learner", "pwoer")


@pytest.mark.parametrize(
    ("kind", "name", "own"),
    [("task", "flip", Flip), ("learner", "power", Power), ("scene", "flip", FlipScene)],
)
def test_a_name_that_two_packages_declare_is_refused_with_both(
    kind: str, name: str, own: type, lab: Lab
) -> None:
    assert installed.find(kind, name) is own
    installed.find.cache_clear()
    lab("other_lab", **{f"{kind}s": (f"{name} = LAB.task:HighFlip",)})
    declared = rf"other_lab.task:HighFlip of other_lab and {own.__module__}:{own.__name__} of wam_p"
    with pytest.raises(ValueError, match=rf"{kind} '{name}' is declared twice, {declared}"):
        installed.find(kind, name)
    assert installed.names(kind).count(name) == 1


def test_a_learner_that_cannot_be_loaded_hinders_no_session_of_another_one(lab: Lab) -> None:
    lab(learners=("broken = no_such_package:Learner", "pi2_bb = LAB.task:Stack"))
    preset("reach").check(1)
    with pytest.raises(ValueError, match=r"a model of .* that work: adaptive") as refused:
        preset("flip", "paper", {"name": "model_based"}).check(1)
    assert not {"broken", "pi2_bb"} & set(str(refused.value).rpartition(": ")[2].split(", "))


def test_what_cannot_be_imported_is_refused_with_its_package(lab: Lab) -> None:
    lab(scenes=("broken = no_such_package:Scene", "pan = hardware_sim.scenes.flip:Flip"))
    assert scene_type("pan") is FlipScene
    with pytest.raises(ValueError, match=r"'broken' \(.* of my_lab\) cannot be loaded: .*no_such"):
        scene_type("broken")


def test_the_task_of_another_package_brings_its_set_up_and_names_the_body(stack: Path) -> None:
    setup = Devices().parameters("stack")
    assert installed.task_setup("stack", Path()) == stack / "stack.yaml"
    assert setup["demonstration_recorder"]["stem"] == setup["learner"]["task"] == "stack"
    assert {setup[node]["body"] for node in overlay.WITH_BODY} == {"block"}
    assert setup["pancake_tracker"]["pose_topic"] == "block/pose"


def test_a_task_whose_set_up_was_not_packed_is_refused(stack: Path) -> None:
    (stack / "stack.yaml").unlink()
    with pytest.raises(
        ValueError, match=r"no .*my_lab/stack.yaml: task 'stack' needs it, .*package-data"
    ):
        overlay.setup(task="stack")


def test_a_task_that_is_derived_from_another_has_its_set_up_unless_it_brings_one(
    stack: Path,
) -> None:
    assert installed.task_setup("high_flip", overlay.share("config")).name == "flip.yaml"
    own = stack / "high_flip.yaml"
    own.write_text("wam_sim: {ros__parameters: {spread: 2.0}}")
    assert overlay.setup(task="high_flip")["wam_sim"]["spread"] == 2.0


@pytest.mark.parametrize(
    ("point", "says"),
    [
        ("a = LAB.task:Stack", "must derive from Task and be named 'a'"),
        ("a = LAB.scene:Stack", "must derive from Task and be named 'a'"),
        ("nameless = LAB.task:Nameless", "must derive from Task and be named 'nameless'"),
        ("unfinished = LAB.task:Unfinished", "does not define outcome"),
    ],
)
def test_an_entry_point_must_lead_to_a_complete_task_of_its_name(
    point: str, says: str, lab: Lab
) -> None:
    lab(tasks=(point,))
    with pytest.raises(ValueError, match=says):
        overlay.setup(task=point.partition(" ")[0])


def test_another_body_than_the_tasks_is_refused_wherever_it_is_said(
    stack: Path, tmp_path: Path
) -> None:
    for node in overlay.WITH_BODY:
        other = tmp_path / "other.yaml"
        other.write_text(f"{node}: {{ros__parameters: {{body: brick}}}}")
        says = r"'brick'} of \w+ contradicts task 'stack', .*'block'}: .*omit it in .*other.yaml"
        with pytest.raises(ValueError, match=says):
            overlay.setup([str(other)], task="stack")
        assert overlay.setup([str(other)])[node]["body"] == "brick"
    other.write_text("wam_sim: {ros__parameters: {scene: flip}}")
    with pytest.raises(ValueError, match="'pancake' of scene 'flip'; task 'stack' has 'block'"):
        Devices([str(other)], simulate=True).parameters("stack")


class Loose(BaseModel):
    """Settings that ignore what they do not know."""

    settle_time: float = 0.5


STATED = {
    name: getattr(Flip, name)
    for name in ("name", "body", "single_policy", "fit_settings", "Settings", "presets")
}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        *(({name: None}, f"task Mine does not state {name}") for name in STATED),
        ({"body": "my body"}, "body = 'my body' of task Mine"),
        ({"Settings": Loose}, "Loose'> must refuse unknown fields"),
        ({"presets": {}}, "task Mine does not state presets"),
    ],
)
def test_a_task_is_checked_when_its_class_is_defined(changes: dict, says: str) -> None:
    stated = {k: v for k, v in (STATED | changes).items() if v is not None}
    with pytest.raises(TypeError, match=says):
        type("Mine", (Task,), stated)


def test_a_preset_needs_no_learner_and_may_not_misspell_a_setting(
    stack: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = preset("stack")
    assert settings.learner == "power" and method_words(settings) == []
    presets = installed.task_type("stack").presets
    for key, value in (("settel_time", 1.0), ("bugdet", 3), ("learnr", {"name": "power"})):
        monkeypatch.setitem(presets["own"], key, value)
        with pytest.raises(ValueError, match=rf"task_settings.{key}.*: Extra inputs are not perm"):
            preset("stack")
        monkeypatch.delitem(presets["own"], key)
    monkeypatch.setitem(presets["own"], "learner", {"nmae": "power"})
    with pytest.raises(ValueError, match="nmae"):
        preset("stack")


@pytest.mark.parametrize("task", ["ball_in_cup", "flip", "reach"])
def test_a_learner_works_with_a_preset_or_is_refused_with_all_that_do(task: str) -> None:
    presets, refused = list(installed.task_type(task).presets), 0
    for name in {presets[0], presets[-1]}:
        preset(task, name).check(1)
        works: list[str] = []
        refusals: list[str] = []
        for learner in installed.names("learner"):
            try:
                preset(task, name, {"name": learner}).check(1)
                works.append(learner)
            except ValueError as error:
                refusals.append(str(error))
        refused += len(refusals)
        for refusal in refusals:
            assert refusal.endswith(f"learners that work: {', '.join(works)}")
    assert refused


def test_the_budget_is_checked_also_where_a_task_knows_no_made_up_movement(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(demonstrations: object, policy_id: str) -> None:
        raise ValueError("none of its movements")

    monkeypatch.setattr(Flip, "policy_of", refuse)
    preset("flip", "paper", {"name": "model_based"}, budget=4).check(3)
    with pytest.raises(ValueError, match=r"budget of 3 .* allow 4 trials or more"):
        preset("flip", budget=3).check(3)


def test_settings_of_a_task_that_forbid_what_they_do_not_know_are_accepted() -> None:
    strict = type("Strict", (Loose,), {"model_config": ConfigDict(extra="forbid")})
    assert type("Mine", (Task,), STATED | {"Settings": strict}).body == "pancake"
