# SPDX-License-Identifier: Apache-2.0
"""Figures of sessions of any task and of takes: functions from data to matplotlib figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from wam_power_ros import durable_files
from wam_power_ros.plotting import (
    BLUE,
    CYCLE,
    GREEN,
    GREY,
    GRID,
    ORANGE,
    STEEL,
    dress,
    shared_legend,
    side_by_side,
)
from wam_power_ros.tasks.errors import SHOWN_IN, Error

Limits = tuple[np.ndarray, np.ndarray, np.ndarray]  # lowest, highest [rad], fastest [rad/s]
POINTS = {  # kind of a rollout -> label, marker and colour
    "reproduction": ("reproductions", "D", STEEL),
    "explore": ("explorations", "o", BLUE),
    "mean": ("mean policy", "s", ORANGE),
    "retest": ("re-tests", "^", GREEN),
}


def learning_curve(
    returns: Sequence[float], kinds: Sequence[str] = (), marks: Mapping[int, str] | None = None
) -> Figure:
    """Return over the rollouts of a session by their kind, with an average of explorations.

    The first reproduction, before any learning, is a horizontal line; re-tests, which repeat one
    policy, are shaded and excluded from the average.

    Args:
        returns: Return of each rollout, NaN where it was not usable. Length n.
        kinds: Kind of each rollout, see `session_log.Kind`; all explorations if omitted.
        marks: Rollout number -> text above it, such as "first success".
    """
    figure, (axes,) = side_by_side(7.2, 3.8, 1.0)
    values = np.asarray(returns, dtype=float)
    rollout = np.arange(1, len(values) + 1)
    rollout_kinds = np.array([*kinds] or ["explore"] * len(values))
    tests = rollout[rollout_kinds == "retest"]
    if len(tests):
        axes.axvspan(tests[0] - 0.5, tests[-1] + 0.5, color=GRID, alpha=0.6, lw=0)
    first = values[(rollout_kinds == "reproduction") & np.isfinite(values)][:1]
    for level in first:
        axes.axhline(level, color=STEEL, lw=1.0, ls="--", label="first reproduction")
    for kind, (label, marker, color) in POINTS.items():
        selected = rollout_kinds == kind
        if selected.any():
            style = {"ms": 4.0, "color": color, "alpha": 0.75, "label": label}
            axes.plot(rollout[selected], values[selected], marker, **style)
    explored = rollout_kinds == "explore"
    if explored.any():
        means = _running_mean(values[explored], 5)
        label = "average of the last five explorations"
        axes.plot(rollout[explored], means, color=BLUE, lw=2, label=label)
    top = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "va": "top"}
    for number, text in (marks or {}).items():
        axes.axvline(number, color=GREEN, lw=0.8, ls=":")
        axes.annotate(text, (number, 1.0), xytext=(3, -4), fontsize=8, color=GREEN, **top)
    axes.set(xlabel="rollout", ylabel="return")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_ylim(0.0, 1.08 * axes.dataLim.y1)
    shared_legend(figure, [axes], 4)
    return figure


def errors(
    wanted: Sequence[Error], values: Sequence[Mapping[str, float]], kinds: Sequence[str]
) -> Figure:
    """Measured errors over the rollouts of a session, each in its unit.

    What is far outside is drawn hollow at the edge; what is unknown is not drawn. `wanted` are the
    errors, see `Task.wanted_errors`; `values` by name and `kinds` are those of each rollout.
    """
    columns, rows = min(len(wanted), 2), math.ceil(len(wanted) / 2)
    figure = Figure(figsize=(7.2, 1.7 * rows + 0.4), layout="constrained")
    for place, error in enumerate(wanted, start=1):
        axes = figure.add_subplot(rows, columns, place)
        dress(axes)
        factor, _, unit = SHOWN_IN.get(error.unit, (1.0, "", error.unit))
        given = [each.get(error.name, math.nan) - error.target for each in values]
        off, middle = factor * np.array(given, dtype=float), factor * error.target
        tolerance, limit = factor * error.tolerance, factor * error.limit
        usual = np.quantile([0.0, *np.abs(off[np.isfinite(off)])], 0.75)
        top = 1.2 * max(3.0 * tolerance, limit if math.isfinite(limit) else 0.0, usual)
        bottom = -0.06 * top if not (off < -0.04 * top).any() else -top
        useful = {"color": GREEN, "alpha": 0.15, "lw": 0, "label": "as good as is useful"}
        axes.axhspan(middle + max(-tolerance, bottom), middle + tolerance, **useful)
        for edge in (each for each in (-limit, limit) if bottom < each < top):
            axes.axhline(middle + edge, color=STEEL, lw=0.9, ls="--", label="limit")
        for kind, (label, marker, color) in POINTS.items():
            shown = np.clip(off, bottom, top)
            of_kind = (np.array(kinds) == kind) & ~np.isnan(off)
            for at, fill in ((of_kind & (shown == off), color), (of_kind & (shown != off), "none")):
                style = {"color": color, "mfc": fill, "ms": 4.0, "clip_on": False, "label": label}
                if at.any():
                    axes.plot(np.flatnonzero(at) + 1, middle + shown[at], marker, **style)
        axes.set(xlabel="rollout", ylim=(middle + bottom, middle + top))
        axes.set_title(f"{error.name.replace('_', ' ')} [{unit.strip()}]", fontsize=9)
        axes.xaxis.get_major_locator().set_params(integer=True)
    shared_legend(figure, figure.axes, 6)
    return figure


def stiffness(profiles: Mapping[str, np.ndarray], published: np.ndarray | None = None) -> Figure:
    """Vertical stiffness K33 over the movement, absolute and relative to its mean.

    Args:
        profiles: Name -> K33 at evenly spaced times [1/s^2], of one policy, shape (T,), or several,
            shape (n, T), of which the median and the middle 80 % are drawn.
        published: The paper's times [s] and K33 [1/s^2], drawn behind the data. Shape (m, 2).
    """
    figure, (absolute, relative) = side_by_side(9.4, 3.6, 1.0, 1.0)
    if published is not None:
        time, k33 = published.T
        part = time / time[-1]
        own = np.interp(np.linspace(0.0, 1.0, 101), part, k33).mean()  # not evenly sampled
        absolute.plot(part, k33, "s--", ms=3, lw=1.2, color=GREY, label="paper, learnt")
        relative.plot(part, 100.0 * (k33 / own - 1.0), "s--", ms=3, lw=1.2, color=GREY)
    for color, (name, given) in zip(CYCLE, profiles.items(), strict=False):
        rows = np.atleast_2d(np.asarray(given, dtype=float))
        t = np.linspace(0.0, 1.0, rows.shape[1])
        about = 100.0 * (rows / rows.mean(axis=1, keepdims=True) - 1.0)
        count = f", {len(rows)} policies" if len(rows) > 1 else ""
        for axes, values in ((absolute, rows), (relative, about)):
            low, middle, high = np.quantile(values, (0.1, 0.5, 0.9), axis=0)
            axes.plot(t, middle, color=color, lw=2, label=f"{name}{count}")
            if len(rows) > 1:
                axes.fill_between(t, low, high, color=color, alpha=0.15, lw=0)
    absolute.set(xlabel="time / duration of the movement", ylabel="$K_{33}$ [1/s$^2$]")
    absolute.set_ylim(0.0, None)
    relative.set(xlabel="time / duration of the movement", ylabel="$K_{33}$ about its mean [%]")
    shared_legend(figure, [absolute], 4)
    return figure


def joints(
    movements: Mapping[str, tuple[np.ndarray, np.ndarray]],
    joint_names: Sequence[str],
    limits: Limits | None,
) -> Figure:
    """Joint angles and speeds of takes over time, a row for each joint.

    A movement has times [s] (N,) and smooth joint angles [rad] (N, n). Limits of the arm, if they
    are known, are drawn dashed where they are within view.
    """
    count = len(joint_names)
    figure = Figure(figsize=(9.4, 1.3 * count + 0.9), layout="constrained")
    grid = figure.subplots(count, 2, squeeze=False, sharex=True)
    for joint, (name, (angle, speed)) in enumerate(zip(joint_names, grid, strict=True)):
        for axes in (angle, speed):
            dress(axes)
        for color, (label, (t, q)) in zip(cycle(CYCLE), movements.items(), strict=False):
            angle.plot(t, q[:, joint], color=color, lw=1.4, label=label)
            speed.plot(t, np.gradient(q[:, joint], t), color=color, lw=1.4)
        angle.set_ylabel(f"{name} [rad]")
        if limits is not None:
            low, high, fastest = (values[joint] for values in limits)
            for axes, values in ((angle, (low, high)), (speed, (-fastest, fastest))):
                for value in values:  # outside the view if far away
                    bottom, top = axes.get_ylim()
                    axes.axhline(value, color=STEEL, lw=0.9, ls="--", label="limit")
                    axes.set_ylim(bottom, top)
    grid[0, 0].set_title("angle", fontsize=10)
    grid[0, 1].set_title("speed [rad/s]", fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    shared_legend(figure, [grid[0, 0]], 3)
    return figure


def save_film(frames: Sequence[np.ndarray], path: Path, rate: float) -> None:
    """Write RGB frames (h, w, 3), uint8, as an animated .webp image at a rate [1/s]."""
    from PIL import Image

    first, *others = (Image.fromarray(np.ascontiguousarray(frame)) for frame in frames)
    settings = {"duration": round(1000 / rate), "loop": 0, "quality": 70, "method": 4}
    with durable_files.naming(path):
        first.save(path, format="WEBP", save_all=True, append_images=others, **settings)


def _running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Mean of the usable values among the last `width` up to each index. Shape (n,)."""
    means = np.full(len(values), np.nan)
    for place in range(len(values)):
        window = values[max(0, place - width + 1) : place + 1]
        if np.isfinite(window).any():
            means[place] = window[np.isfinite(window)].mean()
    return means
