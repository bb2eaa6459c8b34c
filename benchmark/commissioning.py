# SPDX-License-Identifier: Apache-2.0
"""How well simulated arms that differ from their model measure themselves.

    python -m benchmark.commissioning [--first 141] [--arms 20] [--parts measure] [--camera]
    python -m benchmark.commissioning --first 5400 --parts spoilt

Each seed, from the first on, is another arm. `--camera` films tags on the tool in place of markers.
`spoilt` judges each twice, as it is and in a laboratory in which something is wrong. All runs in
one process; see docs/evidence/commissioning.md.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmark.spoilt_laboratories import SPOILT, Laboratory
from benchmark.terminal import options
from hardware_sim.scenes.markers import Markers
from hardware_sim.sensors import MocapSettings
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World
from wam_power_ros import rotations
from wam_power_ros.commissioning.acceptance import Finding, notes, refusals
from wam_power_ros.commissioning.excitation import Excitation, excitation
from wam_power_ros.commissioning.measurement import Commissioned, Recording, analyse
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.joint_references import interpolated
from wam_power_ros.control.modes import Mode
from wam_power_ros.in_process.environment import Environment

CAMERAS = MocapSettings(rate=120.0, noise=3e-4, dropout=0.01)
TAGS = MocapSettings(camera=True)
WARMER = 0.1  # share by which each joint's friction has changed when the result is checked
PARTS = ("measure", "spoilt")


def recorded(environment: Environment, plan: Excitation) -> tuple[Recording, str, np.ndarray]:
    """Let the arm execute the movement; friction changes before the part that checks the result.

    Returns:
        Recording, fault or "", and highest speeds of elbow and tool [m/s].
    """
    world, core = environment.world, environment.controller
    rows: list[tuple[int, np.ndarray, np.ndarray]] = []
    poses = []
    rng = np.random.default_rng([world.seed, 7])
    changed = world.settings.ticks(float(plan.sweeps[1, 1]))
    peak = np.zeros(2)
    core.start_replay(interpolated(plan.t, plan.q, core.settings.period))
    while core.mode is Mode.REPLAY:
        if len(rows) == changed:
            world.model.dof_frictionloss[: world.n] *= 1.0 + WARMER * rng.uniform(-1, 1, world.n)
        sample = world.joint_state()
        tau = core.step(sample.stamp_ns, sample.q, sample.qd)
        rows.append((sample.stamp_ns, sample.q, tau.copy()))
        world.step(tau)
        poses += world.mocap_frames()
        guarded, tool = core.arm.speeds(sample.q, sample.qd)
        peak = np.maximum(peak, [max(guarded), tool])
    stamps, q, torques = (np.array(column) for column in zip(*rows, strict=True))
    made = Recording(
        t=stamps * 1e-9,
        q=q,
        tau=torques,
        seen_t=np.array([pose.stamp_ns for pose in poses]) * 1e-9,
        position=np.array([pose.position for pose in poses]),
        rotation=rotations.matrix(np.array([pose.quat_xyzw for pose in poses])),
    )
    return made, "" if core.latched is None else core.latched.text, peak


def moved(
    seed: int, eyes: MocapSettings = CAMERAS
) -> tuple[World, Arm, Laboratory, str, np.ndarray]:
    """Let the arm of a seed move; its world and URDF's model, and see `recorded`."""
    world = World(Markers, WorldSettings(unknown="lab"), seed, eyes)
    environment = Environment(world)
    environment.place("commission-quiet", world.home)
    world.release()
    for _ in range(200):
        environment.tick()
    arm = Arm(world.urdf, world.settings.model_joint_names)
    plan = excitation(arm, environment.controller.limits, world.home, np.random.default_rng(0))
    made, fault, peak = recorded(environment, plan)
    return world, arm, Laboratory(plan, made, world.hidden.payload), fault, peak


def analysed(arm: Arm, lab: Laboratory) -> Commissioned:
    """What a laboratory finds of its arm and its body that it takes to lie flat."""
    return analyse(arm, lab.plan, lab.recorded, lab.payload, lab.gravity_added, flat=True)


