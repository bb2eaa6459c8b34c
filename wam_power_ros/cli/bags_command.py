# SPDX-License-Identifier: Apache-2.0
"""`wam-power bags`: inspect and import recordings."""

from __future__ import annotations

import argparse
import math
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from wam_power_ros import installed
from wam_power_ros.cli.launcher import UsageError, short_path, task_stems
from wam_power_ros.cli.node_log import progress_messages
from wam_power_ros.cli.parser import add_command, config_option, task_option
from wam_power_ros.cli.session_options import DEFAULT_TASK
from wam_power_ros.durable_files import check_name, printable
from wam_power_ros.params import overlay

if TYPE_CHECKING:
    import numpy as np

    from wam_power_ros.bags.quality import Grade, Limits, Remark
    from wam_power_ros.bags.takes import Take
    from wam_power_ros.control.arm import Arm

NAME_WIDTH_MAX = 40  # columns of a name in the table


class InspectedTake(NamedTuple):
    """A take, its smoothed movement t (N,) [s] and q (N, n) [rad], and reasons for its grade."""

    take: Take
    t: np.ndarray
    q: np.ndarray
    remarks: list[Remark]


def add_to(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    group = add_command(subparsers, "bags", None, "inspect and import recordings")
    group.set_defaults(command=group.print_help)
    add = partial(add_command, group.add_subparsers(metavar="COMMAND"))
    listing = add("list", list_, "print a line for each take: task, duration and outcome")
    listing.add_argument("folder", type=Path, nargs="*", help="of takes (default: the usual ones)")
    help_quality = "read each take, and grade it with reasons"
    listing.add_argument("--quality", action="store_true", help=help_quality)
    shown = add("show", show, "print topics, joints and quality of a take")
    shown.add_argument("bag", type=Path)
    plotted = add("plot", plot, "draw joint angles and speeds of takes, with the arm's limits")
    plotted.add_argument("bag", type=Path, nargs="+")
    plotted.add_argument("--output", type=Path, help=".png or .svg (default: BAG.png)")
    imported = add("import", import_, "make a demonstration of any bag with joint states")
    help_bags = "folder, .mcap, .db3 or .csv; several that follow each other become one"
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
    help_degrees = "the angles of a table are in degrees"
    imported.add_argument("--degrees", action="store_true", help=help_degrees)
    imported.add_argument("--output", type=Path, help="new bag (default: TASK_NAME)")
    exported = add("export", export, "write a table of a bag or a session")
    exported.add_argument("recorded", type=Path, metavar="BAG|SESSION")
    exported.add_argument("--output", type=Path, required=True, help="new .csv file")
    for command in (listing, shown, plotted, imported, exported):
        config_option(command, "set-up of the arm")


def list_(folder: Sequence[Path], quality: bool, config: Sequence[str]) -> None:
    """Print a line for each take."""
    from wam_power_ros.bags import takes

    folders = folder or [Path(name) for name in takes.FOLDERS]
    found = takes.find(folders)
    if not found:
        raise UsageError(f"no bags below {', '.join(map(str, folders))}")
    outcomes: dict[Path, str] = {}
    tasks, setup = task_stems(), overlay.setup(config)
    judge = partial(_verdict, names=setup.joint_names, arm=setup.arm(), tasks=tasks)
    width = min(max(len(printable(path.name)) for path in found), NAME_WIDTH_MAX)
    print(f"{'take':{width}}  {'task':9}  {'time':>6}  {'quality  reasons' * quality}".rstrip())
    shown = None
    for path in found:
        if path.parent != shown:
            shown, outcomes = path.parent, _outcomes([path])
            print(f"{printable(short_path(shown.resolve()))}/", flush=True)
        kind, row, reasons = _row(path, judge if quality else _noted)
        kind = "/".join(sorted(tasks.get(kind, {kind})))
        notes = "; ".join(filter(None, (outcomes.get(path.resolve(), ""), reasons)))
        name = printable(path.name)
        print(f"{name:{width}}  {kind:9}  {row}  {notes}".rstrip(), flush=True)


def show(bag: Path, config: Sequence[str]) -> None:
    """Print what is in a take."""
    from wam_power_ros.bags import quality

    setup = overlay.setup(config)
    arm = setup.arm()
    limits = _limits(arm)
    take, t, q, remarks = _judged(bag, setup.joint_names, arm, task_stems())
    graded = quality.grade(remarks)
    qd = quality.joint_speeds(t, q)
    print(f"{take.bag.path}: {take.bag.kind}, {take.duration:.2f} s, {graded.name.lower()}")
    for remark in remarks:
        print(f"  {remark.text}")
    if outcome := _outcomes([bag]).get(bag.resolve()):
        print(f"  {outcome}")
    speed = (qd**2).sum(axis=1) ** 0.5
    print(f"  smoothness {quality.smoothness(speed, t[1] - t[0]):.2f} (spectral arc length)")
    for name, count in take.counts.items():
        lost = f", {take.missing[name]} missing" if take.missing.get(name) else ""
        print(f"  {count:6} {name}{lost}")
    for joint, name in enumerate(setup.joint_names):
        low, high, fastest = q[:, joint].min(), q[:, joint].max(), abs(qd[:, joint]).max()
        of_limit = f", {fastest / limits.qd_max[joint]:.0%} of its limit" if limits else ""
        print(f"  {name}: {low:+.2f} to {high:+.2f} rad, at most {fastest:.2f} rad/s{of_limit}")


def plot(bag: Sequence[Path], output: Path | None, config: Sequence[str]) -> None:
    """Draw takes into a file."""
    from wam_power_ros import plotting
    from wam_power_ros.reporting import figures

    setup = overlay.setup(config)
    names, limits = setup.joint_names, _limits(setup.arm())
    takes = {path.resolve().name: inspect(path, names, limits) for path in bag}
    movements = {name: (inspected.t, inspected.q) for name, inspected in takes.items()}
    drawn = figures.joints(movements, names, limits)
    output = output or Path(f"{bag[0].resolve().name}.png")
    if output.suffix not in (".png", ".svg"):
        raise UsageError(f"{output} must end in .png or .svg")
    output.write_bytes(plotting.png(drawn) if output.suffix == ".png" else plotting.svg(drawn))
    print(f"Figure: {output}")


def inspect(path: Path, names: Sequence[str], limits: Limits | None = None) -> InspectedTake:
    """Open a take and judge its quality, also by the limits of the arm, if known.

    Raises:
        ValueError: The bag cannot be read, or nothing can be learnt from it.
    """
    from wam_power_ros.bags import quality, takes
    from wam_power_ros.bags.bag import Bag
    from wam_power_ros.learning.demonstration import smooth_joints

    take = takes.read(Bag(path), names)
    t, q = smooth_joints(take.states.stamps, take.states.q)
    remarks = [*take.states.remarks]
    remarks += quality.movement_remarks(t, q, names, limits)
    remarks += quality.completeness_remarks(take.counts, take.missing, take.ended)
    return InspectedTake(take, t, q, remarks)


def _judged(
    path: Path, names: Sequence[str], arm: Arm | None, tasks: Mapping[str, set[str]]
) -> InspectedTake:
    """Inspect a take; a demonstration of a task is also judged as its fit would cut it."""
    from wam_power_ros.bags import quality
    from wam_power_ros.learning.policy import DURATION_MAX

    found = inspect(path, names, _limits(arm))
    take, remarks = found.take, found.remarks
    if arm is not None and take.bag.kind in tasks:
        task = installed.task_type(min(tasks[take.bag.kind]))
        try:
            fitted = task.demonstration_of(arm, take.states.stamps, take.states.q)
        except ValueError as error:
            if quality.grade(remarks) is not quality.Grade.POOR:
                remarks.append(quality.Remark(quality.Grade.POOR, str(error)))
        else:
            remarks += [quality.left_out_remark(*each) for each in fitted.left_out]
            remarks += quality.length_remarks(fitted.duration, DURATION_MAX)
    return found


def _limits(arm: Arm | None) -> Limits | None:
    from wam_power_ros.bags.quality import Limits

    return None if arm is None else Limits(arm.q_min, arm.q_max, arm.qd_max)


def _row(path: Path, judge: Callable[[Path], tuple[str, str, str]]) -> tuple[str, str, str]:
    """Return what `judge` returns about a take, see `_verdict`, or why it cannot be read."""
    try:
        with progress_messages(f"reading {path.name}"):
            return judge(path)
    except (ValueError, OSError) as error:
        reason = str(error).removeprefix(printable(path)).lstrip(": ")
        return printable(path.name.partition("_")[0]), f"{'–':>6}  poor   ", reason


def _noted(path: Path) -> tuple[str, str, str]:
    """What `_verdict` returns, without a quality, from name and description of a take alone."""
    from wam_power_ros.bags.bag import information

    duration = information(path).get("duration")
    ns = duration.get("nanoseconds") if isinstance(duration, dict) else None
    time = f"{1e-9 * ns:4.1f} s" if isinstance(ns, int) else f"{'–':>6}"
    return path.resolve().name.partition("_")[0], time, ""


def _verdict(
    path: Path, names: Sequence[str], arm: Arm | None, tasks: Mapping[str, set[str]]
) -> tuple[str, str, str]:
    """Kind of a take, its duration and quality in columns, and the reasons for its quality."""
    return _columns(_judged(path, names, arm, tasks))


def _columns(judged: InspectedTake) -> tuple[str, str, str]:
    from wam_power_ros.bags import quality

    graded: Grade = quality.grade(judged.remarks)
    row = f"{judged.take.duration:4.1f} s  {graded.name.lower():7}"
    reasons = (each.text for each in judged.remarks if each.grade is not quality.Grade.GOOD)
    return judged.take.bag.kind, row, "; ".join(reasons)


def _outcomes(found: Sequence[Path]) -> dict[Path, str]:
    """Outcomes of those bags that are rollouts, from the logs of their sessions."""
    from wam_power_ros.practice import session

    outcomes = {}
    for folder in dict.fromkeys(path.resolve().parent for path in found):
        if folder.name == "bags" and session.Session.exists(folder.parent):
            found_session = session.read(folder.parent)
            for record in found_session.records:
                if record.bag:
                    ret = "no return" if record.ret is None else f"return {record.ret:.3f}"
                    outcomes[folder / record.bag] = f"{found_session.task.outcome(record)}, {ret}"
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
    degrees: bool,
) -> None:
    """Make a demonstration of bags of any recorder; what nothing can be learnt from is not kept."""
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
    with progress_messages(f"importing {called}"), tempfile.TemporaryDirectory() as folder:
        try:
            opened = Bag(*_as_bags(bag, Path(folder), degrees))
            made, remarks = importing.import_bag(
                opened, output, names, joints, topic, kind, by_reception, within
            )
        except ValueError as error:
            raise ValueError(str(error).replace(f"{folder}/", "")) from None
        try:
            judged = _judged(made, names, arm, {kind: {task}})
        except ValueError as error:
            shutil.rmtree(made)
            why = str(error).removeprefix(f"{made}: ")
            raise ValueError(f"{called}: nothing was imported: {why}") from None
    print(f"Bag: {short_path(made.resolve())}")
    for remark in remarks:
        print(f"  {remark.text}")
    _, row, reasons = _columns(judged)
    print(f"  {row.strip()}  {reasons}".rstrip())


