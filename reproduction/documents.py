# SPDX-License-Identifier: Apache-2.0
"""Figures and tables of the documents, from a session, the shipped bags and files of results.

    wam-power learn --in-process --seed 1 --demonstrations 1 --session flip
    MUJOCO_GL=egl python -m reproduction.documents flip

writes docs/pictures/ and the tables between `<!-- table: grounds -->` and `<!-- end -->`.
"""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont
from matplotlib.patches import Ellipse
from PIL import Image, ImageDraw, ImageFont

import wam_power_ros as power
from hardware_sim.scenes.flip import LEVEL
from hardware_sim.wam import JOINTS
from hardware_sim.world import TRACE_RATE
from reproduction.rivals.learners import RIVALS
from wam_power_ros.bags import reader
from wam_power_ros.control.arm import Arm
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.in_process.render import render
from wam_power_ros.installed import find
from wam_power_ros.learning import policy
from wam_power_ros.learning.learner import Learner
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import share
from wam_power_ros.plotting import BLUE, GREEN, GRID, INK, ORANGE, STEEL, side_by_side, svg
from wam_power_ros.practice import session
from wam_power_ros.reporting import figures
from wam_power_ros.tasks.flip.task import Flip

DOCS = Path(__file__).resolve().parents[1] / "docs"
GROUNDS = DOCS / "evidence/grounds.csv"
LEARNERS = {"model_based": BLUE, "hindsight": ORANGE}  # of that file
TABLE = re.compile(r"(<!-- table: grounds -->\n).*?(<!-- end -->)", re.DOTALL)
CROP = (95, 182, 600, 600)  # of frames of 640 pixels


def grounds() -> dict[tuple[str, str], list[dict[str, int]]]:
    """Sessions of the file of grounds, by ground and learner."""
    found: dict[tuple[str, str], list[dict[str, int]]] = {}
    with GROUNDS.open() as file:
        for line in csv.DictReader(file):
            counts = {name: int(line[name]) for name in ("true", "retests", "rollouts")}
            found.setdefault((line["ground"], line["learner"]), []).append(counts)
    return found


def table_of_grounds() -> str:
    """Sessions solved and rollouts, a line for each ground, and one for all."""
    found = grounds()
    names = list(dict.fromkeys(ground for ground, _ in found))
    lines = ["| ground | " + " | ".join(f"`{each}`: solved | rollouts" for each in LEARNERS) + " |"]
    lines.append("|---" * (1 + 2 * len(LEARNERS)) + "|")
    for name in [*names, "all"]:
        cells = [name]
        for learner in LEARNERS:
            wanted = names if name == "all" else [name]
            rows = [row for ground in wanted for row in found[ground, learner]]
            solved = sum(10 * row["true"] >= 9 * row["retests"] for row in rows)
            counts = np.array([row["rollouts"] for row in rows])
            cells.append(f"{solved} of {len(rows)}")
            cells.append(f"{np.median(counts):.3g} [{counts.min()}–{counts.max()}]")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def with_tables(text: str) -> str:
    """A page with its tables written anew."""
    return TABLE.sub(lambda found: found[1] + table_of_grounds() + found[2], text)


def figure_of_grounds() -> Figure:
    """Rollouts of every session, by ground and learner."""
    found = grounds()
    names = list(dict.fromkeys(ground for ground, _ in found))
    figure, (axes,) = side_by_side(7.2, 4.4, 1.0)
    rng = np.random.default_rng(0)
    for offset, (learner, color) in zip((-0.18, 0.18), LEARNERS.items(), strict=True):
        for place, name in enumerate(names):
            counts = [row["rollouts"] for row in found[name, learner]]
            at = place + offset + 0.07 * rng.uniform(-1.0, 1.0, len(counts))
            label = learner if place == 0 else None
            axes.plot(counts, at, "o", ms=3, color=color, alpha=0.5, mew=0, label=label)
            axes.plot(np.median(counts), place + offset, "|", ms=11, mew=2.5, color=color)
    axes.set(yticks=range(len(names)), yticklabels=names, xlabel="rollouts (60: not confirmed)")
    axes.invert_yaxis()
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, fontsize=8)
    return figure


