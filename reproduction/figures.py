# SPDX-License-Identifier: Apache-2.0
"""Figures of the reproduction: many runs side by side, compared with the paper's.

Functions from data to matplotlib figures, in the style of `figures`; they compute only means and
quantiles.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wam_power_ros.plotting import CYCLE, GREY, INK, STEEL, dress, legend, side_by_side
from wam_power_ros.reporting.terminal import counted

COLORS = (*CYCLE, "#1f1b3d", "#a890a8", "#d878f0", "#45279c", "#780060")
HALO = [patheffects.withStroke(linewidth=3, foreground="white")]


def sessions_over_paper(
    sessions: Mapping[str, Sequence[Sequence[float | None]]], paper: np.ndarray
) -> Figure:
    """Fig. 5: mean return per rollout with standard deviations over the digitised curve.

    A second panel shows the gain: mean of the first and of the last five rollouts of each session.

    Args:
        sessions: Name -> returns of each session, None or NaN where a rollout was not usable;
            sessions of one name may differ in length.
        paper: Rollout and mean return in the paper. Shape (n, 2).

    Raises:
        ValueError: A name has no session.
    """
    figure = Figure(figsize=(9.4, 4.2), layout="constrained")
    axes, gain = figure.subplots(1, 2, width_ratios=(2.7, 1.0), sharey=True)
    dress(axes)
    dress(gain)
    axes.plot(*paper.T, "s-", ms=2.6, lw=1.1, color=GREY, label="paper, Fig. 5, 6 sessions")
    _gain_line(gain, 0, paper[:5, 1].mean(), paper[-5:, 1].mean(), GREY)
    names = ["paper"]
    for place, (name, runs) in enumerate(sessions.items(), start=1):
        stacked = stack(runs)
        color = COLORS[place - 1]
        rollout = np.arange(1, stacked.shape[1] + 1)
        usable = np.isfinite(stacked).any(axis=0)
        mean, sd = (of(stacked[:, usable], axis=0) for of in (np.nanmean, np.nanstd))
        # as in the paper, an error bar at every rollout; shifted a little for each name
        bars = {"elinewidth": 0.6, "ecolor": (color, 0.5), "capsize": 1.5, "capthick": 0.6}
        x = rollout[usable] + 0.16 * (place - 1)
        label = f"{name}, {counted(len(runs), 'session')}"
        axes.errorbar(x, mean, yerr=sd, color=color, lw=1.8, label=label, **bars)
        early, late = first_and_last_five(runs)
        for ends in zip(early, late, strict=True):
            gain.plot([place - 0.28, place + 0.28], ends, color=color, lw=0.6, alpha=0.28)
        _gain_line(gain, place, float(np.mean(early)), float(np.mean(late)), color)
        names.append(name)
    axes.set(xlabel="rollout", ylabel="return (Eq. 5)")
    axes.set_xlim(0.0, None)
    gain.set_xticks(range(len(names)), names, fontsize=8)
    gain.set_xlim(-0.6, len(names) - 0.4)
    gain.grid(axis="x", visible=False)
    gain.set_title("first five to last five", fontsize=9, color=INK)
    legend(axes)
    return figure


def _gain_line(axes: Axes, place: float, early: float, late: float, color: str) -> None:
    axes.plot([place - 0.28, place + 0.28], [early, late], "o-", color=color, lw=2.2, ms=4)
    style = {"ha": "center", "fontsize": 9, "color": INK, "path_effects": HALO}
    above = {"xytext": (0, 9), "textcoords": "offset points"}
    axes.annotate(f"{late - early:+.2f}", (place, max(early, late)), **above, **style)


def first_and_last_five(runs: Sequence[Sequence[float | None]]) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the first five and of the last five usable returns of each session. Shapes (n,)."""
    usable = [row[np.isfinite(row)] for row in stack(runs)]
    return (
        np.array([row[:5].mean() for row in usable if len(row)]),
        np.array([row[-5:].mean() for row in usable if len(row)]),
    )


def learner_curves(
    curves: Mapping[str, Sequence[Sequence[float | None]]],
    ours: Collection[str] = (),
    *,
    ylabel: str,
    marks: Mapping[str, float] | None = None,
) -> Figure:
    """Median over the runs of each learner, with the quartiles as a band.

    Args:
        curves: Name -> values of each run by rollout, None or NaN where there is none: the best
            return so far, or the return of the current mean. Runs may differ in length.
        ours: Names highlighted by thicker lines and darker bands; all if empty.
        ylabel: Label of the values.
        marks: Text -> value of a horizontal line, such as "paper, full" -> 0.73.
    """
    figure, (axes,) = side_by_side(8.6, 4.4, 1.0)
    longest = 0
    for place, (name, runs) in enumerate(curves.items()):
        stacked = stack(runs)
        color = COLORS[place % len(COLORS)]
        strong = not ours or name in ours
        usable = np.isfinite(stacked).any(axis=0)
        x = np.arange(1, stacked.shape[1] + 1)[usable]
        low, middle, high = np.nanquantile(stacked[:, usable], (0.25, 0.5, 0.75), axis=0)
        longest = max(longest, int(x[-1]))
        style = {"lw": 2.3} if strong else {"lw": 1.1, "ls": ("-", "--", "-.", ":")[place % 4]}
        axes.plot(x, middle, color=color, zorder=3 if strong else 2, label=name, **style)
        if len(stacked) > 1:
            alpha = 0.14 if strong else 0.07
            axes.fill_between(x, low, high, color=color, alpha=alpha, lw=0)
    for text, value in (marks or {}).items():
        axes.axhline(value, color=GREY, lw=1.0, ls=":")
        style = {"ha": "right", "fontsize": 8, "color": STEEL, "path_effects": HALO}
        above = {"xytext": (-3, 2), "textcoords": "offset points"}
        axes.annotate(text, (longest, value), **above, **style)
    axes.set(xlabel="rollout", ylabel=ylabel)
    axes.set_xlim(0.0, longest)
    axes.xaxis.get_major_locator().set_params(integer=True)
    legend(axes)
    return figure


def stack(runs: Sequence[Sequence[float | None]]) -> np.ndarray:
    """Runs as rows of one array, padded with NaN. Shape (n, longest).

    Raises:
        ValueError: There is no run, or all are empty.
    """
    longest = max((len(run) for run in runs), default=0)
    if longest == 0:
        raise ValueError("there is no run to draw")
    stacked = np.full((len(runs), longest), np.nan)
    for row, run in zip(stacked, runs, strict=True):
        row[: len(run)] = np.array(run, dtype=float)
    return stacked
