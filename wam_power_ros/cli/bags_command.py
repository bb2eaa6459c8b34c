# SPDX-License-Identifier: Apache-2.0
"""`wam-power bags`: look at recordings, and keep them in order."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from wam_power_ros.cli.launcher import UsageError, arm_of, as_called, short_path, task_stems
from wam_power_ros.cli.node_log import telling
from wam_power_ros.params import overlay

if TYPE_CHECKING:
    import numpy as np

    from wam_power_ros.bags.quality import Grade, Remark
    from wam_power_ros.bags.takes import Take
    from wam_power_ros.control.arm import Arm

NAME_MAX = 40  # columns of a name in the table
SAMPLES = 101  # of a movement that is compared with another


class Looked(NamedTuple):
    """A take as it was looked at.

    Attributes:
        take: Its contents.
        t: Times of the smoothed movement [s]. Shape (N,).
        q: Smoothed joint angles [rad]. Shape (N, n).
        remarks: Reasons for its grade.
    """

    take: Take
    t: np.ndarray
    q: np.ndarray
    remarks: list[Remark]


def add_to(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    text = "look at recordings, and keep them in order"
    group = subparsers.add_parser("bags", help=text, description=f"{text.capitalize()}.")
    commands = group.add_subparsers(required=True, metavar="COMMAND")

    def add(name: str, command: Callable, text: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=text, description=f"{text.capitalize()}.")
        added.set_defaults(command=command)
        return added

    listing = add("list", list_, "a line for each take: task, duration, quality and why")
    listing.add_argument("place", type=Path, nargs="*", help="folders (default: those of takes)")
    shown = add("show", show, "topics, joints and quality of a take")
    shown.add_argument("bag", type=Path)
    plotted = add("plot", plot, "draw joint angles and speeds of takes, with the arm's limits")
    plotted.add_argument("bag", type=Path, nargs="+")
    plotted.add_argument("--output", type=Path, help=".png or .svg (default: BAG.png)")
    compared = add("compare", compare, "how far takes are from the first: duration, joints, tool")
    compared.add_argument("bag", type=Path, nargs="+")
    for command in (listing, shown, plotted, compared):
        _config_option(command)
    trimmed = add("trim", trim, "copy a part of a take")
    trimmed.add_argument("bag", type=Path)
    trimmed.add_argument("begin", type=float, help="[s] since the first joint state")
    trimmed.add_argument("end", type=float, help="[s] since the first joint state")
    renamed = add("rename", rename, "give a bag another name")
    renamed.add_argument("bag", type=Path)
    renamed.add_argument("name")
    deleted = add("delete", delete, "move bags to the folder .trash beside them")
    deleted.add_argument("bag", type=Path, nargs="+")
    merged = add("merge", merge, "copy bags that were recorded one after another into one")
    merged.add_argument("bag", type=Path, nargs="+")
    imported = add("import", import_, "make a demonstration of any rosbag2 bag with joint states")
    imported.add_argument("bag", type=Path, help="MCAP or SQLite")
    imported.add_argument(
        "--joints",
        nargs="+",
        default=[],
        metavar="NAME",
        help="the arm's joints there, base to tip",
    )
    imported.add_argument("--topic", default="", help="joint states (default: the only ones)")
    imported.add_argument("--task", default="flip", help="task it demonstrates (default: flip)")
    _config_option(imported)
    for command, name in ((trimmed, "trimmed"), (merged, "merged"), (imported, "TASK_NAME")):
        command.add_argument("--output", type=Path, help=f"new bag (default: BAG_{name})")
    recovered = add("recover", recover, "make a readable bag of a damaged one")
    recovered.add_argument("bag", type=Path, nargs="+", help="folder of the bag, or .mcap file")


def _config_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config", action="append", default=[], metavar="NAME", help="set-up of the arm"
    )


# Looking


def list_(options: argparse.Namespace) -> int:
    """Print a line for each take."""
    from wam_power_ros.bags import takes

    places = options.place or [Path(name) for name in takes.FOLDERS]
    found = takes.find(places)
    if not found:
        raise UsageError(f"no bags below {', '.join(map(str, places))}")
    outcomes, tasks = _outcomes(found), task_stems()
    names, arm = arm_of(overlay.setup(options.config))
    width = min(max(len(path.name) for path in found), NAME_MAX)
    print(f"{'take':{width}}  {'task':9}  {'time':>6}  {'quality':7}  why")
    folder = None
    for path in found:
        if path.parent != folder:
            folder = path.parent
            print(f"{short_path(folder.resolve())}/")
        kind, row, why = _row(path, names, arm)
        kind = "/".join(sorted(tasks.get(kind, {kind})))
        told = "; ".join(filter(None, (outcomes.get(path.resolve(), ""), why)))
        print(f"{path.name:{width}}  {kind:9}  {row}  {told}".rstrip(), flush=True)
    return 0


def show(options: argparse.Namespace) -> None:
    """Print what is in a take."""
    from wam_power_ros.bags import quality

    names, arm = arm_of(overlay.setup(options.config))
    take, t, q, remarks = look(options.bag, names, arm)
    graded = quality.grade(remarks)
    qd = quality.joint_speeds(t, q)
    print(f"{take.path}: {take.kind}, {take.duration:.2f} s, {graded.name.lower()}")
    for remark in remarks:
        print(f"  {remark.text}")
    if outcome := _outcomes([options.bag]).get(options.bag.resolve()):
        print(f"  {outcome}")
    speed = (qd**2).sum(axis=1) ** 0.5
    print(f"  smoothness {quality.smoothness(speed, t[1] - t[0]):.2f} (spectral arc length)")
    for name, count in take.counts.items():
        lost = f", {take.missing[name]} missing" if take.missing.get(name) else ""
        print(f"  {count:6} {name}{lost}")
    for joint, name in enumerate(names):
        low, high, fastest = q[:, joint].min(), q[:, joint].max(), abs(qd[:, joint]).max()
        of_limit = f", {fastest / arm.qd_max[joint]:.0%} of its limit" if arm is not None else ""
        print(f"  {name}: {low:+.2f} to {high:+.2f} rad, at most {fastest:.2f} rad/s{of_limit}")


def plot(options: argparse.Namespace) -> None:
    """Draw takes into a file."""
    from wam_power_ros.reporting import figures, take_figures

    names, arm = arm_of(overlay.setup(options.config))
    takes = {path.resolve().name: look(path, names, arm) for path in options.bag}
    movements = {name: (looked.t, looked.q) for name, looked in takes.items()}
    limits = None if arm is None else _limits(arm)
    drawn = take_figures.joints(movements, names, limits)
    output = options.output or Path(f"{options.bag[0].resolve().name}.png")
    if output.suffix not in (".png", ".svg"):
        raise UsageError(f"{output} must end in .png or .svg")
    output.write_bytes(figures.png(drawn) if output.suffix == ".png" else figures.svg(drawn))
    print(f"Figure: {output}")


def compare(options: argparse.Namespace) -> None:
    """Print how far takes are from the first of them."""
    import numpy as np

    if len(options.bag) < 2:
        raise UsageError("compare needs two bags at least")
    names, arm = arm_of(overlay.setup(options.config))
    first, *others = [look(path, names, arm) for path in options.bag]
    one, took = _movement(first)
    print(f"{first.take.path.name}: movement of {took:.2f} s, the one compared with")
    for other in others:
        q, took = _movement(other)
        away = np.abs(q - one)
        rms, joint = np.sqrt((away**2).mean(axis=0)), int(away.max(axis=0).argmax())
        tool = ""
        if arm is not None:
            ends = zip(q, one, strict=True)
            apart = [np.linalg.norm(arm.tool_pose(a)[0] - arm.tool_pose(b)[0]) for a, b in ends]
            tool = f"; tool {1e3 * np.mean(apart):.0f} mm, at most {1e3 * np.max(apart):.0f} mm"
        print(
            f"{other.take.path.name}: movement of {took:.2f} s; joints rms {rms.max():.3f} rad in "
            f"{names[int(rms.argmax())]}, at most {away.max():.3f} rad in {names[joint]}{tool}"
        )


def look(path: Path, names: Sequence[str], arm: Arm | None) -> Looked:
    """Read a take and judge it.

    Raises:
        ValueError: It cannot be read, or nothing can be learnt from it.
    """
    from wam_power_ros.bags import quality, takes
    from wam_power_ros.learning.demonstration import smooth_joints

    take = takes.read(path, names)
    t, q = smooth_joints(take.stamps, take.q)
    remarks = quality.movement_remarks(t, q, names, None if arm is None else _limits(arm))
    remarks += quality.completeness_remarks(take.counts, take.missing, take.ended)
    return Looked(take, t, q, remarks)


def _limits(arm: Arm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from wam_power_ros.bags.quality import Limits

    return Limits(arm.q_min, arm.q_max, arm.qd_max)


def _row(path: Path, names: Sequence[str], arm: Arm | None) -> tuple[str, str, str]:
    """Kind of a take, its duration and quality in columns, and the reasons."""
    from wam_power_ros.bags import quality

    try:
        with telling(f"reading {path.name}"):
            take, _, _, remarks = look(path, names, arm)
    except (ValueError, OSError) as error:
        why = as_called(str(error).removeprefix(f"{path}").lstrip(": "))
        row = f"{'–':>6}  {quality.Grade.POOR.name.lower():7}"
        return path.name.partition("_")[0], row, why
    graded: Grade = quality.grade(remarks)
    row = f"{take.duration:4.1f} s  {graded.name.lower():7}"
    return take.kind, row, "; ".join(remark.text for remark in remarks)


def _outcomes(found: Sequence[Path]) -> dict[Path, str]:
    """Outcomes of the rollouts among some bags, by the logs of their sessions."""
    from wam_power_ros.practice import session

    told = {}
    for folder in dict.fromkeys(path.resolve().parent for path in found):
        if folder.name == "bags" and session.Session.exists(folder.parent):
            task = session.read_task(folder.parent)
            for record in session.read(folder.parent)[2]:
                if record.bag:
                    ret = "no return" if record.ret is None else f"return {record.ret:.3f}"
                    told[folder / record.bag] = f"{task.outcome(record)}, {ret}"
    return told


def _movement(looked: Looked) -> tuple[np.ndarray, float]:
    """Moving part of a take, stretched onto SAMPLES (SAMPLES, n) [rad], and its time [s]."""
    import numpy as np

    from wam_power_ros.bags import quality

    speed = np.linalg.norm(quality.joint_speeds(looked.t, looked.q), axis=1)
    fast = np.flatnonzero(speed > 0.05 * speed.max())
    t = looked.t[fast[0] : fast[-1] + 1]
    grid = np.linspace(t[0], t[-1], SAMPLES)
    return np.stack([np.interp(grid, looked.t, each) for each in looked.q.T], axis=1), t[-1] - t[0]


# Keeping in order


def trim(options: argparse.Namespace) -> None:
    """Copy a part of a take."""
    from wam_power_ros.bags import editing

    if not 0.0 <= options.begin < options.end:
        raise UsageError(f"from {options.begin} to {options.end} s is no part of a take")
    _made(editing.trim(options.bag, _output(options, "trimmed"), options.begin, options.end))


def merge(options: argparse.Namespace) -> None:
    """Copy several bags into one."""
    from wam_power_ros.bags import editing

    if len(options.bag) < 2:
        raise UsageError("merge needs two bags at least")
    _made(editing.merge(options.bag, _output(options, "merged")))


def import_(options: argparse.Namespace) -> None:
    """Make a demonstration of another recorder's bag."""
    from wam_power_ros.bags import editing, layout
    from wam_power_ros.cli.launcher import task_setup

    setup = overlay.setup(options.config, task=task_setup(options.task))
    names, arm = arm_of(setup)
    kind = setup["demonstration_recorder"]["stem"]
    to = options.output or layout.free_path(Path(), f"{kind}_{options.bag.resolve().stem}")
    with telling(f"importing {options.bag}"):
        made = editing.import_bag(options.bag, to, names, options.joints, options.topic, kind)
        _, row, why = _row(made, names, arm)
    _made(made)
    print(f"  {row.strip()}  {why}".rstrip())


def rename(options: argparse.Namespace) -> None:
    """Give a bag another name."""
    from wam_power_ros.bags import series

    _made(series.rename(options.bag, options.name))


def delete(options: argparse.Namespace) -> None:
    """Move bags to the trash beside them."""
    from wam_power_ros.bags import series

    for bag in options.bag:
        print(f"{bag} is now {series.discard(bag)}")


def recover(options: argparse.Namespace) -> None:
    """Recover damaged bags."""
    from wam_power_ros.bags.recovery import recover

    for bag in options.bag:
        print(recover(bag))


def _output(options: argparse.Namespace, how: str) -> Path:
    bag = options.bag[0] if isinstance(options.bag, list) else options.bag
    bag = bag.resolve()
    return options.output or bag.with_name(f"{bag.name}_{how}")


def _made(path: Path) -> None:
    print(f"Bag: {short_path(path.resolve())}")
