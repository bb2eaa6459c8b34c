# SPDX-License-Identifier: Apache-2.0
"""A toss without physics, for tests: a demonstrated policy, and how a trial ends."""

import math
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning.learner import generator_state
from wam_power_ros.learning.policy import Basis, Policy, from_json, to_json
from wam_power_ros.learning.power import Power
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.practice import session
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session_log import Line, Record, Trial
from wam_power_ros.practice.settings import SessionSettings, preset
from wam_power_ros.tasks.flip.parametrization import (
    TURN_OF_AMPLITUDE,
    TURN_OF_TEMPO,
    TURN_OF_WRIST,
)
from wam_power_ros.tasks.flip.settings import FlipSettings
from wam_power_ros.tasks.task import Assessment


def demonstrated_policy(id: str = "flick-1", count: int = 8, seed: int = 0) -> Policy:
    """A policy with coupled, asymmetric stiffness matrices; like one fitted to a demonstration."""
    rng = np.random.default_rng(seed)
    raw = rng.normal(size=(count, 3, 3))
    vectors = np.linalg.qr(raw)[0]
    values = rng.uniform(150.0, 500.0, size=(count, 3))
    stiffness = np.einsum("nij,nj,nkj->nik", vectors, values, vectors)
    skew = rng.normal(scale=10.0, size=(count, 3, 3))
    return Policy(
        id=id,
        basis=Basis(count, 0.85, 0.0028),
        stiffness=stiffness + 0.5 * (skew - np.swapaxes(skew, 1, 2)),
        attractors=rng.normal((0.6, 0.0, 0.5), 0.05, size=(count, 3)),
        damping=32.0,
        orientation_reference=np.array([0.0, 0.0, 0.0, 1.0]),
        rotation_attractors=rng.normal(scale=0.2, size=(count, 3)),
        rotation_stiffness=400.0,
        rotation_damping=36.0,
        q_start=np.radians([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0]),
    )


CANDIDATES = [demonstrated_policy("flick-1", seed=1), demonstrated_policy("flick-2", seed=2)]


def learner_state(learner: Power) -> list[Any]:
    """Everything that decides what the learner asks for next, as data for JSON."""
    known = learner._rollouts
    return [known.z.tolist(), known.returns.tolist(), generator_state(learner._rng)]


class AnyArm:
    """An arm on which every policy is feasible, but for those that `refuse` names a reason for."""

    def __init__(self, refuse: Callable[[Policy], str] = lambda policy: "") -> None:
        self._refuse = refuse

    def infeasible(self, policy: Policy, limit_stops: int = 0) -> Fault | None:
        """See `practice.ArmModel`."""
        why = self._refuse(policy)
        return Fault(FaultKind.TOOL_SPEED, why) if why else None

    def simulate(self, policy: Policy) -> None:
        """See `practice.ArmModel`."""


ANY_ARM = AnyArm()


def practice_of(
    candidates: Sequence[Policy],
    settings: SessionSettings,
    seed: int,
    log: Sequence[Line] = (),
    arm: AnyArm = ANY_ARM,
) -> Practice:
    """The practice of a session of the flip."""
    return Practice(settings, {}, candidates, seed, arm, log)


def practice_in(folder: Path) -> Practice:
    """The practice of a session as it is on disk; nothing is locked."""
    found = session.read(folder)
    header = found.header
    policies = [
        from_json((folder / "candidates" / f"{name}.json").read_text())
        for name in header.candidates
    ]
    return practice_of(policies, header.settings, header.seed, found.log)


def next_trial(practice: Practice) -> str:
    """What is executed next, as text for comparison; why nothing is at the end."""
    trial = practice.next_trial()
    if trial is None:
        return practice.stopped
    return f"{trial.kind} {trial.attempt} {trial.z.tolist()} {to_json(trial.policy)}"


