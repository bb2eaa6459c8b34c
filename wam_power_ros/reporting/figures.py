# SPDX-License-Identifier: Apache-2.0
"""Figures of a session: functions from data to matplotlib figures.

Figures are created without pyplot: no window, no global state, any number at a time.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, GRID, PAPER, STEEL = "#24292f", "#e3e6ea", "#8b949e", "#5b6570"
PAN, PANCAKE, ACCENT = "#3b6ea5", "#d98324", "#2f855a"
# Distinct for colour-blind readers, too (CIELAB distances of 12 and more, deutan to tritan).
CYCLE = (PAN, PANCAKE, ACCENT, "#9b3fe0", "#8a1c1c")
POINTS = {  # kind of a rollout -> label, marker and colour
    "reproduction": ("reproductions", "D", STEEL),
    "explore": ("explorations", "o", PAN),
    "mean": ("the mean", "s", PANCAKE),
    "retest": ("re-tests", "^", ACCENT),
}


def paper_table(name: str) -> np.ndarray:
    """Curve digitised from a plot of the paper. Shape (n, 2).

    Args:
        name: `"fig5"`, rollout and mean return of six sessions (Fig. 5); or `"k33"`, time [s] and
            vertical stiffness [1/s^2] of the learnt policy.

    Raises:
        FileNotFoundError: There is no curve of this name.
    """
    text = (resources.files("wam_power_ros") / "data" / f"{name}.csv").read_text()
    return np.array(list(csv.reader(io.StringIO(text)))[1:], dtype=float)


def learning_curve(
    returns: Sequence[float],
    kinds: Sequence[str] = (),
    marks: Mapping[int, str] | None = None,
    *,
    paper: bool,
) -> Figure:
    """Return over the rollouts of a session by their kind, with a running mean of explorations.

    The first reproduction, before any learning, is a horizontal line; re-tests, which repeat one
    policy, are shaded and excluded from the mean.

    Args:
        returns: Return of each rollout, NaN where it was not usable. Length n.
        kinds: Kind of each rollout, see `session_log.Kind`; all explorations if omitted.
        marks: Rollout number -> text above it, such as "first success".
        paper: Draw Fig. 5 of the paper behind the data: returns must be those of Eq. 5.
    """
    figure, (axes,) = side_by_side(7.2, 3.8, 1.0)
    values = np.asarray(returns, dtype=float)
    rollout = np.arange(1, len(values) + 1)
    rollout_kinds = np.array([*kinds] or ["explore"] * len(values))
    tests = rollout[rollout_kinds == "retest"]
    if len(tests):
        axes.axvspan(tests[0] - 0.5, tests[-1] + 0.5, color=GRID, alpha=0.6, lw=0)
    if paper:
        mean_of_six = paper_table("fig5").T
        axes.plot(*mean_of_six, color=PAPER, lw=1.2, label="paper, Fig. 5 (mean of 6 sessions)")
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
        axes.plot(
            rollout[explored], means, color=PAN, lw=2, label="mean of up to five explorations"
        )
    top = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "va": "top"}
    for number, text in (marks or {}).items():
        axes.axvline(number, color=ACCENT, lw=0.8, ls=":")
        axes.annotate(text, (number, 1.0), xytext=(3, -4), fontsize=8, color=ACCENT, **top)
    axes.set(xlabel="rollout", ylabel="return")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_ylim(0.0, 1.08 * axes.dataLim.y1)
    shared_legend(figure, [axes], 4)
    return figure


def terms(numbers: Sequence[int], values: Mapping[str, Sequence[float | None]]) -> Figure:
    """Terms of the returns, one stacked bar per rollout.

    Args:
        numbers: Numbers of the rollouts. Length n.
        values: Name of a term -> its values, None where unknown. Lengths n.
    """
    figure, (axes,) = side_by_side(7.2, 2.8, 1.0)
    bottom = np.zeros(len(numbers))
    for place, (name, given) in enumerate(values.items()):
        heights = np.nan_to_num(np.array(given, dtype=float))
        color = CYCLE[place % len(CYCLE)]
        axes.bar(numbers, heights, bottom=bottom, width=0.85, color=color, label=name)
        bottom += heights
    axes.set(xlabel="rollout", ylabel="return")
    axes.xaxis.get_major_locator().set_params(integer=True)
    legend(axes)
    return figure


def stiffness(profiles: Mapping[str, np.ndarray], *, paper: bool) -> Figure:
    """Vertical stiffness K33 over the movement, absolute and relative to its mean.

    Args:
        profiles: Name -> K33 at evenly spaced times [1/s^2], of one policy, shape (T,), or several,
            shape (n, T), of which the median and the middle 80 % are drawn.
        paper: Draw the learnt policy of the paper, too.
    """
    figure, (absolute, relative) = side_by_side(9.4, 3.6, 1.0, 1.0)
    if paper:
        time, k33 = paper_table("k33").T
        part = time / time[-1]
        own = np.interp(np.linspace(0.0, 1.0, 101), part, k33).mean()  # not evenly sampled
        absolute.plot(part, k33, "s--", ms=3, lw=1.2, color=PAPER, label="paper, learnt")
        relative.plot(part, 100.0 * (k33 / own - 1.0), "s--", ms=3, lw=1.2, color=PAPER)
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
    absolute.set(xlabel="part of the movement", ylabel="$K_{33}$ [1/s$^2$]")
    absolute.set_ylim(0.0, None)
    relative.set(xlabel="part of the movement", ylabel="$K_{33}$ about its mean [%]")
    shared_legend(figure, [absolute], 4)
    return figure


def save_film(frames: Sequence[np.ndarray], path: Path, rate: float) -> None:
    """Write frames as an animated .webp image.

    Args:
        frames: RGB images. Shapes (h, w, 3), uint8.
        path: File to write.
        rate: Frames per second.

    Raises:
        ValueError: There are no frames.
    """
    from PIL import Image

    if not frames:
        raise ValueError("a film must have at least one frame, got none")
    first, *others = (Image.fromarray(np.ascontiguousarray(frame)) for frame in frames)
    settings = {"duration": round(1000 / rate), "loop": 0, "quality": 70, "method": 4}
    first.save(path, format="WEBP", save_all=True, append_images=others, **settings)


def svg(figure: Figure) -> bytes:
    """Content of an SVG file of a figure, the same bytes for the same figure."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "wam_power_ros"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def png(figure: Figure) -> bytes:
    """Content of a PNG file of a figure, the same bytes for the same figure."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=200, metadata={"Software": None})
    return buffer.getvalue()


def side_by_side(width: float, height: float, *widths: float) -> tuple[Figure, list[Axes]]:
    """Create a figure of this size [inch] with axes side by side, of these relative widths."""
    figure = Figure(figsize=(width, height), layout="constrained")
    row = list(figure.subplots(1, len(widths), squeeze=False, width_ratios=widths)[0])
    for axes in row:
        dress(axes)
    return figure, row


def dress(axes: Axes) -> None:
    """Apply the common style to axes."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GRID)
    axes.grid(color=GRID, lw=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, labelsize=8, length=0)
    axes.xaxis.label.set(color=INK, size=9)
    axes.yaxis.label.set(color=INK, size=9)


def legend(axes: Axes) -> None:
    """Add a legend above the axes, where it hides no data."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, fontsize=8)


def shared_legend(figure: Figure, many: Iterable[Axes], columns: int) -> None:
    """Add a legend below a figure with each label of its axes once."""
    found = {}
    for axes in many:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    place = {"loc": "outside lower center", "frameon": False, "fontsize": 8}
    figure.legend(list(found.values()), list(found), ncols=columns, **place)


def _running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Mean of the usable values among the last `width` up to each index. Shape (n,)."""
    means = np.full(len(values), np.nan)
    for place in range(len(values)):
        window = values[max(0, place - width + 1) : place + 1]
        if np.isfinite(window).any():
            means[place] = window[np.isfinite(window)].mean()
    return means
