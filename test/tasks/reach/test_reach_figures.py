# SPDX-License-Identifier: Apache-2.0
"""The figure of a reach shows both paths and the obstacle along the movement."""

import numpy as np
import pytest

from wam_power_ros.regions import Region
from wam_power_ros.tasks.reach.figures import executed

PATH = np.linspace([0.4, -0.25, 0.3], [0.4, 0.25, 0.3], 21)  # half a metre along y


def test_a_reach_is_drawn_along_the_movement_with_the_obstacle_half_way() -> None:
    tool = PATH + np.array([0.02, 0.0, 0.1])
    side, top = executed(tool, PATH, Region("box", (0.4, 0.0, 0.3), 0.09)).axes
    for axes, aside in ((side, 0.1), (top, -0.02)):
        (sphere,) = axes.patches
        assert sphere.center[0] == pytest.approx(0.25) and sphere.radius == 0.09
        drawn = next(line for line in axes.lines if line.get_label() == "executed")
        np.testing.assert_allclose(drawn.get_xdata(), np.linspace(0.0, 0.5, 21))
        np.testing.assert_allclose(drawn.get_ydata(), aside)
    assert not executed(PATH, PATH, None).axes[0].patches
