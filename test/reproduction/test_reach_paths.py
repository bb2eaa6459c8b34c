# SPDX-License-Identifier: Apache-2.0
"""Fig. 2 shows paths and obstacle along the movement."""

import numpy as np
import pytest

from reproduction.reach_paths import Panel, paths
from wam_power_ros.regions import Region


def a_panel(executed: np.ndarray | None = None) -> Panel:
    """Half a metre along y, with a sphere half way."""
    path = np.linspace([0.4, -0.25, 0.3], [0.4, 0.25, 0.3], 21)
    demonstrations = [path, path + np.array([0.0, 0.0, 0.01])]
    learnt = path + np.array([0.0, 0.0, 0.1])
    return Panel(demonstrations, Region("box", (0.4, 0.0, 0.3), 0.09), learnt, [path], executed)


def test_reaching_is_drawn_along_the_movement_with_the_obstacle_half_way() -> None:
    drawn = paths({"diagonal": a_panel(), "full": a_panel(np.zeros((5, 3)))})
    side = drawn.axes[0]
    (sphere,) = side.patches
    assert sphere.center[0] == pytest.approx(0.25) and sphere.radius == 0.09
    learnt = next(line for line in side.lines if line.get_label() == "learnt")
    np.testing.assert_allclose(learnt.get_xdata(), np.linspace(0.0, 0.5, 21))
    labels = [{line.get_label() for line in axes.lines} for axes in drawn.axes]
    assert ["executed" in names for names in labels] == [False, True, False, True]