def demonstration() -> Figure:
    """A shipped demonstration from the side, its fit, and the springs of the fit."""
    arm = Arm(share("urdf/wam7.urdf").read_text(), JOINTS)
    taught = Flip.demonstration_of(
        arm, *reader.read_demonstration(min(share("bags").glob("demo_*")), JOINTS)
    )
    fitted = Flip.policy_of([taught], "taught")
    _, path = power.path(fitted, taught.position[0])
    figure, (axes, right) = side_by_side(7.2, 3.8, 0.8, 1.0)
    largest = max(np.linalg.eigvalsh(each[::2, ::2]).max() for each in fitted.stiffness)
    for stiffness, attractor in zip(fitted.stiffness, fitted.attractors, strict=True):
        values, vectors = np.linalg.eigh(0.5 * (stiffness + stiffness.T)[::2, ::2])
        wide, high = 0.08 * values / largest
        turned = np.degrees(np.arctan2(*vectors[::-1, 0]))
        axes.add_patch(Ellipse(attractor[::2], wide, high, angle=turned, color=GREEN, alpha=0.25))
        axes.plot(*attractor[::2], "+", ms=6, color=GREEN)
    for place, shown in ((axes, slice(None, None, 2)), (right, slice(2, 3))):
        across = () if place is axes else (np.arange(len(path)) * taught.period,)
        for points, color, wide in ((taught.position, STEEL, 4.0), (path, BLUE, 1.5)):
            lines = points[:, shown].T[:, : len(path)]
            place.plot(*across, *lines, color=color, lw=wide, alpha=0.5 if wide > 2 else 1.0)
    near = path[:, ::2].mean(axis=0)
    axes.set(xlabel="x of the pan [m]", ylabel="z [m]", aspect="equal", title="from the side")
    axes.set(xlim=near[0] + [-0.22, 0.22], ylim=near[1] + [-0.26, 0.26])
    right.set(xlabel="time [s]", ylabel="z [m]", title="height")
    labels = {"demonstrated": STEEL, "Eq. 1, open loop": BLUE, "attractor, stiffness": GREEN}
    for label, color in labels.items():
        right.plot([], [], color=color, lw=3, label=label)
    right.legend(frameon=False, fontsize=8)
    return figure


def learners() -> Figure:
    """Returns of the README's example by four learners, twelve seeds each."""
    t = np.linspace(0.0, 2.0, 101)
    x = np.column_stack([0.3 * np.cos(t), 0.3 * np.sin(t), 0.1 * t])
    taught = power.fit(t, x)

    def return_of(tried: policy.Policy) -> float:
        near = np.linalg.norm(power.path(tried, x[0])[1] - [0.25, 0.2, 0.2], axis=1).min()
        return float(np.exp(-10.0 * near))

    figure, (axes,) = side_by_side(7.2, 3.4, 1.0)
    for name, color in (("power", BLUE), ("cma_es", ORANGE), ("pi2_bb", GREEN), ("random", STEEL)):
        kind = find("learner", RIVALS.get(name, name))
        curves = []

        def make(size: int, rng: np.random.Generator, kind: type = kind) -> Learner:
            return kind(size, kind.Settings(), rng)

        for seed in range(12):
            tries = power.practise(return_of, taught, np.random.default_rng(seed), 60, learner=make)
            curves.append([return_of(each.mean) for each in tries])
        low, middle, high = np.quantile(curves, (0.25, 0.5, 0.75), axis=0)
        rollout = np.arange(1, len(middle) + 1)
        axes.plot(rollout, middle, color=color, lw=1.8, label=name)
        axes.fill_between(rollout, low, high, color=color, alpha=0.15, lw=0)
    axes.set(xlabel="rollout", ylabel="return of the mean policy", ylim=(0.0, 1.0))
    axes.legend(loc="lower right", ncols=2, frameon=False, fontsize=8)
    return figure


