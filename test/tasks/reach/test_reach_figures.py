# SPDX-License-Identifier: Apache-2.0
"""Figures of the reaching task show paths and obstacle along the movement."""

import dataclasses

import numpy as np
import pytest

from wam_power_ros.regions import Region
from wam_power_ros.tasks.reach import figures
from wam_power_ros.tasks.reach.figures import Panel


def a_panel(executed: np.ndarray | None = None) -> Panel:
    """Half a metre along y, with a sphere half way."""
    path = np.linspace([0.4, -0.25, 0.3], [0.4, 0.25, 0.3], 21)
    demonstrations = [path, path + np.array([0.0, 0.0, 0.01])]
    learnt = path + np.array([0.0, 0.0, 0.1])
    return Panel(demonstrations, Region("box", (0.4, 0.0, 0.3), 0.09), learnt, [path], executed)


def test_reaching_is_drawn_along_the_movement_with_the_obstacle_half_way() -> None:
    drawn = figures.paths({"diagonal": a_panel(), "full": a_panel(np.zeros((5, 3)))})
    side = drawn.axes[0]
    (sphere,) = side.patches
    assert sphere.center[0] == pytest.approx(0.25) and sphere.radius == 0.09
    learnt = next(line for line in side.lines if line.get_label() == "learnt")
    np.testing.assert_allclose(learnt.get_xdata(), np.linspace(0.0, 0.5, 21))
    labels = [{line.get_label() for line in axes.lines} for axes in drawn.axes]
    assert ["executed" in names for names in labels] == [False, True, False, True]


def test_no_path_leaves_the_view() -> None:
    away = a_panel().learnt + np.array([0.3, 0.5, 0.4])
    for axes in figures.paths({"full": a_panel(executed=away)}).axes:
        executed = next(line for line in axes.lines if line.get_label() == "executed")
        assert executed.get_xdata().max() < axes.get_xlim()[1]
        assert axes.get_ylim()[0] < executed.get_ydata().min()
        assert executed.get_ydata().max() < axes.get_ylim()[1]


def test_a_panel_without_a_learnt_path_shows_the_demonstrations() -> None:
    bare = dataclasses.replace(a_panel(), learnt=None, rollouts=[], obstacle=None)
    axes = figures.paths({"": bare}).axes[0]
    labels = {line.get_label() for line in axes.lines}
    assert not axes.patches
    assert {"demonstrations", "start", "goal"} <= labels and "learnt" not in labels


def test_a_figure_without_a_panel_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        figures.paths({})
