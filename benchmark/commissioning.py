# SPDX-License-Identifier: Apache-2.0
"""How well simulated arms that differ from their model measure themselves, and what it is worth.

    python -m benchmark.commissioning [--first 141] [--arms 20] [--parts measure teach ...]

Each seed, from the first on, is another arm. All runs in one process; see docs/commissioning.md.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.spoilt_laboratories import SPOILT, Laboratory
from benchmark.terminal import options
from hardware_sim.demonstrator import Demonstrator, Target
from hardware_sim.scenes import scene_type
from hardware_sim.scenes.markers import Markers
from hardware_sim.sensors import MocapSettings
from hardware_sim.settings import WorldSettings
from hardware_sim.world import World
from wam_power_ros import rotations
from wam_power_ros.cli.commission_command import setup_text
from wam_power_ros.commissioning.acceptance import Finding, notes, refusals
from wam_power_ros.commissioning.excitation import Excitation, excitation
from wam_power_ros.commissioning.measurement import Commissioned, Recording, analyse
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.feasibility import simulate_policy
from wam_power_ros.control.joint_references import interpolated
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.learning.policy import Policy, with_id
from wam_power_ros.params import overlay
from wam_power_ros.params.overlay import Setup
from wam_power_ros.practice.practice import Practice
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.task import Flip

CAMERAS = MocapSettings(rate=120.0, noise=3e-4, dropout=0.01)
WARMER = 0.1  # share by which each joint's friction has changed when the result is checked
HAND_SPEED, RADIUS = 0.13, 0.1  # [m/s], [m] of the circle along which a hand moves the tool
BUDGET, RETESTS = 50, 30
PARTS = ("measure", "teach", "peaks", "learn", "spoilt")


class Circle:
    """A circle of the tool in a vertical plane, at a constant speed, from rest to rest."""

    turns, ease = 2.0, 0.5  # [1], [s] in which the speed is reached

    @property
    def end(self) -> float:
        """See `Script`."""
        return self.turns * 2.0 * np.pi * RADIUS / HAND_SPEED + self.ease

    def target(self, t: float, position: np.ndarray, rotation: np.ndarray) -> Target:
        """See `Script`."""
        rate = HAND_SPEED / RADIUS
        started = min(t, self.ease)
        angle = rate * (started**2 / (2.0 * self.ease) + max(t - self.ease, 0.0))
        speed = HAND_SPEED * started / self.ease
        if t >= self.end:
            speed = 0.0
        c, s = np.cos(angle), np.sin(angle)
        along, up = rotation[:, 0] * [1, 1, 0], np.array([0.0, 0.0, 1.0])
        along = along / np.linalg.norm(along)
        place = position + RADIUS * (s * along + (1.0 - c) * up)
        return Target(place, rotation, speed * (c * along + s * up), np.zeros(3))


def hidden_world(seed: int) -> World:
    """World of the arm of a seed."""
    return World(scene_type("flip"), WorldSettings(unknown="lab"), seed)


def plain_arm(world: World) -> Arm:
    """The arm as its URDF describes it."""
    return Arm(world.urdf, world.settings.model_joint_names)


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


def moved(seed: int) -> tuple[World, Arm, Laboratory, str, np.ndarray]:
    """Let the arm of a seed move; returns its world and model, and what was recorded of it."""
    world = World(Markers, WorldSettings(unknown="lab"), seed, CAMERAS)
    environment = Environment(world)
    settled(environment, "commission", world.home)
    arm = plain_arm(world)
    plan = excitation(arm, environment.controller.limits, world.home, np.random.default_rng(0))
    made, fault, peak = recorded(environment, plan)
    return world, arm, Laboratory(plan, made, world.hidden.payload), fault, peak


def analysed(arm: Arm, lab: Laboratory) -> Commissioned:
    """What a laboratory finds of its arm and its body that it takes to lie flat."""
    return analyse(arm, lab.plan, lab.recorded, lab.payload, lab.gravity_added, flat=True)


def commissioned(seed: int) -> tuple[Setup, dict[str, Any]]:
    """Commission the arm of a seed; returns its set-up and figures."""
    world, arm, lab, fault, peak = moved(seed)
    found, hidden, plan = analysed(arm, lab), world.hidden, lab.plan
    c, seen = found.arm.corrections, found.cameras
    assert seen is not None
    nominal = World(Markers, WorldSettings(), 0).model
    pan = world.model.body("pan").id
    mass, centre = world.model.body_mass[pan], world.model.body_ipos[pan]
    moment = mass * centre - nominal.body_mass[pan] * nominal.body_ipos[pan]
    figures = {
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
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.yaml"
        file.write_text(setup_text(arm, overlay.setup(), found))
        return overlay.setup([str(file)], simulated=True), figures


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


def laboratories(seed: int, spoil: str) -> Iterator[dict[str, Any]]:
    """Verdicts on the arm of a seed, ordinary and in a laboratory that is spoilt.

    A note counts if it would not be there otherwise. That on the last zero always is, and counts
    where the body is not flat: nothing that is measured tells the two apart.
    """
    _, arm, lab, fault, _ = moved(seed)
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
    row = {"seed": seed, "spoilt": spoilt, "result": result, "wrong": False, **figures}
    row["wrong"] = not (refused or told) if spoilt else bool(refused)
    return row | {"because": refused or [str(each) for each in told]}


def settled(environment: Environment, name: str, q: np.ndarray, ticks: int = 200) -> None:
    """Place the arm and let it come to rest in a hold."""
    environment.place(f"{name}-quiet", q)
    environment.world.release()
    for _ in range(ticks):
        environment.tick()


def hands_off(environment: Environment) -> float | str:
    """Largest travel of the tool within 3 s of gravity compensation, of 4 postures [mm]."""
    world, rng, worst = environment.world, np.random.default_rng(5), 0.0
    for number in range(4):
        turned = np.deg2rad(20.0) * rng.uniform(-1.0, 1.0, world.n)
        settled(environment, f"off-{number}", world.home + (turned if number else 0.0), 300)
        try:
            environment.controller.set_gravity_compensation(True)
        except ControllerError:
            return "refused"
        start = world.tool_pose[0]
        for _ in range(1500):
            environment.tick()
        worst = max(worst, float(np.linalg.norm(world.tool_pose[0] - start)))
    return round(worst * 1e3, 2)


def hand_force(environment: Environment) -> list[float]:
    """Mean and 95th percentile of the force of a hand that moves the tool in a circle [N]."""
    world = environment.world
    settled(environment, "hand", world.home)
    environment.controller.set_gravity_compensation(True)
    world.attach(Demonstrator(Circle(), *world.tool_pose))
    forces, begun_ns = [], world.time_ns
    while world.pulled:
        environment.tick()
        t = (world.time_ns - begun_ns) * 1e-9
        if Circle.ease < t < Circle().end - 0.1:
            forces.append(np.linalg.norm(world.data.xfrc_applied[world._tool, :3]))
    return [round(float(f), 2) for f in (np.mean(forces), np.percentile(forces, 95))]


def run_on(environment: Environment) -> float:
    """Distance that the tool moves on after a hand has let it go at `HAND_SPEED` [mm]."""

    class Push(Circle):
        turns, ease = 0.25, 0.3

    world = environment.world
    settled(environment, "push", world.home)
    environment.controller.set_gravity_compensation(True)
    script = Push()
    world.attach(Demonstrator(script, *world.tool_pose))
    for _ in range(world.settings.ticks(script.end - 0.05)):
        environment.tick()
    world.attach(None)
    start = world.tool_pose[0]
    for _ in range(1500):
        environment.tick()
    return round(float(np.linalg.norm(world.tool_pose[0] - start)) * 1e3, 1)


def taught(environment: Environment, seed: int) -> Policy:
    """Policy of a novice's demonstration on this arm."""
    script = environment.world.scene.script(np.random.default_rng([seed, 1]))
    stamps, q = environment.demonstrate(script, "demonstration-0")
    demonstration = Flip.demonstration_of(environment.arm, stamps, q)
    return Flip.policy_of([demonstration], "demonstration-1")