def record_of(number: int = 1, **changes: Any) -> Record:  # noqa: ANN401
    """Record of a successful run of a mean, but for what is changed."""
    values: dict[str, Any] = {"kind": "mean", "demonstration": "one", "ret": 0.5, "success": True}
    values |= {"attempt": 1, "terms": {}, "why": "", "note": "", "observation": None, "fault": ""}
    values |= {"bag": "", "truth": None, "clock": {}, "generator": {}, "z": [0.0, 1.0]} | changes
    learnt = values["ret"] is not None and values["kind"] != "retest"
    values |= {"learnt": learnt, "z_corrected": values["z"] if learnt else None}
    return Record(number=number, id=f"trial-{number:04d}", theta=values["z"], **values)


def at_rest(id: str, end: float, seen: np.ndarray) -> tuple[EndEffectorPath, BodyPath]:
    """A pan that rests until a time and a pancake that rests in it, seen at some times."""
    t, level = np.arange(0.0, end, 0.01), [0.0, 0.0, 0.0, 1.0]
    pan = EndEffectorPath(id, t, np.tile([0.6, 0.0, 0.5], (len(t), 1)), [level] * len(t))
    position = np.tile([0.6, 0.0, 0.503], (len(seen), 1))
    return pan, BodyPath(id, seen, position, np.tile(level, (len(seen), 1)))


def toss(trial: Trial, task: FlipSettings, noise: float = 0.1) -> Assessment:
    """Outcome of a trial: a function of its id and policy alone, like one of the stand-in.

    Turning grows along one direction of z and landing moves away with it; the catch shift (or the
    last attractor) brings the pan under the pancake again. Both amplitudes and the tempo turn it
    further.
    """
    rng = np.random.default_rng(zlib.crc32(trial.id.encode()))
    z = trial.z
    along = np.sin(np.arange(len(z)) + 1.0) / math.sqrt(len(z))
    shift = -2 if task.variant == "planar" else -1  # catch shift, or the last attractor
    along[shift] = 0.0
    strength = float(along @ z)
    further = 0.0
    if task.variant == "planar":
        strength -= float(along[-4:] @ z[-4:])
        further = TURN_OF_AMPLITUDE * task.noise.amplitude * z[-4]
        further += TURN_OF_WRIST * task.noise.wrist_amplitude * z[-3]
        further += TURN_OF_TEMPO * task.noise.tempo * z[-1]
    angle = 1.6 + 0.5 * strength + further + 0.3 * noise * rng.normal()
    error = 0.12 + 0.05 * strength - 0.016 * z[shift] + 0.1 * noise * rng.normal()
    caught = abs(error) < 0.05 and angle > 1.2
    flipped = math.pi / 2 < angle < 1.5 * math.pi
    rotation = max(0.0, 1.0 - abs(angle - math.pi) / math.pi)
    terms = {"rotation": 0.5 * rotation, "landing": 0.5 * rotation**2 * math.exp(-abs(error) / 0.3)}
    flight = {
        "tossed": True,
        "seen": True,
        "angle": angle,
        "apex": 0.4,
        "landing_error": [error, 0.0, 0.0],
        "catch_pitch": 0.0,
        "resting": caught,
        "flipped": flipped,
    }
    ret = sum(terms.values())
    success = ret >= task.success_return and (
        task.success_angle == 0.0 or (caught and flipped and angle >= task.success_angle)
    )
    return Assessment(ret, terms, flight, success)


def session_of(
    folder: Path,
    settings: SessionSettings,
    rollouts: int,
    seed: int = 0,
    demonstrations: Sequence[str] = (),
) -> Path:
    """A session on disk with its first rollouts, whose bags are named and not there."""
    policies = [demonstrated_policy()]
    practice = practice_of(policies, settings, seed)
    begun = session.Session.begin(folder, settings, seed, policies, demonstrations=demonstrations)
    with begun as written:
        while len(practice.records) < rollouts and (trial := practice.next_trial()) is not None:
            outcome, bag = toss(trial, practice.task.settings), f"rollout_{trial.id}"
            written.append(practice.learn_assessed(trial, outcome, bag=bag))
    return folder


def some_records(count: int) -> list[Record]:
    """Records of the first rollouts of a session of the flip."""
    practice = practice_of([demonstrated_policy()], preset("flip", budget=count, confirm=0), seed=0)
    while len(practice.records) < count and (trial := practice.next_trial()) is not None:
        practice.learn_assessed(trial, toss(trial, practice.task.settings))
    return [*practice.records]