def _as_bags(paths: Sequence[Path], folder: Path, degrees: bool) -> list[Path]:
    """Paths, with bags in a folder in the place of tables."""
    from wam_power_ros.bags import table

    found = []
    for path in paths:
        if table.is_table(path):
            found.append(table.as_bag(path, folder, math.radians(1.0) if degrees else 1.0))
        elif degrees:
            raise UsageError(f"--degrees: {path} is a bag, whose angles are in rad")
        else:
            found.append(path)
    return found


def export(recorded: Path, output: Path, config: Sequence[str]) -> None:
    """Write a table of a bag or a session, for other programs."""
    from wam_power_ros.bags import table
    from wam_power_ros.practice import session, session_log

    table.check_new(output)
    remarks: Sequence[str] = ()
    if session.Session.exists(recorded):
        columns = session_log.columns(session.read(recorded).records)
        if not columns["number"]:
            raise UsageError(f"{recorded} has no rollout yet")
    elif recorded.is_dir() and not (recorded / "metadata.yaml").is_file():
        raise UsageError(
            f"{recorded} is neither a session nor a bag: it has no session.yaml and no "
            f"metadata.yaml; if it is a damaged bag: wam-power recover {recorded}"
        )
    else:
        with progress_messages(f"reading {recorded}"):
            columns, remarks = _bag_columns(recorded, overlay.setup(config))
    rows = table.write(columns, output)
    print(f"Table: {output}, {rows} rows, {len(columns)} columns")
    for remark in remarks:
        print(f"  {remark}")


