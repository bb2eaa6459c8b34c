# SPDX-License-Identifier: Apache-2.0
"""Fig. 2 of the paper: paths around the obstacle, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from wam_power_ros.plotting import BLUE, GREEN, INK, dress, shared_legend
from wam_power_ros.regions import Region
from wam_power_ros.tasks.reach.figures import OBSTACLE, side_and_top

LEARNT, ROLLOUT = "#1d5c3a", "#8fc3a5"


@dataclass(frozen=True, eq=False)
class Panel:
    """A panel: paths of shapes (T, 3) [m]."""

    demonstrations: Sequence[np.ndarray]
    obstacle: Region
    learnt: np.ndarray  # of the learnt policy, drawn bold
    rollouts: Sequence[np.ndarray] = ()  # further ones

    @property
    def start(self) -> np.ndarray:
        """Mean first position of the demonstrations [m]. Shape (3,)."""
        return np.mean([path[0] for path in self.demonstrations], axis=0)

    @property
    def goal(self) -> np.ndarray:
        """Mean last position of the demonstrations [m]. Shape (3,)."""
        return np.mean([path[-1] for path in self.demonstrations], axis=0)


def paths(panels: Mapping[str, Panel]) -> Figure:
    """Panels by their titles, such as "full", from the side and from above.

    Axes are those of `side_and_top`, from the mean start of the demonstrations to their mean end.
    """
    figure = Figure(figsize=(4.4 * len(panels) + 0.6, 5.4), layout="constrained")
    grid = figure.subplots(2, len(panels), squeeze=False, sharex=True, sharey="row")
    for column, (title, panel) in zip(grid.T, panels.items(), strict=True):
        views = side_and_top(panel.goal - panel.start)
        for axes, view in zip(column, views, strict=True):
            _draw(axes, panel, view)
            axes.set_aspect("equal")
        column[0].set_title(title, fontsize=10, color=INK)
        column[1].set_xlabel("along the movement [m]")
    grid[0, 0].set_ylabel("up [m]")
    grid[1, 0].set_ylabel("aside [m]")
    shared_legend(figure, grid[0], 4)
    return figure


def _draw(axes: Axes, panel: Panel, view: np.ndarray) -> None:
    def plot(path: np.ndarray, *style: str, **other: Any) -> None:  # noqa: ANN401
        axes.plot(*(view @ (np.atleast_2d(path) - panel.start).T), *style, **other)

    dress(axes)
    style: dict[str, Any] = {"color": OBSTACLE, "alpha": 0.28, "lw": 0, "label": "obstacle"}
    x, y = view @ (panel.obstacle.centre - panel.start)
    axes.add_patch(Circle((x, y), panel.obstacle.radius, **style))
    for path in panel.rollouts:
        plot(path, color=ROLLOUT, lw=0.6, alpha=0.8, label="rollouts while learning")
    for path in panel.demonstrations:
        plot(path, color=BLUE, lw=1.1, label="demonstrations")
    plot(panel.learnt, color=LEARNT, lw=2.6, label="learnt")
    plot(panel.learnt[0], "o", color=GREEN, ms=6, label="start")
    plot(panel.goal, "s", color=GREEN, ms=8, label="goal")
