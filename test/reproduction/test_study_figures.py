# SPDX-License-Identifier: Apache-2.0
"""Figures of studies show the data they are given."""

import numpy as np
import pytest

from reproduction import figures as study_figures
from reproduction.paper_curves import FIG5
from reproduction.reach_paths import Panel, paths
from wam_power_ros.regions import Region


def test_figure_5_has_our_mean_and_the_gain_from_the_first_five_to_the_last() -> None:
    runs = [[0.5] * 5 + [None] + [0.9] * 5, [0.7] * 5 + [1.1] * 5]
    early, late = study_figures.first_and_last_five(runs)
    np.testing.assert_allclose(early, [0.5, 0.7])
    np.testing.assert_allclose(late, [0.9, 1.1])
    axes, gain = study_figures.sessions_over_paper({"ours": runs}, FIG5).axes
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), FIG5[:, 1])
    ours = axes.containers[0].lines[0].get_ydata()
    np.testing.assert_allclose(ours[[0, 5, 6]], [0.6, 1.1, 1.0])  # of those that are there
    assert [text.get_text() for text in gain.texts] == ["+0.35", "+0.40"]


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
