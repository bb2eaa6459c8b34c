# SPDX-License-Identifier: Apache-2.0
"""Figures of many runs show the data they are given, beside the paper's."""

import numpy as np
import pytest
from test_figures import a_toss

from wam_power_ros.reporting import figures, study_figures
from wam_power_ros.reporting.study_figures import Reaching


def a_panel(executed: np.ndarray | None = None) -> Reaching:
    """Half a metre along y, with a sphere half way."""
    path = np.linspace([0.4, -0.25, 0.3], [0.4, 0.25, 0.3], 21)
    paths = [path, path + np.array([0.0, 0.0, 0.01])]
    middle = np.array([0.4, 0.0, 0.3])
    return Reaching(
        paths, [path], path + np.array([0.0, 0.0, 0.1]), path[-1], middle, 0.09, executed
    )


def test_reaching_is_drawn_along_the_movement_with_the_obstacle_half_way() -> None:
    figure = study_figures.reaching({"diagonal": a_panel(), "full": a_panel(np.zeros((5, 3)))})
    side = figure.axes[0]
    (sphere,) = side.patches
    assert sphere.center[0] == pytest.approx(0.25) and sphere.radius == 0.09
    learnt = next(line for line in side.lines if line.get_label() == "learnt")
    np.testing.assert_allclose(learnt.get_xdata(), np.linspace(0.0, 0.5, 21))
    labels = [{line.get_label() for line in axes.lines} for axes in figure.axes]
    assert ["executed" in names for names in labels] == [False, True, False, True]


def test_a_flipped_pancake_shows_its_other_side() -> None:
    pan, pancake = a_toss()
    axes = study_figures.flights({"flipped": (pan, pancake, 0.9)}).axes[0]
    upper = [np.mean(line.get_ydata()) for line in axes.lines if line.get_color() == "#e3a72f"]
    lower = [np.mean(line.get_ydata()) for line in axes.lines if line.get_color() == "#7a4a1c"]
    lower = lower[1:]  # the first brown line is the path
    assert upper[0] > lower[0] and upper[-1] < lower[-1]
    mark = next(line for line in axes.lines if line.get_label() == "$t_f$")
    assert mark.get_ydata()[0] == pytest.approx(np.interp(0.9, pancake.t, pancake.position[:, 2]))


def test_figure_5_has_our_mean_and_the_gain_from_the_first_five_to_the_last() -> None:
    runs = [[0.5] * 5 + [None] + [0.9] * 5, [0.7] * 5 + [1.1] * 5]
    early, late = study_figures.first_and_last_five(runs)
    np.testing.assert_allclose(early, [0.5, 0.7])
    np.testing.assert_allclose(late, [0.9, 1.1])
    axes, gain = study_figures.sessions_over_paper({"ours": runs}).axes
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), figures.paper_table("fig5")[:, 1])
    ours = axes.containers[0].lines[0].get_ydata()
    np.testing.assert_allclose(ours[[0, 5, 6]], [0.6, 1.1, 1.0])  # of those that are there
    assert [text.get_text() for text in gain.texts] == ["+0.35", "+0.40"]


def test_stiffness_about_its_own_mean_is_in_percent() -> None:
    t = np.linspace(0.0, 1.0, 11)
    figure = study_figures.stiffness_profiles(
        t, {"learnt": 300.0 + 30.0 * (t - 0.5) * np.ones((3, 1))}
    )
    absolute, relative = figure.axes
    np.testing.assert_allclose(absolute.lines[1].get_ydata(), 300.0 + 30.0 * (t - 0.5))
    np.testing.assert_allclose(relative.lines[1].get_ydata(), 10.0 * (t - 0.5), atol=1e-12)


def test_learner_curves_are_medians_and_every_learner_is_named_once() -> None:
    curves = {f"learner {k}": [[0.1 * k, 0.2], [0.1 * k, 0.4], [0.1 * k]] for k in range(12)}
    axes = study_figures.learner_curves(curves, ours=["learner 3"], marks={"paper": 0.73}).axes[0]
    np.testing.assert_allclose(axes.lines[3].get_ydata(), [0.3, 0.3])
    assert sorted(t.get_text() for t in axes.texts) == sorted(["paper", *curves])
    places = sorted(t.xyann[1] for t in axes.texts if t.get_text() != "paper")
    assert min(np.diff(places)) > 0.04  # no name over another


def test_strips_hold_every_value_and_the_median() -> None:
    groups = {"PoWER": [0.5, 0.7, 0.6], "ours": [0.8, 0.9]}
    axes = study_figures.strips(groups, marks={"paper": 0.73}).axes[0]
    np.testing.assert_array_equal(axes.lines[0].get_xdata(), groups["PoWER"])
    said = [text.get_text() for text in axes.texts]
    assert said == ["0.600", "0.850", "median", "paper"]


@pytest.mark.parametrize("draw", [study_figures.reaching, study_figures.flights])
def test_a_figure_of_nothing_is_refused(draw: object) -> None:
    with pytest.raises(ValueError, match="at least one"):
        draw({})


def test_a_group_without_values_is_named() -> None:
    with pytest.raises(ValueError, match="empty"):
        study_figures.strips({"full": [1.0], "empty": []})
    with pytest.raises(ValueError, match="no run"):
        study_figures.learner_curves({"none": []})
