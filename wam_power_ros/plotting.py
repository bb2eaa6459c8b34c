# SPDX-License-Identifier: Apache-2.0
"""Common style of figures, and their files.

Figures are created without pyplot: no window, no global state, any number at a time.
"""

from __future__ import annotations

import io
from collections.abc import Iterable

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, GRID, GREY, STEEL = "#24292f", "#e3e6ea", "#8b949e", "#5b6570"
BLUE, ORANGE, GREEN = "#3b6ea5", "#d98324", "#2f855a"
# Distinct for colour-blind readers, too (CIELAB distances of 12 and more, deutan to tritan).
CYCLE = (BLUE, ORANGE, GREEN, "#9b3fe0", "#8a1c1c")


def svg(figure: Figure) -> bytes:
    """Content of an SVG file of a figure, the same bytes for the same figure."""
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
