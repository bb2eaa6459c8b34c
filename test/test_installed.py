# SPDX-License-Identifier: Apache-2.0
"""What is found by entry points: names that are unknown, doubled, incomplete or contradicted."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from hardware_sim.scenes import scene_type
from hardware_sim.scenes.flip import Flip as FlipScene
from wam_power_ros import installed
from wam_power_ros.cli.launcher import Devices
from wam_power_ros.learning.power import Power
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.params import overlay
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.errors import Effect, Error
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.task import Task

Lab = Callable[..., Path]
SCENE = "class Stack:\n    body = 'block'\n"
MODULE = """
from wam_power_ros.tasks.flip.task import Flip
from wam_power_ros.tasks.task import Task

class Stack(Task):
    name, body = "stack", "block"
    presets = {"own": {"budget": 9}}
    assess = None

class HighFlip(Flip):
    name = "high_flip"
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
    known = "'tap' is not one of ball_in_cup, flip, rated, reach"
    with pytest.raises(ValueError, match=known):
        overlay.setup(task="tap")
    for words in ("config", "learn"):
        assert known in refusal(words, "--task", "tap"), words
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
    lab(learners=("broken = no_such_package:Learner", "cma_es = LAB.task:Stack"))
    preset("reach").check(1)
    with pytest.raises(ValueError, match=r"a model of .* that work: power") as refused:
        preset("flip", "paper", {"name": "model_based"}).check(1)
    assert not {"broken", "cma_es"} & set(str(refused.value).rpartition(": ")[2].split(", "))


def test_a_learner_may_be_a_class_that_the_program_has_imported_and_none_is_imported_by_name(
    lab: Lab,
) -> None:
    (lab() / "own.py").write_text("from wam_power_ros.learning.power import Power as Mine\n")
    refused = "is no class of a learner that this program has imported"
    for name in ("my_lab.own:Mine", "json:JSONDecoder", "my_lab.own:", ":Power"):
        with pytest.raises(ValueError, match=f"learner '{name}' is no"):
            installed.find("learner", name)
    assert "my_lab.own" not in sys.modules
    importlib.import_module("my_lab.own")
    assert installed.find("learner", "my_lab.own:Mine") is Power
    assert preset("reach", learner={"name": "my_lab.own:Mine"}).learner_settings.sigma == 6
    with pytest.raises(ValueError, match=refused):
        preset("reach", learner={"name": "wam_power_ros.learning.power:power_update"})


def test_what_cannot_be_imported_is_refused_with_its_package(lab: Lab) -> None:
    lab(scenes=("broken = no_such_package:Scene", "pan = hardware_sim.scenes.flip:Flip"))
    assert scene_type("pan") is FlipScene
    with pytest.raises(ValueError, match=r"'broken' \(.* of my_lab\) cannot be loaded: .*no_such"):
        scene_type("broken")


def test_the_task_of_another_package_brings_its_set_up_and_names_the_body(stack: Path) -> None:
    setup = Devices().parameters("stack")
    assert installed.task_setup("stack", Path()) == stack / "stack.yaml"
    assert setup["demonstration_recorder"]["stem"] == setup["learner"]["task"] == "stack"
    assert {values["body"] for values in setup.values() if "body" in values} == {"block"}
    assert setup["pancake_tracker"]["pose_topic"] == "block/pose"
    (stack / "stack.yaml").unlink()  # as if it had not been packed
    with pytest.raises(ValueError, match=r"no .*my_lab/stack.yaml: task 'stack' needs it, .*pack"):
        overlay.setup(task="stack")


def test_a_task_that_is_derived_from_another_has_its_set_up_unless_it_brings_one(
    stack: Path,
) -> None:
    assert installed.task_setup("high_flip", overlay.share("config")).name == "flip.yaml"
    own = stack / "high_flip.yaml"
    own.write_text("wam_sim: {ros__parameters: {spread: 2.0}}")
    assert overlay.setup(task="high_flip")["wam_sim"]["spread"] == 2.0


@pytest.mark.parametrize("point", ["a = LAB.task:Stack", "a = LAB.scene:Stack"])
def test_an_entry_point_must_lead_to_a_task_of_its_name(point: str, lab: Lab) -> None:
    lab(tasks=(point,))
    with pytest.raises(ValueError, match="is not an imported subclass of Task so named"):
        overlay.setup(task="a")


