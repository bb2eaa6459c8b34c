# SPDX-License-Identifier: Apache-2.0
"""Figures of the reproduction: many runs side by side, and beside the paper's.

Data in, matplotlib figures out, in the style of `figures`; nothing is computed here
beyond means and quantiles. `chapters.Figure.of(name, caption, figure)` makes a PNG of one.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from wam_power_ros import rotations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.reporting.figures import (
    ACCENT,
    CYCLE,
    INK,
    PAN,
    PAPER,
    dress,
    legend,
    paper_table,
)

OBSTACLE, GOAL, LEARNT = "#c8504f", "#2f855a", "#1d5c3a"
YELLOW, BROWN, STEEL = "#e3a72f", "#7a4a1c", "#5b6570"
COLORS = (*CYCLE, "#3a9a9a", "#a07d2c", "#6b7280", "#c2649a", "#5a7d2a")
PANCAKE_RADIUS, PAN_RADIUS = 0.09, 0.14  # as drawn [m]
HALO = [patheffects.withStroke(linewidth=3, foreground="white")]
MARGIN = 0.03  # around what is drawn [m]


@dataclass(frozen=True, eq=False)
class Reaching:
    """A panel of Fig. 2.

    Attributes:
        demonstrations: Positions [m]. Shapes (T, 3).
        rollouts: Some made while learning [m]. Shapes (T, 3); may be empty.
        learnt: Path of the answer [m]. Shape (T, 3).
        goal: [m]. Shape (3,).
        obstacle: Centre of the sphere [m]. Shape (3,).
        radius: Of the sphere [m].
        executed: Path the arm really took [m]. Shape (M, 3), None where none did.
    """

    demonstrations: Sequence[np.ndarray]
    rollouts: Sequence[np.ndarray]
    learnt: np.ndarray
    goal: np.ndarray
    obstacle: np.ndarray
    radius: float
    executed: np.ndarray | None = None


def reaching(panels: Mapping[str, Reaching]) -> Figure:
    """Fig. 2 of the paper: paths around the obstacle, each from the side and from above.

    The axes are those of the movement: along the line from the mean start of the demonstrations
    to the goal, aside of it, and up.

    Args:
        panels: Title -> what is in it, such as "diagonal" and "full".

    Raises:
        ValueError: No panel.
    """
    if not panels:
        raise ValueError("a figure of reaching needs at least one panel")
    drawn = []  # of each panel its views, and all that is in each: shape (n, 2)
    for panel in panels.values():
        start = np.mean([path[0] for path in panel.demonstrations], axis=0)
        frame = _along(panel.goal - start)  # rows: along, aside, up
        paths = [*panel.demonstrations, *panel.rollouts, panel.learnt]
        corners = panel.obstacle + panel.radius * np.array([[-1.0] * 3, [1.0] * 3])
        for view in (frame[[0, 2]], frame[[0, 1]]):
            drawn.append((panel, view, start, (np.concatenate([*paths, corners]) - start) @ view.T))
    low, high = (
        np.stack([edge([values for *_, values in drawn[row::2]]) for row in (0, 1)])
        for edge in (_low, _high)
    )
    low[:, 0], high[:, 0] = low[:, 0].min(), high[:, 0].max()
    size = high - low  # (2, 2): of each row, along and across
    width = 4.4
    heights = width * size[:, 1] / size[:, 0]
    figure = Figure(figsize=(width * len(panels) + 0.6, heights.sum() + 1.4), layout="compressed")
    grid = figure.subplots(2, len(panels), squeeze=False, height_ratios=heights)
    for (panel, view, start, _), axes in zip(drawn, grid.T.flat, strict=True):
        _reaching_view(axes, panel, view, start)
    for row in (0, 1):
        for axes in grid[row]:
            axes.set(xlim=(low[row, 0], high[row, 0]), ylim=(low[row, 1], high[row, 1]))
            axes.set_aspect("equal")
    for title, (axes, below) in zip(panels, grid.T, strict=True):
        axes.set_title(title, fontsize=10, color=INK)
        axes.tick_params(labelbottom=False)
        below.set_xlabel("along the movement [m]")
    grid[0, 0].set_ylabel("up [m]")
    grid[1, 0].set_ylabel("aside [m]")
    figure.legend(
        *_named(grid[0, 0], *grid[0]),
        loc="outside lower center",
        ncols=4,
        frameon=False,
        fontsize=8,
    )
    return figure


def _reaching_view(axes: Axes, panel: Reaching, view: np.ndarray, start: np.ndarray) -> None:
    dress(axes)
    centre = view @ (panel.obstacle - start)
    axes.add_patch(Circle(centre, panel.radius, color=OBSTACLE, alpha=0.28, lw=0, label="obstacle"))
    for number, path in enumerate(panel.rollouts):
        label = "rollouts while learning" if number == 0 else None
        axes.plot(*(view @ (path - start).T), color="#8fc3a5", lw=0.6, alpha=0.8, label=label)
    for number, path in enumerate(panel.demonstrations):
        label = "demonstrations" if number == 0 else None
        axes.plot(*(view @ (path - start).T), color=PAN, lw=1.1, label=label)
    axes.plot(*(view @ (panel.learnt - start).T), color=LEARNT, lw=2.6, label="learnt")
    if panel.executed is not None:
        axes.plot(
            *(view @ (panel.executed - start).T), color=YELLOW, lw=1.2, ls="--", label="executed"
        )
    axes.plot(*(view @ (panel.learnt[0] - start)), "o", color=GOAL, ms=6, label="start")
    axes.plot(*(view @ (panel.goal - start)), "s", color=GOAL, ms=8, label="goal")


def _low(drawn: Sequence[np.ndarray]) -> np.ndarray:
    return np.min([values.min(axis=0) for values in drawn], axis=0) - MARGIN


def _high(drawn: Sequence[np.ndarray]) -> np.ndarray:
    return np.max([values.max(axis=0) for values in drawn], axis=0) + MARGIN


def _along(direction: np.ndarray) -> np.ndarray:
    """Unit vectors along the level part of a direction, to its left, and up. Shape (3, 3)."""
    level = np.array([direction[0], direction[1], 0.0])
    length = float(np.linalg.norm(level))
    level = level / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.stack([level, np.cross(up, level), up])


def flights(
    rollouts: Mapping[str, tuple[EndEffectorPath, BodyPath, float | None]],
) -> Figure:
    """Figs. 3 and 4 of the paper: pan and pancake seen from the side, with their normals.

    The pancake is drawn edge-on at every camera frame, its two sides in two colours; the side
    that lay in the pan at first is brown. The pan is drawn at the same times.

    Args:
        rollouts: Title -> paths of pan and pancake, and t_f [s] or None.

    Raises:
        ValueError: No rollout.
    """
    if not rollouts:
        raise ValueError("a figure of flights needs at least one rollout")
    everything = [
        path.position[:, [0, 2]] for paths in rollouts.values() for path in paths[:2] if len(path.t)
    ]
    low, high = _low(everything) - 0.8 * PAN_RADIUS, _high(everything) + 0.8 * PAN_RADIUS
    pans = [pan.position[:, [0, 2]] for pan, _, _ in rollouts.values()]
    low[1] = max(low[1], _low(pans)[1] - 2.0 * PAN_RADIUS)  # one that is dropped leaves the view
    width = 4.2
    height = width * (high[1] - low[1]) / (high[0] - low[0])
    figure = Figure(figsize=(width * len(rollouts) + 0.6, height + 1.1), layout="compressed")
    row = figure.subplots(1, len(rollouts), squeeze=False)[0]
    for axes, (title, (pan, pancake, t_f)) in zip(row, rollouts.items(), strict=True):
        dress(axes)
        axes.set_title(title, fontsize=10, color=INK)
        axes.plot(pan.position[:, 0], pan.position[:, 2], color=STEEL, lw=0.9, ls=":", label="pan")
        pan_normals = rotations.matrix(pan.quat_xyzw)[:, :, 2]  # (T, 3)
        times = pancake.t if len(pancake.t) else pan.t[:: max(1, len(pan.t) // 20)]
        nearest = np.clip(np.searchsorted(pan.t, times), 0, len(pan.t) - 1)
        shown = [nearest[0]]  # a pan that stays is drawn once
        for index in nearest:
            if np.linalg.norm(pan.position[index] - pan.position[shown[-1]]) > 0.02:
                shown.append(index)
        for index in shown:
            _disc(axes, pan.position[index], pan_normals[index], PAN_RADIUS, (STEEL, STEEL), 0.45)
        if len(pancake.t):
            turns = rotations.matrix(pancake.quat_xyzw)  # (M, 3, 3)
            normals = turns @ (turns[0].T @ pan_normals[nearest[0]])
            axes.plot(
                pancake.position[:, 0],
                pancake.position[:, 2],
                color=BROWN,
                lw=0.7,
                ls=":",
                label="pancake",
            )
            flying = [0]
            for k in range(len(pancake.t)):
                if np.linalg.norm(pancake.position[k] - pancake.position[flying[-1]]) > 0.025:
                    flying.append(k)
            for k in flying:
                _disc(axes, pancake.position[k], normals[k], PANCAKE_RADIUS, (YELLOW, BROWN), 0.95)
            if t_f is not None:
                at = [np.interp(t_f, pancake.t, pancake.position[:, k]) for k in (0, 2)]
                axes.plot(*at, "o", ms=9, mfc="none", mec=ACCENT, mew=1.4, label="$t_f$")
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, outward [m]")
        axes.set_aspect("equal")
    row[0].set_ylabel("z, up [m]")
    figure.legend(*_named(*row), loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


def _disc(
    axes: Axes,
    place: np.ndarray,
    normal: np.ndarray,
    radius: float,
    colors: tuple[str, str],
    alpha: float,
) -> None:
    """A disc seen edge-on: the side its normal points to in the first colour, with the normal."""
    n = normal[[0, 2]]
    along = np.array([n[1], -n[0]])
    centre = place[[0, 2]]
    for side, color in zip((0.002, -0.002), colors, strict=True):
        ends = np.stack([centre + side * n - radius * along, centre + side * n + radius * along])
        axes.plot(*ends.T, color=color, lw=1.5, alpha=alpha, solid_capstyle="butt")
    tip = centre + 0.05 * n
    axes.plot(*np.stack([centre, tip]).T, color=PAN, lw=0.8, alpha=alpha)
    axes.plot(*tip, marker=".", ms=2.5, color=PAN, alpha=alpha)


def sessions_over_paper(
    sessions: Mapping[str, Sequence[Sequence[float | None]]], ylabel: str = "return (Eq. 5)"
) -> Figure:
    """Fig. 5: mean return per rollout with standard deviations over the digitised curve.

    Beside it the gain: mean of the first five rollouts and of the last five, per session.

    Args:
        sessions: Name -> returns of each session, None or NaN where a rollout was not usable;
            sessions of one name may differ in length.
        ylabel: Of the returns.

    Raises:
        ValueError: No session under a name.
    """
    figure = Figure(figsize=(9.4, 4.2), layout="constrained")
    axes, gain = figure.subplots(1, 2, width_ratios=(2.7, 1.0), sharey=True)
    dress(axes)
    dress(gain)
    paper = paper_table("fig5")
    axes.plot(*paper.T, "s-", ms=2.6, lw=1.1, color=PAPER, label="paper, Fig. 5, 6 sessions")
    _gain_line(gain, 0, paper[:5, 1].mean(), paper[-5:, 1].mean(), PAPER)
    names = ["paper"]
    for place, (name, runs) in enumerate(sessions.items(), start=1):
        stacked = stack(runs)
        color = COLORS[place - 1]
        rollout = np.arange(1, stacked.shape[1] + 1)
        count = np.isfinite(stacked).sum(axis=0)
        some = count > 0
        mean, sd = _moments(stacked)
        # as in the paper, a bar at every rollout; each name a little aside of the other
        aside = 0.16 * (place - 1)
        axes.errorbar(
            rollout[some] + aside,
            mean[some],
            yerr=sd[some],
            color=color,
            lw=1.8,
            elinewidth=0.6,
            ecolor=_faint(color),
            capsize=1.5,
            capthick=0.6,
            label=f"{name}, {len(runs)} sessions",
        )
        early, late = first_and_last_five(runs)
        for ends in zip(early, late, strict=True):
            gain.plot([place - 0.28, place + 0.28], ends, color=color, lw=0.6, alpha=0.28)
        _gain_line(gain, place, float(np.mean(early)), float(np.mean(late)), color)
        names.append(name)
    axes.set(xlabel="rollout", ylabel=ylabel)
    axes.set_xlim(0.0, None)
    gain.set_xticks(range(len(names)), names, fontsize=8)
    gain.set_xlim(-0.6, len(names) - 0.4)
    gain.grid(axis="x", visible=False)
    gain.set_title("first five to last five", fontsize=9, color=INK)
    legend(axes)
    return figure


def _gain_line(axes: Axes, place: float, early: float, late: float, color: str) -> None:
    axes.plot([place - 0.28, place + 0.28], [early, late], "o-", color=color, lw=2.2, ms=4)
    text = axes.annotate(
        f"{late - early:+.2f}",
        (place, max(early, late)),
        xytext=(0, 9),
        textcoords="offset points",
        ha="center",
        fontsize=9,
        color=INK,
    )
    text.set_path_effects(HALO)


def first_and_last_five(runs: Sequence[Sequence[float | None]]) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the first five and of the last five usable returns of each session, shapes (n,)."""
    usable = [row[np.isfinite(row)] for row in stack(runs)]
    return (
        np.array([row[:5].mean() for row in usable if len(row)]),
        np.array([row[-5:].mean() for row in usable if len(row)]),
    )


