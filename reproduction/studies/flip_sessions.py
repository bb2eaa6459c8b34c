# SPDX-License-Identifier: Apache-2.0
"""Whole sessions of the pancake task in one process: teach, choose, practise, re-test.

`jobs` are the sessions of the reproduction: the preset `hindsight` and its policies in other
conditions, the paper's preset beside Fig. 5, and the ablation of the paper's stiffness matrices.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hardware_sim.ground_truth import Truth
from hardware_sim.scenes import scene_type
from hardware_sim.scenes.flip import TossScript, wrist_flick
from hardware_sim.sensors import MocapSettings
from hardware_sim.settings import PITCH_RATE, WorldSettings
from hardware_sim.world import World
from reproduction.jobs import Job, Scale
from reproduction.rivals import learners  # noqa: F401 - sessions may name one of its classes
from reproduction.studies.habits import HABITS
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.demonstration import Demonstration, from_joint_samples
from wam_power_ros.learning.dmp import activations
from wam_power_ros.learning.policy import Policy, with_id
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.params import overlay
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.task import Flip

HINDSIGHT, PAPER = "pancake-hindsight", "pancake-paper"  # studies
ABLATION = "pancake-ablation-"
HELD_OUT = range(301, 331)  # seeds not used for tuning
TUNING = range(21, 23)  # for "quick"
NOVICE = 5.0  # [rad/s] intended pitch rate of the demonstrator for Fig. 5
PROFILE = 41  # points of a stiffness profile
FIRES = (3, 0.9)  # rollouts in a row of at least this return: "reproducible" in the paper
CONDITIONS: dict[str, dict[str, Any]] = {
    "wind 0.2 m/s": {"wind_sd": 0.2},
    "wind 0.3 m/s": {"wind_sd": 0.3},
    "pan believed 20 % lighter": {"believed_pan": 0.8},
    "pan believed 20 % heavier": {"believed_pan": 1.2},
    "pancake on pan: friction 0.15": {"friction": 0.15},
    "pancake on pan: friction 0.3": {"friction": 0.3},
    "joint friction halved": {"friction_share": 0.5},
    "joint friction half as much again": {"friction_share": 1.5},
    "2 ms more delay": {"command_delay_ticks": 3},
    "80 V": {"bus_voltage": 80.0},
}
DRIFT = 1.03  # by which a drift changes what drifts, each rollout
LESS = ("attractors", "diagonal", "symmetric")  # variants that learn less than full matrices


def stand_in(
    seed: int,
    *,
    believed_pan: float = 1.0,
    mocap: Mapping[str, Any] | None = None,
    tracker: Mapping[str, Any] | None = None,
    home: Sequence[float] | None = None,
    **world: Any,  # noqa: ANN401 - checked by WorldSettings
) -> Environment:
    """Environment with sensors and motors of the stand-in, in its normal or another condition.

    The controller's model has `believed_pan` times the mass of the pan. Demonstrations begin at
    `home` [rad], None for that of the scene; `mocap` are fields of `MocapSettings`, `world` of
    `WorldSettings`, `tracker` other parameters of the tracker.
    """
    eyes = MocapSettings(**(mocap or {}))
    world_ = World(scene_type("flip"), WorldSettings(**world), seed, eyes)
    if home is not None:
        world_.scene.home = np.array(home)
    setup = overlay.setup().changed({"pancake_tracker": tracker or {}})
    return Environment(world_, urdf=_with_pan(world_.urdf, believed_pan), setup=setup)


def _with_pan(urdf: str, share: float) -> str:
    """Robot description with mass and inertia of the pan scaled by `share`."""
    if share == 1.0:
        return urdf
    tree = ElementTree.fromstring(urdf)
    inertial = tree.find("./link[@name='pan']/inertial")
    if inertial is None:
        raise ValueError("the robot description has no link 'pan' with an inertia")
    for element in (*inertial.iter("mass"), *inertial.iter("inertia")):
        for name, value in element.items():
            element.set(name, repr(share * float(value)))
    return ElementTree.tostring(tree, encoding="unicode")


def teach(
    environment: Environment, seed: int, count: int, pitch_rate: float = PITCH_RATE, habit: str = ""
) -> list[Policy]:
    """Fit a policy to each demonstration of a small series, see `demonstrate`."""
    return _fitted(demonstrate(environment, seed, count, pitch_rate, habit))


def _fitted(shown: Sequence[Demonstration], springs: int = 0) -> list[Policy]:
    named = [(f"demonstration-{number}", each) for number, each in enumerate(shown, 1)]
    return [Flip.policy_of([each], name, springs) for name, each in named]


def demonstrate(
    environment: Environment, seed: int, count: int, pitch_rate: float, habit: str
) -> list[Demonstration]:
    """A small series of demonstrations by the simulated demonstrator.

    Demonstration k of a seed is always the same. `pitch_rate` [rad/s] is that of `wrist_flick`;
    `habit` one of `habits.HABITS`, "" for none.
    """
    shown = []
    for number in range(count):
        rng, level = np.random.default_rng([seed, number]), environment.world.settings.level
        script: TossScript = wrist_flick(rng, pitch_rate=pitch_rate, level=level)
        if habit:
            script = HABITS[habit](script)
        stamps_ns, q = environment.demonstrate(script, f"demonstration-{number}")
        shown.append(from_joint_samples(environment.arm, stamps_ns, q))
    return shown


# The sessions of the reproduction


def session(
    seed: int,
    name: str,
    demonstrations: int = 3,
    pitch_rate: float = PITCH_RATE,
    habit: str = "",
    changes: Mapping[str, Any] | None = None,
    condition: Mapping[str, Any] | None = None,
    carried: Mapping[str, Mapping[str, Any]] | None = None,
    repeats: int = 3,
    keep_paths: bool = False,
    drift: str = "",
) -> dict[str, Any]:
    """Run a session of a preset from its first demonstration to its last re-test, as plain data.

    The seed is that of the demonstrator (see `teach`), the stand-in and the exploration;
    `condition` are arguments of `stand_in`. The final policy is run `repeats` times in each of the
    conditions `carried`, by name. `keep_paths` keeps the paths of reproduction and final policy.
    With a `drift`, the "drag", "friction" or "mass" of `_grow` grows while the session learns.
    """
    environment = stand_in(seed, **(condition or {}))
    shown = demonstrate(environment, seed, demonstrations, pitch_rate, habit)
    settings = preset("flip", name, **(changes or {}))
    context = Flip.context_of(shown, None)
    policies = _fitted(shown, settings.practice.springs)
    practice = Practice(settings, context, policies, seed, environment)
    records: list[Record] = []
    for record in environment.practise(practice):
        records.append(record)
        if drift and record.kind != "retest":
            _grow(environment.world, drift)
    best = practice.best
    trials = [record for record in records if record.kind != "retest"]
    parameters = practice.parametrization
    chosen = "" if parameters is None else parameters.policy0.id
    curve = [record.ret for record in trials if record.demonstration == chosen]
    result = {
        "ended_by": "confirmation" if practice.confirmed else "budget",
        "confirmed": practice.confirmed,
        "used": practice.used,
        "trials": [_kept(record) for record in trials],
        "retests": [_kept(record) for record in records if record.kind == "retest"],
        "curve": curve,  # returns with the chosen demonstration, its reproduction first
        "fires": _fires(curve),
        "carried": {},
        "k33": {},
        "paths": {},
    }
    if best is None or parameters is None:  # no demonstration could be reproduced
        return result
    demonstrated, answer = parameters.policy0, best.policy
    result["k33"] = {"demonstrated": _k33(demonstrated), "learnt": _k33(answer)}
    for place, (where, other) in enumerate((carried or {}).items()):
        elsewhere = stand_in(seed, **other)
        runs = [elsewhere.run(with_id(answer, f"carried-{place}-{k}")) for k in range(repeats)]
        result["carried"][where] = [
            _outcome(truth, "" if rollout.fault is None else rollout.fault.text)
            for rollout, truth in runs
        ]
    if keep_paths:
        executed = {"reproduction": demonstrated, "final policy": answer}
        result["paths"] = {name: _paths(environment, each) for name, each in executed.items()}
    return result


def _grow(world: World, what: str) -> None:
    """Change drag of the air, friction of all surfaces or mass of the pan by `DRIFT`."""
    model, pan = world.model, world.model.body("pan").id
    model.opt.density *= DRIFT if what == "drag" else 1.0
    model.geom_friction[:, 0] *= DRIFT if what == "friction" else 1.0
    model.body_mass[pan] *= DRIFT if what == "mass" else 1.0
    model.body_inertia[pan] *= DRIFT if what == "mass" else 1.0


def _kept(record: Record) -> dict[str, Any]:
    """Part of a record that a result keeps."""
    return {"kind": record.kind, "ret": record.ret, **_outcome(record.truth or {}, record.fault)}


def _outcome(truth: Truth, fault: str) -> dict[str, Any]:
    return {
        "landed": truth["caught"] and truth["flipped"],
        "true_flip": truth["true_flip"],
        "angle_deg": truth["angle_deg"],
        "apex": truth["apex"],
        "miss": math.hypot(*truth["landing_error"]),
        "peak_qd": truth["peak_qd"],
        "elbow_speed": truth["peak_elbow_speed"],
        "forearm_speed": truth["peak_forearm_speed"],
        "beyond_no_load": truth["beyond_no_load"],
        "fault": fault,
    }


def _fires(returns: Sequence[float | None]) -> int | None:
    """Rollout at which the paper's rule stops, after enough good returns in a row, or None."""
    wanted, level = FIRES
    good = [(ret or 0.0) >= level for ret in returns]
    ends = range(wanted, len(good) + 1)
    return next((end for end in ends if all(good[end - wanted : end])), None)