def _bag_columns(path: Path, setup: overlay.Setup) -> tuple[dict[str, list[Any]], list[str]]:
    """Table of a bag, with the tool by the model of the arm, and remarks."""
    from wam_power_ros import arm_identity, rotations
    from wam_power_ros.bags import reader, table
    from wam_power_ros.bags.bag import Bag

    bag, arm = Bag(path), setup.arm()
    identity = None if arm is None else arm.identity()
    states = reader.read_states(bag, setup.joint_names, arm=identity)
    columns = table.joint_columns(bag, states)
    texts = [remark.text for remark in states.remarks]
    if arm is None or identity is None:
        texts.append("no pose of the tool: the set-up has no URDF file")
    else:
        poses = [arm.tool_pose(q) for q in states.q]
        columns |= table.pose_columns(
            "tool", [[*p.tolist(), *rotations.quat_xyzw(R).tolist()] for p, R in poses]
        )
        texts.append(arm_identity.remark(bag.arm, identity))
    bodies, remarks = table.body_columns(bag, states.stamps)
    return columns | bodies, [*filter(None, texts), *(remark.text for remark in remarks)]


def recover(bag: Sequence[Path]) -> None:
    """Recover damaged bags."""
    from wam_power_ros.bags.recovery import recover

    for each in bag:
        check_name(each)
        print(recover(each))
