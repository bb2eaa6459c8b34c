# SPDX-License-Identifier: Apache-2.0
"""Figures of studies show the data they are given."""

import numpy as np
import pytest

from reproduction import figures as study_figures
from reproduction.reach_paths import Panel, paths
from wam_power_ros.regions import Region


def test_learner_curves_are_medians_and_every_learner_is_named_once() -> None:
    curves = {f"learner {k}": [[0.1 * k, 0.2], [0.1 * k, 0.4], [0.1 * k]] for k in range(12)}
    settings = {"ours": ["learner 3"], "ylabel": "return", "marks": {"paper": 0.73}}
    axes = study_figures.learner_curves(curves, **settings).axes[0]
    np.testing.assert_allclose(axes.lines[3].get_ydata(), [0.3, 0.3])
    assert len(axes.collections) == len(curves)  # a band of quartiles each
    assert [text.get_text() for text in axes.get_legend().texts] == [*curves]
    assert [text.get_text() for text in axes.texts] == ["paper"]


def a_panel() -> Panel:
    """Half a metre along y, with a sphere half way."""
    path = np.linspace([0.4, -0.25, 0.3], [0.4, 0.25, 0.3], 21)
    demonstrations = [path, path + np.array([0.0, 0.0, 0.01])]
    learnt = path + np.array([0.0, 0.0, 0.1])
    return Panel(demonstrations, Region("box", (0.4, 0.0, 0.3), 0.09), learnt, [path])


def test_reaching_is_drawn_along_the_movement_with_the_obstacle_half_way() -> None:
    drawn = paths({"diagonal": a_panel(), "full": a_panel()})
    side = drawn.axes[0]
    (sphere,) = side.patches
    assert sphere.center[0] == pytest.approx(0.25) and sphere.radius == 0.09
    learnt = next(line for line in side.lines if line.get_label() == "learnt")
    np.testing.assert_allclose(learnt.get_xdata(), np.linspace(0.0, 0.5, 21))