def _k33(policy: Policy) -> list[float]:
    """Vertical stiffness sum_i h_i K_i,33 at PROFILE evenly spaced times [1/s^2]."""
    t = np.linspace(0.0, policy.basis.duration, PROFILE)
    return (activations(policy.basis, t) @ policy.stiffness[:, 2, 2]).tolist()


def _paths(environment: Environment, policy: Policy) -> dict[str, Any]:
    """Paths of pan and pancake in a rollout of a policy."""
    rollout, _ = environment.run(policy)
    return {"pan": _plain(rollout.tool), "pancake": _plain(rollout.body)}


def _plain(path: EndEffectorPath | BodyPath) -> dict[str, Any]:
    return {
        "t": path.t.round(4).tolist(),
        "position": path.position.round(5).tolist(),
        "quat_xyzw": path.quat_xyzw.round(6).tolist(),
    }


def jobs(scale: Scale) -> list[Job]:
    """Sessions of the chapter; "quick" is the same code with few seeds and tiny budgets."""
    quick = scale == "quick"
    seeds = TUNING if quick else HELD_OUT
    one = slice(1 if quick else None)  # only the first of several items in "quick"
    series = 2 if quick else 3  # demonstrations
    # The paper's rollouts do not include reproductions of demonstrations that are not chosen.
    budget = series - 1 + (3 if quick else 50)
    retests = {"retests": 1 if quick else 30}
    common = {"demonstrations": series, "repeats": 1 if quick else 3}
    hindsight = {
        **common,
        "name": "hindsight",
        "changes": {**retests, **({"budget": 4} if quick else {})},
    }
    paper = {**common, "name": "paper", "pitch_rate": NOVICE}
    conditions = dict(list(CONDITIONS.items())[one])
    changes = {"retests": 1 if quick else 10, "budget": budget, "confirm": 0}
    wanted: list[Job] = []

    def add(study: str, some: Sequence[int], **arguments: object) -> None:
        for seed in some:
            wanted.append(Job(study, f"seed-{seed}", session, {"seed": seed, **arguments}))

    for seed in seeds:
        add(HINDSIGHT, [seed], **hindsight, carried=conditions, keep_paths=seed == seeds[0])
    for seed in seeds[one]:
        add(PAPER, [seed], **paper, changes=changes, keep_paths=seed == seeds[0])
    for variant in LESS[2 if quick else 0 :]:
        some = {**changes, "variant": variant}
        add(f"{ABLATION}{variant}", seeds[:8][one], **paper, changes=some)
    return wanted