def arm_with_frames() -> Figure:
    """The arm from its side at the home posture, with the frames and points that a set-up names."""
    model = pinocchio.buildModelFromXML(share("urdf/wam7.urdf").read_text())
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, LEVEL)
    at = {frame.name: data.oMf[k] for k, frame in enumerate(model.frames)}
    points = [at[f"wam_link{k}"].translation for k in range(1, 8)] + [at["pan"].translation]
    figure, (axes,) = side_by_side(7.2, 4.6, 1.0)
    axes.plot(*np.array([[0.0, 0.0, 0.0], *points])[:, ::2].T, color=GRID, lw=14, zorder=1)
    axes.plot(*np.array(points)[:-1, ::2].T, "o", color=STEEL, ms=7, zorder=2)
    pan = points[-1]
    axes.plot([pan[0] - 0.14, pan[0] + 0.14], [pan[2]] * 2, color=INK, lw=4, zorder=2)
    body, world = pan + np.array([0.0, 0.0, 0.05]), np.array([-0.45, 0.0, 0.0])
    for name, origin, rotation, shift in (
        ("wam_base (base_frame)", np.zeros(3), np.eye(3), (8, -14)),
        ("pan (tool_frame)", pan, at["pan"].rotation, (-2, -26)),
        ("pancake (body)", body, np.eye(3), (14, 24)),
        ("world (Motive's origin)", world, np.eye(3), (-14, -14)),
    ):
        for axis, color in ((0, ORANGE), (2, BLUE)):
            tip = origin + 0.13 * rotation[:, axis]
            arrow = {"arrowstyle": "-|>", "color": color, "lw": 2}
            axes.annotate("", tip[::2], origin[::2], arrowprops=arrow, zorder=4)
        _note(axes, name, origin[::2], shift)
    dashed = {"arrowstyle": "<|-", "color": GREEN, "lw": 1.4, "ls": "--", "shrinkA": 4}
    axes.annotate("", (-0.02, 0.02), (world[0] + 0.02, 0.02), arrowprops=dashed)
    _note(axes, "world_to_base", (-0.34, 0.05), (0, 2), GREEN)
    elbow = points[3]
    forearm = elbow + 0.35 * (points[5] - elbow) / np.linalg.norm(points[5] - elbow)
    for point, name, shift in (
        (elbow, "elbow: guarded_*", (-92, 2)),
        (forearm, "350 mm along the forearm: guarded_*", (-20, -34)),
    ):
        axes.plot(*point[::2], "s", color=GREEN, ms=7, zorder=5)
        _note(axes, name, point[::2], shift, GREEN)
    axes.plot([], [], color=ORANGE, lw=2, label="x")
    axes.plot([], [], color=BLUE, lw=2, label="z")
    axes.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", xlim=(-0.65, 1.25), ylim=(-0.2, 1.15))
    axes.legend(loc="upper left", ncols=2, frameon=False, fontsize=8)
    return figure


def _note(
    axes: Axes, text: str, at: Sequence[float], shift: tuple[int, int], color: str = INK
) -> None:
    options = {"xytext": shift, "textcoords": "offset points", "fontsize": 8, "color": color}
    axes.annotate(text, at, zorder=6, **options)


def film(folder: Path) -> list[Image.Image]:
    """The first rollout of a session beside the last one, in frames of half speed."""
    found = session.read(folder)
    setup = overlay.read(folder / "logs/parameters.yaml")
    environment = Environment.from_setup(setup.changed({"wam_sim": {"seed": found.header.seed}}))
    answer = policy.from_json((folder / "policy.json").read_text())
    last = max(record.number for record in found.records if record.kind != "retest")
    strips = []
    for executed in (policy.with_id(found.candidates[0], found.records[0].id), answer):
        environment.run(executed)
        poses = environment.world.trace[: round(1.5 * TRACE_RATE) : 2]  # half speed at 25 Hz
        strips.append(render(environment.world, poses, (640, 640)))
    titles = ("rollout 1: the demonstration, repeated", f"learnt in {last} rollouts, half speed")
    font = ImageFont.truetype(findfont("DejaVu Sans"), 18)
    wide, high = CROP[2] - CROP[0], CROP[3] - CROP[1]
    frames = []
    for pair in zip(*strips, strict=True):
        frame = Image.new("RGB", (2 * wide + 6, high), "white")
        for place, (image, title) in enumerate(zip(pair, titles, strict=True)):
            frame.paste(Image.fromarray(image).crop(CROP), (place * (wide + 6), 0))
            ImageDraw.Draw(frame).text((place * (wide + 6) + 12, 10), title, INK, font)
        frames.append(frame)
    return frames


def main(arguments: Sequence[str]) -> int:
    """`python -m reproduction.documents [SESSION]`: write figures and tables of the documents."""
    pictures = DOCS / "pictures"
    drawn = (demonstration, learners, arm_with_frames, figure_of_grounds)
    for draw in drawn:
        (pictures / f"{draw.__name__}.svg").write_bytes(svg(draw()))
    for folder in map(Path, arguments):
        records = session.read(folder).records
        returns = [np.nan if record.ret is None else record.ret for record in records]
        curve = figures.learning_curve(returns, [record.kind for record in records])
        (pictures / "learning_curve.svg").write_bytes(svg(curve))
        frames = [np.array(frame) for frame in film(folder)]
        figures.save_film([*frames, *[frames[-1]] * 15], pictures / "flip.webp", 25.0)
    for page in DOCS.rglob("*.md"):
        if (text := page.read_text()) != (written := with_tables(text)):
            page.write_text(written)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
