# SPDX-License-Identifier: Apache-2.0
"""Figures of a session: data in, matplotlib figures out; nothing is shown or written here.

Figures are made without pyplot: no window, no global state, any number of them at once.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wam_power_ros import rotations
from wam_power_ros.learning.dmp import activations
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath

INK, GRID, PAPER = "#24292f", "#e3e6ea", "#8b949e"
PAN, PANCAKE, ACCENT = "#3b6ea5", "#d98324", "#2f855a"
CYCLE = (PAN, PANCAKE, ACCENT, "#8057a8", "#b4455a")
NORMAL = 0.06  # drawn length of a normal [m]


def paper_table(name: str) -> np.ndarray:
    """Figures of the paper, read off its plots. Shape (n, 2).

    Args:
        name: `"fig5"`, rollout and mean return of six sessions (Fig. 5); or `"k33"`, time [s] and
            vertical stiffness [1/s^2] of the learnt policy.

    Raises:
        FileNotFoundError: There is no such table.
    """
    text = (resources.files("wam_power_ros") / "data" / f"{name}.csv").read_text()
    return np.array(list(csv.reader(io.StringIO(text)))[1:], dtype=float)


def learning_curve(
    sessions: Sequence[np.ndarray],
    marks: Mapping[int, str] | None = None,
    *,
    paper: bool = True,
) -> Figure:
    """Return over rollouts.

    Args:
        sessions: Returns of each session, NaN where a rollout was not usable. Shapes (n_k,).
        marks: Rollout number -> a word to be written above it, such as "first flip".
        paper: Draw Fig. 5 of the paper behind it: returns must be those of Eq. 5.

    Returns:
        With several sessions their mean and standard deviation per rollout, else every rollout and
        a running mean of five.

    Raises:
        ValueError: No session.
    """
    if not sessions:
        raise ValueError("a learning curve needs at least one session")
    figure, axes = _figure(7.2, 3.8)
    if paper:
        mean_of_six = paper_table("fig5").T
        axes.plot(*mean_of_six, color=PAPER, lw=1.2, label="paper, Fig. 5 (mean of 6 sessions)")
    longest = max(len(returns) for returns in sessions)
    stacked = np.full((len(sessions), longest), np.nan)
    for row, returns in zip(stacked, sessions, strict=True):
        row[: len(returns)] = returns
    rollout = np.arange(1, longest + 1)
    if len(sessions) == 1:
        axes.plot(rollout, stacked[0], "o", ms=3.5, color=PAN, alpha=0.55, label="rollouts")
        axes.plot(rollout, _running_mean(stacked[0], 5), color=PAN, lw=2, label="mean of five")
    else:
        some = np.isfinite(stacked).any(axis=0)
        mean, spread = (np.full(longest, np.nan) for _ in range(2))
        mean[some] = np.nanmean(stacked[:, some], axis=0)
        spread[some] = np.nanstd(stacked[:, some], axis=0)
        axes.plot(rollout, mean, color=PAN, lw=2, label=f"mean of {len(sessions)} sessions")
        axes.fill_between(rollout, mean - spread, mean + spread, color=PAN, alpha=0.18, lw=0)
    for number, word in (marks or {}).items():
        axes.axvline(number, color=ACCENT, lw=0.8, ls=":")
        axes.annotate(
            word,
            (number, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(3, -4),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=ACCENT,
        )
    axes.set(xlabel="rollout", ylabel="return")
    _from_zero(axes)
    legend(axes)
    return figure


def terms(numbers: Sequence[int], values: Mapping[str, Sequence[float | None]]) -> Figure:
    """What each return consisted of, one stacked bar a rollout.

    Args:
        numbers: Of the rollouts. Length n.
        values: Term -> its share of the return, None where unknown. Lengths n.
    """
    figure, axes = _figure(7.2, 2.8)
    bottom = np.zeros(len(numbers))
    for place, (name, given) in enumerate(values.items()):
        heights = np.nan_to_num(np.array(given, dtype=float))
        color = CYCLE[place % len(CYCLE)]
        axes.bar(numbers, heights, bottom=bottom, width=0.85, color=color, label=name)
        bottom += heights
    axes.set(xlabel="rollout", ylabel="return")
    legend(axes)
    return figure


def rollout(pan: EndEffectorPath, pancake: BodyPath, t_f: float | None = None) -> Figure:
    """A rollout seen from the side, as in Figs. 3-4 of the paper, and its heights over time.

    Arrows are the normals of pan and pancake; the pancake's is the direction fixed in it that
    pointed along the pan's normal in its first frame.

    Args:
        pan: Path of the pan.
        pancake: Path of the pancake; may be empty.
        t_f: When the fall was judged [s], marked when given.
    """
    figure = Figure(figsize=(8.6, 4.0), layout="constrained")
    side, height = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    dress(side)
    dress(height)
    every = max(1, round(len(pan.t) / 18))
    pan_normals = rotations.matrix(pan.quat_xyzw)[:, :, 2]  # (T, 3)
    side.plot(pan.position[:, 0], pan.position[:, 2], color=PAN, lw=1.5, label="pan")
    _arrows(side, pan.position[::every], pan_normals[::every], PAN)
    height.plot(pan.t, pan.position[:, 2], color=PAN, lw=1.5, label="pan")
    if len(pancake.t):
        turns = rotations.matrix(pancake.quat_xyzw)  # (M, 3, 3)
        start = pan_normals[np.abs(pan.t - pancake.t[0]).argmin()]
        normals = turns @ (turns[0].T @ start)
        side.plot(
            pancake.position[:, 0],
            pancake.position[:, 2],
            "o--",
            ms=2.5,
            lw=0.8,
            color=PANCAKE,
            label="pancake",
        )
        _arrows(side, pancake.position, normals, PANCAKE)
        height.plot(
            pancake.t, pancake.position[:, 2], "o", ms=2.5, color=PANCAKE, label="pancake (camera)"
        )
    if t_f is not None:
        height.axvline(t_f, color=ACCENT, lw=0.8, ls=":", label="$t_f$")
    side.set_aspect("equal", adjustable="datalim")
    side.set(xlabel="x, outward [m]", ylabel="z, up [m]")
    height.set(xlabel="time [s]", ylabel="z, up [m]")
    legend(side)
    legend(height)
    return figure


def stiffness(policies: Mapping[str, Policy]) -> Figure:
    """Vertical stiffness K33(t) = sum_i h_i(t) K_i,33 of each policy, beside the paper's.

    Args:
        policies: Name -> policy, such as the start and the learnt one.
    """
    figure, axes = _figure(7.2, 3.0)
    paper = paper_table("k33")
    axes.plot(
        paper[:, 0] / paper[-1, 0], paper[:, 1], "s--", ms=3, color=PAPER, label="paper, learnt"
    )
    for color, (name, policy) in zip(CYCLE, policies.items(), strict=False):
        t = np.linspace(0.0, policy.basis.duration, 200)
        vertical = activations(policy.basis, t) @ policy.stiffness[:, 2, 2]
        axes.plot(t / policy.basis.duration, vertical, color=color, lw=1.8, label=name)
    axes.set(xlabel="part of the movement", ylabel="$K_{33}$ [1/s$^2$]")
    _from_zero(axes)
    legend(axes)
    return figure


def filmstrip(frames: Sequence[np.ndarray], count: int = 8, times: Sequence[float] = ()) -> Figure:
    """Some frames of a film side by side, evenly picked from first to last.

    Args:
        frames: RGB images. Shapes (h, w, 3), uint8.
        count: At most so many are shown.
        times: Of the frames [s], written below each; may be left out.

    Raises:
        ValueError: No frames.
    """
    if not frames:
        raise ValueError("a filmstrip needs at least one frame")
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(count, len(frames))).round().astype(int))
    high, wide = frames[0].shape[:2]
    width = 10.0 / len(chosen)
    figure = Figure(figsize=(10.0, width * high / wide + 0.25), layout="constrained")
    row = figure.subplots(1, len(chosen), squeeze=False)[0]
    for axes, index in zip(row, chosen, strict=True):
        axes.imshow(frames[index])
        axes.set_xticks([])
        axes.set_yticks([])
        axes.spines[:].set_visible(False)
        if len(times):
            axes.set_xlabel(f"{times[index]:.2f} s", fontsize=8, color=INK)
    return figure


def save_film(frames: Sequence[np.ndarray], path: Path, rate: float) -> None:
    """Write frames as an animated image, .webp (small) or .gif, by the path's suffix.

    Args:
        frames: RGB images. Shapes (h, w, 3), uint8.
        path: Where to.
        rate: Frames per second.

    Raises:
        ValueError: No frames, or another suffix.
    """
    from PIL import Image

    if not frames:
        raise ValueError("a film needs at least one frame")
    if path.suffix not in (".webp", ".gif"):
        raise ValueError(f"a film is .webp or .gif, not {path.suffix!r}")
    first, *others = (Image.fromarray(np.ascontiguousarray(frame)) for frame in frames)
    first.save(
        path,
        save_all=True,
        append_images=others,
        duration=round(1000 / rate),
        loop=0,
        **({"quality": 70, "method": 4} if path.suffix == ".webp" else {}),
    )


def svg(figure: Figure) -> bytes:
    """A figure as an SVG file, the same bytes for the same figure."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "wam_power_ros"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def png(figure: Figure, dpi: int = 200) -> bytes:
    """A figure as a PNG file, the same bytes for the same figure."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    dress(axes)
    return figure, axes


def dress(axes: Axes) -> None:
    """The look all figures share."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GRID)
    axes.grid(color=GRID, lw=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, labelsize=8, length=0)
    axes.xaxis.label.set(color=INK, size=9)
    axes.yaxis.label.set(color=INK, size=9)


def legend(axes: Axes) -> None:
    """Legend above the axes, where it hides nothing."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, fontsize=8)


def _from_zero(axes: Axes) -> None:
    axes.set_ylim(0.0, 1.08 * axes.dataLim.y1)


def _arrows(axes: Axes, places: np.ndarray, normals: np.ndarray, color: str) -> None:
    """Normals (m, 3) at places (m, 3), in the x-z plane."""
    axes.quiver(
        places[:, 0],
        places[:, 2],
        NORMAL * normals[:, 0],
        NORMAL * normals[:, 2],
        color=color,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.004,
        alpha=0.8,
    )


def _running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Mean of the last `width` usable values up to each place. Shape (n,)."""
    means = np.full(len(values), np.nan)
    for place in range(len(values)):
        window = values[max(0, place - width + 1) : place + 1]
        usable = window[np.isfinite(window)]
        if len(usable):
            means[place] = usable.mean()
    return means