def stiffness_profiles(t: Sequence[float], profiles: Mapping[str, np.ndarray]) -> Figure:
    """Vertical stiffness K33 over the movement, absolute and about its own mean, and the paper's.

    Args:
        t: Part of the movement, 0 to 1. Length T.
        profiles: Name -> K33 of each learnt policy [1/s^2]. Shapes (n, T).
    """
    figure = Figure(figsize=(9.4, 3.6), layout="constrained")
    absolute, relative = figure.subplots(1, 2)
    dress(absolute)
    dress(relative)
    paper = paper_table("k33")
    part = paper[:, 0] / paper[-1, 0]
    own = np.interp(np.linspace(0.0, 1.0, 101), part, paper[:, 1]).mean()  # not evenly sampled
    absolute.plot(part, paper[:, 1], "s--", ms=3, lw=1.2, color=PAPER, label="paper, learnt")
    relative.plot(part, 100.0 * (paper[:, 1] / own - 1.0), "s--", ms=3, lw=1.2, color=PAPER)
    for color, (name, given) in zip(COLORS, profiles.items(), strict=False):
        rows = np.atleast_2d(np.asarray(given, dtype=float))
        about = 100.0 * (rows / rows.mean(axis=1, keepdims=True) - 1.0)
        count = f", {len(rows)} policies" if len(rows) > 1 else ""
        for axes, values in ((absolute, rows), (relative, about)):
            low, middle, high = np.quantile(values, (0.1, 0.5, 0.9), axis=0)
            axes.plot(t, middle, color=color, lw=2, label=f"{name}{count}")
            if len(rows) > 1:
                axes.fill_between(t, low, high, color=color, alpha=0.15, lw=0)
    absolute.set(xlabel="part of the movement", ylabel="$K_{33}$ [1/s$^2$]")
    absolute.set_ylim(0.0, None)
    relative.set(xlabel="part of the movement", ylabel="$K_{33}$ about its mean [%]")
    figure.legend(*_named(absolute), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return figure


def learner_curves(
    curves: Mapping[str, Sequence[Sequence[float | None]]],
    ours: Collection[str] = (),
    ylabel: str = "return",
    xlabel: str = "rollout",
    marks: Mapping[str, float] | None = None,
) -> Figure:
    """Median over runs of each learner, with the quartiles of those that are set off.

    Args:
        curves: Name -> a value a rollout of each run, None or NaN where there is none: the best
            return so far, or that of the current mean. Runs of one name may differ in length.
        ours: Names set off: thick lines with their quartiles; all, if none is named.
        ylabel: Of the values.
        xlabel: Of their places.
        marks: Words -> value at which a level line is drawn, such as "paper, full" -> 0.73.
    """
    figure = Figure(figsize=(8.6, 4.4), layout="constrained")
    axes = figure.subplots()
    dress(axes)
    ends = []
    longest = 0
    for place, (name, runs) in enumerate(curves.items()):
        stacked = stack(runs)
        color = COLORS[place % len(COLORS)]
        strong = not ours or name in ours
        some = np.isfinite(stacked).any(axis=0)
        x = np.arange(1, stacked.shape[1] + 1)[some]
        low, middle, high = np.nanquantile(stacked[:, some], (0.25, 0.5, 0.75), axis=0)
        longest = max(longest, int(x[-1]))
        style = {"lw": 2.3} if strong else {"lw": 1.1, "ls": ("-", "--", "-.", ":")[place % 4]}
        axes.plot(x, middle, color=color, zorder=3 if strong else 2, **style)
        if strong and len(stacked) > 1:
            axes.fill_between(x, low, high, color=color, alpha=0.14, lw=0)
        ends.append((float(middle[-1]), int(x[-1]), name, color, strong))
    for words, value in (marks or {}).items():
        axes.axhline(value, color=PAPER, lw=1.0, ls=":")
        text = axes.annotate(
            words,
            (longest, value),
            xytext=(-3, 2),
            textcoords="offset points",
            ha="right",
            fontsize=8,
            color=STEEL,
        )
        text.set_path_effects(HALO)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    axes.set_xlim(0.0, longest)
    _label_ends(axes, ends)
    return figure


def _label_ends(axes: Axes, ends: Sequence[tuple[float, int, str, str, bool]]) -> None:
    """Names right of the axes, each as near to the end of its line as there is room for."""
    low, high = axes.get_ylim()
    room = 0.052 * (high - low)
    order = sorted(ends)
    heights = [value for value, *_ in order]
    for _ in range(200):  # push neighbours apart until none overlap
        moved = False
        for k, (a, b) in enumerate(pairwise(heights)):
            if b - a < room - 1e-9:
                middle = 0.5 * (a + b)
                heights[k], heights[k + 1] = middle - room / 2, middle + room / 2
                moved = True
        if not moved:
            break
    right = axes.get_xlim()[1]
    for height, (value, _, name, color, strong) in zip(heights, order, strict=True):
        axes.annotate(
            name,
            (right, value),
            xytext=(1.035, (height - low) / (high - low)),
            textcoords="axes fraction",
            va="center",
            fontsize=8.5,
            fontweight="bold" if strong else "normal",
            color=color,
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": color, "lw": 0.6, "relpos": (0, 0.5)},
        )


def strips(
    groups: Mapping[str, Sequence[float]],
    xlabel: str = "return",
    marks: Mapping[str, float] | None = None,
    ours: Collection[str] = (),
    form: str = ".3f",
) -> Figure:
    """Every value of each group as a dot, over its quartiles and median; the first group on top.

    Args:
        groups: Name -> values, such as learner -> final return of every run.
        xlabel: Of the values.
        marks: Words -> value at which an upright line is drawn, such as "paper, full" -> 0.73.
        ours: Names set off in colour; all, if none is named.
        form: Of the medians written at the right.

    Raises:
        ValueError: No group, or one without values.
    """
    if not groups or not all(len(values) for values in groups.values()):
        raise ValueError(f"nothing to draw in {[n for n, v in groups.items() if not len(v)]}")
    figure = Figure(figsize=(8.6, 0.8 + 0.42 * len(groups)), layout="constrained")
    axes = figure.subplots()
    dress(axes)
    rng = np.random.default_rng(0)  # of where the dots stand, nothing else
    for place, (name, given) in enumerate(groups.items()):
        values = np.asarray(given, dtype=float)
        color = PAN if not ours or name in ours else PAPER
        low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
        spread = 0.26 * (rng.random(len(values)) - 0.5)
        axes.barh(place, high - low, left=low, height=0.52, color=color, alpha=0.2, lw=0)
        axes.plot(values, place + spread, "o", ms=3, color=color, alpha=0.6, mew=0)
        axes.plot([middle, middle], [place - 0.3, place + 0.3], color=INK, lw=2)
        axes.annotate(
            f"{middle:{form}}",
            (1.0, place),
            xycoords=("axes fraction", "data"),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            fontsize=8.5,
            color=INK,
        )
    axes.set_yticks(range(len(groups)), list(groups), fontsize=8.5)
    axes.set_ylim(len(groups) - 0.45, -0.55)
    axes.grid(axis="y", visible=False)
    axes.set(xlabel=xlabel)
    axes.annotate(
        "median",
        (1.0, 1.0),
        xycoords="axes fraction",
        xytext=(6, 2),
        textcoords="offset points",
        fontsize=8,
        color=STEEL,
    )
    for words, value in (marks or {}).items():
        axes.axvline(value, color=ACCENT, lw=1.0, ls=":")
        axes.annotate(
            words,
            (value, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=ACCENT,
        )
    return figure


def stack(runs: Sequence[Sequence[float | None]]) -> np.ndarray:
    """Runs of any length as the rows of one array, NaN where there is nothing. Shape (n, longest).

    Raises:
        ValueError: No run, or only empty ones.
    """
    longest = max((len(run) for run in runs), default=0)
    if longest == 0:
        raise ValueError("there is no run to draw")
    stacked = np.full((len(runs), longest), np.nan)
    for row, run in zip(stacked, runs, strict=True):
        row[: len(run)] = np.array(run, dtype=float)
    return stacked


def _moments(stacked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of what is there in each column; NaN where nothing is."""
    there = np.isfinite(stacked)
    count = there.sum(axis=0)
    values = np.where(there, stacked, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = values.sum(axis=0) / count
        sd = np.sqrt((np.where(there, stacked - mean, 0.0) ** 2).sum(axis=0) / count)
    return mean, sd


def _named(*many: Axes) -> tuple[list, list]:
    """Handles and labels of several axes, each label once."""
    found = {}
    for axes in many:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)


def _faint(color: str) -> str:
    """A colour half way to white."""
    parts = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
    return "#" + "".join(f"{round(255 - 0.5 * (255 - part)):02x}" for part in parts)
