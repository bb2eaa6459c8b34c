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
MARGIN = 0.03  # around the paths [m]


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
    boxes = []  # lowest and highest drawn coordinates of each panel and view
    for panel in panels.values():
        sphere = panel.obstacle
        other = [sphere.centre + sphere.radius * np.array([[-1.0] * 3, [1.0] * 3]), panel.learnt]
        drawn = np.concatenate([*panel.demonstrations, *panel.rollouts, *other])
        for view in side_and_top(panel.goal - panel.start):
            seen = (drawn - panel.start) @ view.T
            boxes.append((seen.min(axis=0) - MARGIN, seen.max(axis=0) + MARGIN))
    low, high = (  # (2 views, 2 axes)
        np.stack([edge([box[k] for box in boxes[row::2]], axis=0) for row in (0, 1)])
        for k, edge in enumerate((np.min, np.max))
    )
    low[:, 0], high[:, 0] = low[:, 0].min(), high[:, 0].max()
    width = 4.4
    heights = width * (high - low)[:, 1] / (high - low)[:, 0]
    figure = Figure(figsize=(width * len(panels) + 0.6, heights.sum() + 1.4), layout="compressed")
    grid = figure.subplots(2, len(panels), squeeze=False, height_ratios=heights)
    for column, (title, panel) in zip(grid.T, panels.items(), strict=True):
        views = side_and_top(panel.goal - panel.start)
        for row, (axes, view) in enumerate(zip(column, views, strict=True)):
            _draw(axes, panel, view)
            axes.set(xlim=(low[row, 0], high[row, 0]), ylim=(low[row, 1], high[row, 1]))
            axes.set_aspect("equal")
        column[0].set_title(title, fontsize=10, color=INK)
        column[0].tick_params(labelbottom=False)
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