def peaks(environment: Environment, policy: Policy) -> list[float]:
    """Real over predicted highest speed of elbow (forearm included) and tool in a rollout."""
    told = simulate_policy(environment.arm, environment.controller.settings, policy)
    world, core, truth = environment.world, environment.controller, np.zeros(2)
    environment.place("peaks-quiet", policy.q_start)
    core.load(policy)
    core.move_to_start()
    while not core.ready:
        environment.tick()
    core.execute()
    world.release()
    arm = plain_arm(world)
    while core.mode is Mode.ROLLOUT:
        guarded, tool = arm.speeds(world._q, world._qd)
        truth = np.maximum(truth, [max(guarded), tool])
        environment.tick()
    return [
        round(float(a / b) - 1.0, 4)
        for a, b in zip((told.elbow_peak, told.tool_peak), truth, strict=True)
    ]


def session(seed: int, setup: Setup, policy: Policy | None = None) -> dict[str, Any]:
    """Learn the flip on the arm of a seed, from a demonstration or from a policy."""
    environment = Environment(hidden_world(seed), setup=setup)
    own = taught(environment, seed) if policy is None else policy
    practice = Practice(
        preset("flip", "", budget=BUDGET, retests=RETESTS), {}, [own], seed, environment
    )
    rows = list(environment.practise(practice))
    learning = [row for row in rows if row.kind != "retest"]

    def true(row: Record) -> bool:
        outcome = row.truth or {}
        return bool(outcome.get("flipped") and outcome.get("caught"))

    retests = [row for row in rows if row.kind == "retest"]
    return {
        "rollouts": len(learning),
        "confirmed": len(retests) > 0 and len(learning) < BUDGET,
        "true": f"{sum(map(true, retests))}/{len(retests)}",
        "first": true(rows[0]),
    }