def test_another_body_than_the_tasks_is_refused_wherever_it_is_said(
    stack: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.yaml"
    for node in [node for node, values in overlay.setup().items() if "body" in values]:
        other.write_text(f"{node}: {{ros__parameters: {{body: brick}}}}")
        with pytest.raises(ValueError, match=r"'brick'} of \w+ contradicts task 'stack', "):
            overlay.setup([str(other)], task="stack")
    other.write_text("wam_sim: {ros__parameters: {scene: flip}}")
    with pytest.raises(ValueError, match="'pancake' of scene 'flip'; task 'stack' has 'block'"):
        Devices([str(other)], simulate=True).parameters("stack")


class Loose(BaseModel):
    """Settings that ignore what they do not know."""

    settle_time: float = 0.5


class Strict(Loose, extra="forbid"):
    """Settings without those of the default parametrization."""


def nothing(self: Task, rollout: Rollout) -> dict[str, float]:
    """A rollout tells nothing."""
    return {}


LIMITED = Error("miss", "m", 0.01, limit=0.03)
PUSHED = Effect("amplitude", 0.2, {"miss": 0.5})
STATED = {"name": "mine", "errors": (LIMITED,), "effects": (PUSHED,), "observe": nothing}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"name": ""}, "name = '' must be a name of letters, digits and _"),
        ({"obsreve": nothing}, "it has no member 'obsreve': 'observe' is meant, or choose"),
        ({"settle_time": 2.0}, "settle_time is stated by `Settings`"),
        ({"presets": ["own"]}, r"presets = \['own'\] must be a mapping"),
        ({"effects": ("amplitude",)}, r"effects = \('amplitude',\) must be a tuple of Effect"),
        ({"errors": (Error("miss", "m", 0.01),)}, "there is no return"),
        ({"gain": 1.5}, "gain = 1.5 must be 0 to 1"),
        ({"Settings": Loose}, "Loose'> must refuse unknown fields"),
        ({"Settings": Strict}, "Strict'> has no noise, variant: derive it from TaskSettings"),
        ({"errors": (LIMITED, LIMITED)}, "'miss' is stated twice"),
        ({"observe": Task.observe}, "there is no return: define observe, .*or define assess"),
        (
            {"effects": (Effect("vigor", 0.2, {"miss": 0.5}),)},
            "effect 'vigor' is not one of shift_x, shift_y, shift_z, amplitude, tempo",
        ),
        (
            {"effects": (Effect("amplitude", 0.2, {"miss": 0.5, "mis": 1.0}),)},
            "effects move 'mis', which is none of the errors miss",
        ),
        ({"effects": (), "predict": nothing}, "predict is never asked: effects move none"),
        ({"targets": {"string": 0.4}}, "target 'string' is none of the errors, and .* no `carr"),
    ],
)
def test_a_task_is_checked_when_its_class_is_defined(changes: dict, says: str) -> None:
    assert type("Mine", (Task,), STATED).body == ""
    with pytest.raises(TypeError, match=f"^task Mine: .*{says}"):
        type("Mine", (Task,), STATED | changes)


class Tossed(Flip):
    """The flip by another name."""

    name = "tossed"


def test_a_task_that_this_program_has_imported_needs_no_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "my_script", sys.modules[Tossed.__module__])
    settings = preset("my_script:Tossed", "paper")
    assert settings.make_task({}).name == "tossed" and settings.practice.budget == 50
    for wrong in ("my_script:Loose", "my_script:Tosed", "not_imported:Tossed"):
        with pytest.raises(ValueError, match=f"task '{wrong}': .* is not an imported subclass"):
            preset(wrong)


def test_a_preset_needs_no_learner_and_may_not_misspell_a_setting(
    stack: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = preset("stack")
    assert settings.learner == "power"
    presets = installed.task_type("stack").presets
    for key, value, named in (("bugdet", 3, "bugdet"), ("learner", {"nmae": "power"}, "nmae")):
        with monkeypatch.context() as patch, pytest.raises(ValueError, match=named):
            patch.setitem(presets["own"], key, value)
            preset("stack")


@pytest.mark.parametrize("task", ["flip", "reach"])
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