def measured(seed: int, eyes: MocapSettings = CAMERAS) -> Iterator[dict[str, Any]]:
    """How far what the arm of a seed finds is from the truth."""
    world, arm, lab, fault, peak = moved(seed, eyes)
    found, hidden, plan = analysed(arm, lab), world.hidden, lab.plan
    c, seen = found.arm.corrections, found.cameras
    assert seen is not None
    nominal = World(Markers, WorldSettings(), 0).model
    pan = world.model.body("pan").id
    mass, centre = world.model.body_mass[pan], world.model.body_ipos[pan]
    moment = mass * centre - nominal.body_mass[pan] * nominal.body_ipos[pan]
    yield {
        "seed": seed,
        "fault": fault,
        "seconds": round(float(plan.t[-1]), 1),
        "peaks": peak.round(2).tolist(),
        "check mm, degrees": [
            round(seen.check_position * 1e3, 2),
            round(float(np.rad2deg(seen.check_rotation)), 3),
        ],
        "zeros": float(np.rad2deg(np.abs(c.zeros - hidden.zeros)[1:-1].max()).round(3)),
        "last zero": float(np.rad2deg(np.abs(c.zeros - hidden.zeros)[-1]).round(3)),
        "latency ms": round(abs(seen.latency) * 1e3, 2),
        "delay periods": round(found.arm.loop_delay / 0.002 - world.settings.command_delay_ticks),
        "before": [round(x, 3) for x in (found.before.rest, found.before.slow, found.before.fast)],
        "after": [round(x, 3) for x in (found.after.rest, found.after.slow, found.after.fast)],
        "scales %": float(100 * np.abs(c.torque_scales - hidden.motors)[1:6].max().round(4)),
        "friction %": float(
            100 * np.abs(c.coulomb_friction / (arm.friction * hidden.friction) - 1)[:6].max()
        ),
        "centre mm": ((c.payload[1:] - moment) / mass * 1e3).round(1).tolist(),
        "centre sd mm": (found.arm.moment_sd / mass * 1e3).round(1).tolist(),
        "refused": [str(each) for each in refusals(arm, found, 0.0)],
        "notes": [str(each) for each in notes(arm, found)],
    }


def judged(arm: Arm, lab: Laboratory) -> tuple[dict[str, float], list[str], list[Finding]]:
    """What a laboratory measures, why it refuses to write it, and what it notes."""
    try:
        found = analysed(arm, lab)
    except ValueError as error:
        return {}, [str(error)], []
    seen = found.cameras
    assert seen is not None
    figures = {
        "fit mm": 1e3 * seen.fit_position,
        "fit degrees": np.rad2deg(seen.fit_rotation),
        "check mm": 1e3 * seen.check_position,
        "check degrees": np.rad2deg(seen.check_rotation),
        "sweeps mm": 1e3 * seen.sweep_position,
        "sweeps degrees": np.rad2deg(seen.sweep_rotation),
        "last zero": np.rad2deg(seen.frame.zeros[-1]),
        "latency ms": 1e3 * seen.latency,
        "kg told": found.arm.corrections.payload[0],
        "kg felt": found.arm.felt_payload,
        "N m at rest": found.after.rest,
    }
    refused = [str(each) for each in refusals(arm, found, 0.0)]
    return {name: round(float(x), 3) for name, x in figures.items()}, refused, notes(arm, found)


def laboratories(seed: int, eyes: MocapSettings = CAMERAS) -> Iterator[dict[str, Any]]:
    """Verdicts on the arm of a seed, ordinary and in a laboratory that is spoilt.

    A note counts if it would not be there otherwise. That on the last zero always is, and counts
    where the body is not flat: nothing that is measured tells the two apart.
    """
    spoil = [*SPOILT][seed % len(SPOILT)]
    _, arm, lab, fault, _ = moved(seed, eyes)
    figures, refused, ordinary = judged(arm, lab)
    known = {note.quantity for note in ordinary}
    yield verdict(seed, "", figures, [*filter(None, [fault]), *refused], ordinary)
    figures, refused, told = judged(arm, SPOILT[spoil](lab, np.random.default_rng([seed, 0x5B])))
    if spoil.startswith("plate"):
        known = {name for name in known if "--flat" not in name}
    yield verdict(seed, spoil, figures, refused, [x for x in told if x.quantity not in known])


def verdict(
    seed: int, spoilt: str, figures: dict[str, float], refused: list[str], told: list[Finding]
) -> dict[str, Any]:
    """Row of a laboratory: "wrong" if it is ordinary and refused, or spoilt and not even noted."""
    result = "refused" if refused else "noted" if told else "written"
    wrong = not (refused or told) if spoilt else bool(refused)
    row = {"seed": seed, "spoilt": spoilt, "result": result, "wrong": wrong, **figures}
    return row | {"because": refused or [str(each) for each in told]}


def main() -> int:
    """Print one line of JSON for each result; returns 1 if a laboratory is judged wrongly."""
    given = options(__doc__, first=141, arms=20, parts=[*PARTS], camera=False)
    eyes, wrong = TAGS if given.camera else CAMERAS, 0
    for seed in range(given.first, given.first + given.arms):
        begun = time.monotonic()
        for part in given.parts:
            for each in (measured if part == "measure" else laboratories)(seed, eyes):
                print(json.dumps(each), flush=True)
                wrong += each.get("wrong", False)
        print(f"# {time.monotonic() - begun:.0f} s", flush=True)
    print(f"# {wrong} laboratories were judged wrongly")
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