def rehearsed(seed: int) -> Policy:
    """Policy that was learnt in a simulation of the arm as its URDF describes it."""
    environment = Environment(World(scene_type("flip"), WorldSettings(), seed))
    own = taught(environment, seed)
    settings = preset("flip", "", budget=BUDGET, retests=0)
    practice = Practice(settings, {}, [own], seed, environment)
    for _ in environment.practise(practice):
        pass
    best = practice.best
    assert best is not None
    return with_id(best.policy, "demonstration-1")


def rows(seed: int, parts: list[str]) -> Iterator[dict[str, Any]]:
    """Figures of one arm."""
    if "spoilt" in parts:
        yield from laboratories(seed, [*SPOILT][seed % len(SPOILT)])
    if parts == ["spoilt"]:
        return
    setup, figures = commissioned(seed)
    if "measure" in parts:
        yield figures
    strong = setup.changed({"torque_controller": {"teaching_friction": 0.8}})
    setups = {"plain": overlay.setup(), "commissioned": setup, "80 %": strong}
    arms = {name: Environment(hidden_world(seed), setup=each) for name, each in setups.items()}
    for name, arm in arms.items() if "teach" in parts else ():
        off = hands_off(arm)
        told = off == "refused"
        yield {
            "seed": seed,
            "set-up": name,
            "hands off mm": off,
            "hand N": [] if told else hand_force(arm),
            "runs on mm": None if told else run_on(arm),
        }
    for name in ("plain", "commissioned") if "peaks" in parts else ():
        yield {"seed": seed, "set-up": name, "peaks": peaks(arms[name], taught(arms[name], seed))}
    if "learn" in parts:
        for name in ("plain", "commissioned"):
            yield {"seed": seed, "set-up": name, **session(seed, setups[name])}
        carried = session(seed, setup, rehearsed(seed))
        yield {"seed": seed, "set-up": "carried over", **carried}


def main() -> int:
    """Print one line of JSON for each result; returns 1 if a laboratory is judged wrongly."""
    given, wrong = options(__doc__, first=141, arms=20, parts=[*PARTS]), 0
    for seed in range(given.first, given.first + given.arms):
        begun = time.monotonic()
        for each in rows(seed, given.parts):
            print(json.dumps(each), flush=True)
            wrong += each.get("wrong", False)
        print(f"# {time.monotonic() - begun:.0f} s", flush=True)
    print(f"# {wrong} laboratories were judged wrongly")
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
