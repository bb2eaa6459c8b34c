# SPDX-License-Identifier: Apache-2.0
"""`wam-power commission`: the arm measures itself and the cameras, and writes a set-up file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wam_power_ros import durable_files, rotations
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.commands import read_commands, read_set_points
from wam_power_ros.bags.reader import read_states
from wam_power_ros.bags.table import body_poses
from wam_power_ros.cli.launcher import Devices, UsageError, launch, short_path, timestamp
from wam_power_ros.cli.plan import RECORDER, SIMULATION, TRACKER, Plan
from wam_power_ros.commissioning.acceptance import notes, refusals
from wam_power_ros.commissioning.excitation import Excitation, excitation
from wam_power_ros.commissioning.identification import tool_centre
from wam_power_ros.commissioning.measurement import Recording, analyse
from wam_power_ros.commissioning.report import report, servo_line, servo_text, setup_text
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.corrections import Corrections
from wam_power_ros.control.servo_response import servo_of
from wam_power_ros.params import overlay
from wam_power_ros.params.torque_controller_params import TorqueControllerParams

MOVEMENT = "movement.npz"
SCENE = "markers"  # of the stand-in
LOG_PERIOD = 30.0  # [s] between two lines about the movement under way
WARNING = "Tool below 1.2 m/s: nobody within reach, a hand on the pendant. "


def commission(
    tool_mass: float | None, flat: bool, output: Path | None, folder: Path | None, devices: Devices
) -> int:
    """Move the arm, analyse the recording, print what was found and write a set-up file."""
    folder = (folder or Path("commissioning") / timestamp()).resolve()
    setup = devices.parameters(folder=folder)
    setup = setup.changed({RECORDER: {"stem": "commissioning"}, SIMULATION: {"scene": SCENE}})
    controller = TorqueControllerParams.from_setup(setup)
    if controller.output == "pose":
        text = "output = pose: only the delay of positions is measured; commission the arm with"
        raise UsageError(f"{text} --config position if it takes them, or give servo_delay by hand")
    gravity_added = controller.driver_compensates_gravity
    arm = setup.arm()
    if arm is None:
        raise UsageError("the set-up has no URDF file of the arm: choose one with --config")
    arm = arm.corrected(Corrections.from_values(arm.n))
    movement, status = folder / MOVEMENT, 0
    if not movement.exists():
        status = _move(arm, setup, controller, movement, devices)
    bags = sorted((folder / "bags").glob("commissioning*"))
    if status or not bags:
        movement.unlink(missing_ok=True)
        return status or 1
    if controller.output != "torque":
        return _servo(arm, bags[-1], setup, output or folder / "arm.yaml")
    with np.load(movement) as file:
        plan = Excitation(*(file[name] for name in ("t", "q", "rests", "sweeps")))
    recorded = _recording(bags[-1], setup)
    given = None if tool_mass is None else tool_mass - tool_centre(arm)[0].mass
    found = analyse(arm, plan, recorded, given, gravity_added, flat)
    if gravity_added:
        print("The driver adds gravity by a model of its own, which is taken for that of the URDF.")
    for line in report(arm, found):
        print(line)
    for note in notes(arm, found):
        print(f"note: {note}")
    if reasons := refusals(arm, found, setup[TRACKER]["latency_offset"]):
        for reason in reasons:
            print(f"not usable: {reason}")
        print("Nothing was written.")
        return 1
    _write(output or folder / "arm.yaml", setup_text(arm, setup[TRACKER], found))
    return 0


def _write(file: Path, text: str) -> None:
    """Write a set-up, and keep the one that is there."""
    if file.exists():
        kept = file.with_name(f"{file.name}.{timestamp()}")
        file.rename(kept)
        print(f"{short_path(file)} existed: kept as {short_path(kept)}")
    durable_files.replace(file, text)
    print(f"Written: {short_path(file)}. Give it last: --config {short_path(file)}")


def _servo(arm: Arm, path: Path, setup: overlay.Setup, file: Path) -> int:
    """Measure how an arm that takes positions follows them; write it; returns the exit status."""
    bag, names = Bag(path), setup.joint_names
    states = read_states(bag, names)
    stamps, sent = read_set_points(bag, _command_topic(setup), names)
    origin = states.stamps[0]
    try:
        t, sent_t = (1e-9 * (each - origin) for each in (states.stamps, stamps))
        found = servo_of(t, states.q, sent_t, sent)
    except ValueError as error:
        print(f"not usable: {error}\nNothing was written.")
        return 1
    print(servo_line(found))
    _write(file, servo_text(arm, found))
    return 0


def _move(
    arm: Arm,
    setup: overlay.Setup,
    controller: TorqueControllerParams,
    movement: Path,
    devices: Devices,
) -> int:
    """Plan the movement, let the arm execute it and record it; returns the exit status."""
    from wam_power_ros.console.replay import replay
    from wam_power_ros.params.resources import robot_description

    limits = controller.controller(robot_description(controller.urdf)).limits
    home = np.array(setup[SIMULATION]["home"])  # of every arm, simulated or not
    rng = np.random.default_rng(0)
    if controller.output == "torque":
        plan = excitation(arm, limits, home, rng)
    else:
        plan = excitation(arm, limits, home, rng, 1, (10.0, 10.0))
    movement.parent.mkdir(parents=True, exist_ok=True)
    np.savez(movement, t=plan.t, q=plan.q, rests=plan.rests, sweeps=plan.sweeps)
    planned = Plan(movement.parent, setup, devices.stand_ins, (TRACKER,))
    with launch(planned) as launcher, launcher.robot() as robot:
        robot.link.log_period = LOG_PERIOD
        robot.await_recorder()  # of every state: the first rest counts
        person = not devices.stand_ins
        return replay(robot, "the commissioning", plan.t, plan.q, 1.0, person, warning=WARNING)


def _recording(path: Path, setup: overlay.Setup) -> Recording:
    """Read states, torques and poses of a bag."""
    bag, names = Bag(path), setup.joint_names
    states = read_states(bag, names)
    tau = read_commands(bag, _command_topic(setup), states.stamps, names)
    origin, poses = states.stamps[0], dict(body_poses(bag, f"/{setup[TRACKER]['body']}/state"))
    known = np.array(sorted(poses), dtype=np.int64)
    last = np.unique(np.searchsorted(known, states.stamps, side="right") - 1)  # up to each state
    stamps = known[last[last >= 0]]
    pose = np.array([poses[stamp] for stamp in stamps.tolist()]).reshape(-1, 7)
    return Recording(
        t=(states.stamps - origin) * 1e-9,
        q=states.q,
        tau=tau,
        seen_t=(stamps - origin) * 1e-9,
        position=pose[:, :3],
        rotation=rotations.matrix(pose[:, 3:]) if len(pose) else np.empty((0, 3, 3)),
    )


def _command_topic(setup: overlay.Setup) -> str:
    topic: str = setup["torque_controller"]["command_topic"]
    return topic if topic.startswith("/") else f"/{topic}"
