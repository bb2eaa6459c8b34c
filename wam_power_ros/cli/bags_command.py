# SPDX-License-Identifier: Apache-2.0
"""`wam-power bags`: inspect and import recordings."""

from __future__ import annotations

import argparse
import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wam_power_ros import installed
from wam_power_ros.cli.launcher import UsageError, short_path, task_stems
from wam_power_ros.cli.parser import add_command, config_option, natural, positive, task_option
from wam_power_ros.cli.session_options import DEFAULT_TASK
from wam_power_ros.durable_files import check_name, printable
from wam_power_ros.params import overlay

if TYPE_CHECKING:
    import numpy as np

    from wam_power_ros.bags import lerobot
    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.bags.quality import Limits, Remark
    from wam_power_ros.bags.reader import States
    from wam_power_ros.bags.takes import Take
    from wam_power_ros.control.arm import Arm

FORMATS = ("table", "lerobot")  # of `export`
FPS = 50  # frames of a set of LeRobot [1/s]: the release of a toss takes about ten of them


def add_to(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    group = add_command(subparsers, "bags", None, "inspect and import recordings")
    add = partial(add_command, group.add_subparsers(metavar="COMMAND"))
    listing = add("list", list_, "print a line for each take: task, duration and outcome")
    listing.add_argument("folder", type=Path, nargs="*", help="of takes (default: the usual ones)")
    shown = add("show", show, "print quality, topics and joints of takes")
    shown.add_argument("bag", type=Path, nargs="+")
    plotted = add("plot", plot, "draw joint angles and speeds of takes, with the arm's limits")
    plotted.add_argument("bag", type=Path, nargs="+")
    plotted.add_argument("--output", type=Path, help=".png or .svg (default: BAG.png)")
    imported = add("import", import_, "make a demonstration of any bag with joint states")
    help_bags = "folder, .mcap, .db3, .csv or .parquet; several that follow each other become one; "
    help_bags += "or the folder of a set of LeRobot"
    imported.add_argument("bag", type=Path, nargs="+", help=help_bags)
    help_part = "only the states between two times since the first [s]"
    imported.add_argument("--part", type=float, nargs=2, metavar=("START", "END"), help=help_part)
    help_joints = "names of the arm's joints in that bag, base to tip"
    imported.add_argument("--joints", nargs="+", default=[], metavar="NAME", help=help_joints)
    imported.add_argument("--topic", default="", help="of the joint states (default: the only one)")
    task_option(imported)
    imported.set_defaults(task=DEFAULT_TASK)
    help_reception = "use the times of reception, where the stamps of the driver are wrong"
    imported.add_argument("--by-reception", action="store_true", help=help_reception)
    help_episode = "number of the episode in a set of LeRobot (default: the only one)"
    imported.add_argument("--episode", type=natural, metavar="N", help=help_episode)
    help_degrees = "the angles of a table or set are in degrees"
    imported.add_argument("--degrees", action="store_true", help=help_degrees)
    imported.add_argument("--output", type=Path, help="new bag (default: TASK_NAME)")
    exported = add("export", export, "write a table or a set of LeRobot of bags or a session")
    exported.add_argument("recorded", type=Path, metavar="BAG|SESSION", nargs="+")
    help_output = "new .csv or .parquet file, or the folder of a set"
    exported.add_argument("--output", type=Path, required=True, help=help_output)
    help_format = "lerobot: a set of LeRobot 3.0, an episode for each bag or rollout"
    exported.add_argument("--format", choices=FORMATS, default=FORMATS[0], help=help_format)
    help_fps = f"frames per second of a set (default: {FPS})"
    exported.add_argument("--fps", type=positive, default=FPS, help=help_fps)
    for command in (shown, plotted, imported, exported):
        config_option(command, "set-up of the arm")


def list_(folder: Sequence[Path]) -> None:
    """Print a line for each take, by its name and description alone."""
    from wam_power_ros.bags import takes

    folders = folder or [Path(name) for name in takes.FOLDERS]
    found = takes.find(folders)
    if not found:
        raise UsageError(f"no bags below {', '.join(map(str, folders))}")
    width, tasks = max(len(printable(path.name)) for path in found), task_stems()
    shown, outcomes = None, dict[Path, str]()
    for path in found:
        if path.parent != shown:
            shown, outcomes = path.parent, _outcomes(path)
            print(f"{printable(short_path(shown.resolve()))}/", flush=True)
        kind = path.resolve().name.partition("_")[0]
        kind = "/".join(sorted(tasks.get(kind, {printable(kind)})))
        note = outcomes.get(path.resolve(), "")
        print(f"{printable(path.name):{width}}  {kind:9}  {_recorded(path)}  {note}".rstrip())


def _recorded(path: Path) -> str:
    """Duration of a recording by its description, or why that cannot be read."""
    from wam_power_ros.bags.bag import information

    try:
        duration = information(path).get("duration")
    except (ValueError, OSError) as error:
        return str(error).removeprefix(printable(path)).lstrip(": ")
    ns = duration.get("nanoseconds") if isinstance(duration, dict) else None
    return f"{1e-9 * ns:4.1f} s" if isinstance(ns, int) else f"{'–':>6}"


def show(bag: Sequence[Path], config: Sequence[str]) -> None:
    """Print what is in takes, each with its grade and the reasons."""
    setup = overlay.setup(config)
    tasks, refused = task_stems(), []
    for path in bag:
        try:
            _show(path, setup.joint_names, setup.arm(), tasks)
        except (ValueError, OSError) as error:
            named = str(error).startswith(printable(path))
            refused.append(str(error) if named else f"{printable(path)}: {error}")
    if refused:
        raise UsageError("\n".join(refused))


def _show(path: Path, names: Sequence[str], arm: Arm | None, tasks: Mapping[str, set[str]]) -> None:
    from wam_power_ros.bags import quality

    take, t, q, remarks = _inspected(path, names, arm, tasks)
    qd, limits = quality.joint_speeds(t, q), _limits(arm)
    print(f"{take.bag.path}: {take.bag.kind}, {_graded(take, remarks)}")
    if outcome := _outcomes(path).get(path.resolve()):
        print(f"  {outcome}")
    speed = (qd**2).sum(axis=1) ** 0.5
    if speed.any():
        print(f"  smoothness {quality.smoothness(speed, t[1] - t[0]):.2f} (spectral arc length)")
    for name, count in take.counts.items():
        lost = f", {take.missing[name]} missing" if take.missing.get(name) else ""
        print(f"  {count:6} {name}{lost}")
    for joint, name in enumerate(names):
        low, high, fastest = q[:, joint].min(), q[:, joint].max(), abs(qd[:, joint]).max()
        of_limit = f", {fastest / limits.qd_max[joint]:.0%} of its limit" if limits else ""
        print(f"  {name}: {low:+.2f} to {high:+.2f} rad, at most {fastest:.2f} rad/s{of_limit}")


def _graded(take: Take, remarks: Sequence[Remark]) -> str:
    """Duration and grade of a take, and below it each remark."""
    from wam_power_ros.bags import quality

    grade = quality.grade(remarks).name.lower()
    return "\n  ".join([f"{take.duration:.2f} s, {grade}", *(remark.text for remark in remarks)])


def plot(bag: Sequence[Path], output: Path | None, config: Sequence[str]) -> None:
    """Draw takes into a file."""
    from wam_power_ros import plotting
    from wam_power_ros.reporting import figures

    setup = overlay.setup(config)
    names, limits = setup.joint_names, _limits(setup.arm())
    movements = {path.resolve().name: _inspected(path, names, None, {})[1:3] for path in bag}
    drawn = figures.joints(movements, names, limits)
    output = output or Path(f"{bag[0].resolve().name}.png")
    if output.suffix not in (".png", ".svg"):
        raise UsageError(f"{output} must end in .png or .svg")
    output.write_bytes(plotting.png(drawn) if output.suffix == ".png" else plotting.svg(drawn))
    print(f"Figure: {output}")


def _inspected(
    path: Path, names: Sequence[str], arm: Arm | None, tasks: Mapping[str, set[str]]
) -> tuple[Take, np.ndarray, np.ndarray, list[Remark]]:
    """A take, its smooth movement t (N,) [s] and q (N, n) [rad], and reasons for its grade.

    A demonstration of a task is judged also as its fit would cut it.
    """
    from wam_power_ros.bags import quality, takes
    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.learning.demonstration import smooth_joints
    from wam_power_ros.learning.policy import DURATION_MAX

    take = takes.read(Bag(path), names)
    t, q = smooth_joints(take.states.stamps, take.states.q)
    remarks = [*take.states.remarks]
    remarks += quality.movement_remarks(t, q, names, _limits(arm))
    remarks += quality.completeness_remarks(take.counts, take.missing, take.ended)
    if arm is not None and take.bag.kind in tasks:
        task = installed.task_type(min(tasks[take.bag.kind]))
        try:
            fitted = task.demonstration_of(arm, take.states.stamps, take.states.q)
        except ValueError as error:
            if quality.grade(remarks) is not quality.Grade.POOR:
                remarks.append(quality.Remark(quality.Grade.POOR, str(error)))
        else:
            remarks += [quality.left_out_remark(*each) for each in fitted.left_out]
            if fitted.duration > DURATION_MAX:
                text = f"a movement of {fitted.duration:.1f} s; at most {DURATION_MAX:g} s can be"
                remarks.append(quality.Remark(quality.Grade.POOR, f"{text} learnt"))
    return take, t, q, remarks


def _limits(arm: Arm | None) -> Limits | None:
    from wam_power_ros.bags.quality import Limits

    return None if arm is None else Limits(arm.q_min, arm.q_max, arm.qd_max)


def _outcomes(path: Path) -> dict[Path, str]:
    """Outcomes of the rollouts beside a bag, from the log of their session; empty without one."""
    from wam_power_ros.practice import session

    folder = path.resolve().parent
    if folder.name != "bags" or not session.Session.exists(folder.parent):
        return {}
    found, outcomes = session.read(folder.parent), {}
    for record in found.records:
        if record.bag:
            ret = "no return" if record.ret is None else f"return {record.ret:.3f}"
            outcomes[folder / record.bag] = f"{found.task.outcome(record)}, {ret}"
    return outcomes


def import_(
    bag: Sequence[Path],
    part: Sequence[float] | None,
    joints: Sequence[str],
    topic: str,
    task: str,
    output: Path | None,
    config: Sequence[str],
    by_reception: bool,
    episode: int | None,
    degrees: bool,
) -> None:
    """Make a demonstration of bags of any recorder; what nothing can be learnt from is not kept."""
    from rich.console import Console

    from wam_power_ros.bags import importing, layout
    from wam_power_ros.bags.bag import Bag

    if part is not None and not 0.0 <= part[0] < part[1]:
        raise UsageError(f"--part {part[0]} {part[1]} must be 0 <= START < END")
    setup = overlay.setup(config, task=task)
    names, arm = setup.joint_names, setup.arm()
    kind = setup["demonstration_recorder"]["stem"]
    output = output or layout.free_path(Path(), f"{kind}_{bag[0].resolve().stem}")
    called = ", ".join(map(str, bag))
    within = part and (part[0], part[1])
    progress = Console(stderr=True, markup=False).status(f"importing {called} …")
    with progress, tempfile.TemporaryDirectory() as folder:
        try:
            opened = Bag(*_as_bags(bag, Path(folder), episode, degrees))
            made, remarks = importing.import_bag(
                opened, output, names, joints, topic, kind, by_reception, within
            )
        except ValueError as error:
            raise ValueError(str(error).replace(f"{folder}/", "")) from None
        try:
            take, _, _, judged = _inspected(made, names, arm, {kind: {task}})
        except ValueError as error:
            shutil.rmtree(made)
            why = str(error).removeprefix(f"{made}: ")
            raise ValueError(f"{called}: nothing was imported: {why}") from None
    print(f"Bag: {short_path(made.resolve())}")
    for remark in remarks:
        print(f"  {remark.text}")
    print(f"  {_graded(take, judged)}")


def _as_bags(paths: Sequence[Path], folder: Path, episode: int | None, degrees: bool) -> list[Path]:
    """Paths, with bags in a folder in the place of tables and sets of LeRobot."""
    from wam_power_ros.bags import lerobot, table

    unit = math.radians(1.0) if degrees else 1.0
    found = []
    for path in paths:
        a_set = lerobot.is_set(path)
        if episode is not None and not a_set:
            raise UsageError(f"--episode {episode}: {path} is no set of LeRobot")
        if a_set:
            found.append(lerobot.as_bag(path, folder, episode, unit))
        elif table.is_table(path):
            found.append(table.as_bag(path, folder, unit))
        elif degrees:
            raise UsageError(f"--degrees: {path} is a bag, whose angles are in rad")
        else:
            found.append(path)
    return found


def export(
    recorded: Sequence[Path], output: Path, format: str, fps: int, config: Sequence[str]
) -> None:
    """Write a table of a bag or a session, or a set of several, for other programs."""
    from wam_power_ros.bags import table
    from wam_power_ros.practice import session, session_log

    if format != FORMATS[0]:
        return _export_set(recorded, output, fps, overlay.setup(config))
    if recorded[1:]:
        raise UsageError(f"a table is of one bag or session, not of {len(recorded)}")
    table.check_new(output)
    if session.Session.exists(recorded[0]):
        columns, remarks = session_log.columns(session.read(recorded[0]).records), []
        if not columns["number"]:
            raise UsageError(f"{recorded[0]} has no rollout yet")
    else:
        columns, remarks = _bag_columns(recorded[0], overlay.setup(config))
    rows = table.write(columns, output)
    print(f"Table: {output}, {rows} rows, {len(columns)} columns", *remarks, sep="\n  ")


def _export_set(recorded: Sequence[Path], output: Path, fps: int, setup: overlay.Setup) -> None:
    """Write a set of LeRobot, an episode for each bag, or each rollout of a session."""
    from wam_power_ros.bags import lerobot
    from wam_power_ros.practice import session

    lerobot.check_new(output)
    bags: list[Path] = []
    for path in recorded:
        if session.Session.exists(path):
            logged = session.read(path).records
            bags += [path / "bags" / record.bag for record in logged if record.bag]
        else:
            bags.append(path)
    episodes, left_out = [], []
    for bag in bags:
        try:
            episodes.append(_episode(bag, fps, setup))
        except ValueError as error:
            left_out.append(f"  left out: {error}")
    if not episodes:
        raise UsageError("\n".join(["there is no movement to write", *left_out]))
    arm = setup.arm()
    robot = "arm" if arm is None else arm.identity().name
    frames = lerobot.write(episodes, output, setup.joint_names, fps, robot)
    print(f"Set of LeRobot: {output}, {len(episodes)} episodes, {frames} frames at {fps} Hz")
    print(*left_out, sep="\n", end="\n" * bool(left_out))


def _episode(path: Path, fps: int, setup: overlay.Setup) -> lerobot.Episode:
    """Movement of a bag, smoothed as for learning, with the tool by the model of the arm."""
    from wam_power_ros.bags import lerobot
    from wam_power_ros.learning.demonstration import smooth_joints

    bag, arm, states = _read(path, setup)
    t, q = smooth_joints(states.stamps, states.q)
    tasks = task_stems().get(bag.kind, set())
    said = (installed.task_type(min(tasks)).__doc__ or "") if tasks else bag.kind
    tool_pose = partial(_tool_pose, arm) if arm else None
    return lerobot.episode(said.partition("\n")[0], t, q, fps, tool_pose)


def _read(path: Path, setup: overlay.Setup) -> tuple[Bag, Arm | None, States]:
    """A bag, the arm of the set-up, and its states, which are refused if they are another arm's."""
    from wam_power_ros.bags import bag, reader

    opened, arm = bag.Bag(path), setup.arm()
    identity = None if arm is None else arm.identity()
    return opened, arm, reader.read_states(opened, setup.joint_names, arm=identity)


def _tool_pose(arm: Arm, q: np.ndarray) -> list[float]:
    """Position [m] and quaternion xyzw of the tool at joint angles (n,) [rad]."""
    from wam_power_ros import rotations

    position, rotation = arm.tool_pose(q)
    return [*position.tolist(), *rotations.quat_xyzw(rotation).tolist()]


def _bag_columns(path: Path, setup: overlay.Setup) -> tuple[dict[str, list[Any]], list[str]]:
    """Table of a bag, with the tool by the model of the arm, and remarks."""
    from wam_power_ros import arm_identity
    from wam_power_ros.bags import table

    bag, arm, states = _read(path, setup)
    columns = table.joint_columns(bag, states)
    texts = [remark.text for remark in states.remarks]
    if arm is None:
        texts.append("no pose of the tool: the set-up has no URDF file")
    else:
        columns |= table.pose_columns("tool", [_tool_pose(arm, q) for q in states.q])
        texts.append(arm_identity.remark(bag.arm, arm.identity()))
    bodies, remarks = table.body_columns(bag, states.stamps)
    return columns | bodies, [*filter(None, texts), *(remark.text for remark in remarks)]


def recover(bag: Sequence[Path]) -> None:
    """Recover damaged bags."""
    from wam_power_ros.bags.recovery import recover

    for each in bag:
        check_name(each)
        print(recover(each))
