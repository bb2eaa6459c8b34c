# SPDX-License-Identifier: Apache-2.0
"""Figures show the data they are given."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from wam_power_ros.reporting import figures
from wam_power_ros.tasks.errors import Error


def test_a_learning_curve_holds_every_usable_return() -> None:
    returns = np.array([0.5, np.nan, 0.7, 0.8])
    axes = figures.learning_curve(returns, marks={3: "first flip"}).axes[0]
    dots, mean = (line.get_ydata() for line in axes.lines[:2])
    np.testing.assert_array_equal(dots, returns)
    np.testing.assert_allclose(mean, [0.5, 0.5, 0.6, 2.0 / 3.0])
    assert [text.get_text() for text in axes.texts] == ["first flip"]


def test_each_kind_of_rollout_has_points_of_its_own_and_only_explorations_are_averaged() -> None:
    kinds = ["reproduction", "reproduction", *["explore"] * 2, "mean", "explore", *["retest"] * 3]
    returns = [0.3, 0.4, 0.5, 0.7, 0.8, 0.6, 0.9, 0.9, 0.9]
    axes = figures.learning_curve(returns, kinds).axes[0]
    found = {line.get_label(): line for line in axes.lines}
    for kind, (label, *_) in figures.POINTS.items():
        at = [k + 1 for k, other in enumerate(kinds) if other == kind]
        assert found[label].get_xdata().tolist() == at
    mean = found["average of the last five explorations"]
    assert mean.get_xdata().tolist() == [3, 4, 6]
    np.testing.assert_allclose(mean.get_ydata(), [0.5, 0.6, 0.6])
    assert found["first reproduction"].get_ydata()[0] == 0.3
    (shaded,) = axes.patches
    extent = shaded.get_path().transformed(shaded.get_patch_transform()).get_extents()
    assert (extent.x0, extent.x1) == (6.5, 9.5)


def test_every_known_error_is_drawn_in_its_unit_with_its_tolerance_and_its_limit() -> None:
    far = Error("miss", "m", tolerance=0.02, limit=0.05)
    wanted = [far, Error("turn", "rad", 0.1, target=1.0)]
    values = [{"miss": 9.0}, {"miss": 0.01, "turn": 1.1}, {"miss": np.inf, "turn": 0.9}, {}]
    miss, turn = figures.errors(wanted, values, ["reproduction", "mean", "mean", "mean"]).axes
    drawn = {line.get_label(): line for line in miss.lines}
    assert drawn["limit"].get_ydata()[0] == pytest.approx(50.0)  # [mm]
    assert list(drawn["reproductions"].get_xdata()) == [1]
    assert drawn["reproductions"].get_markerfacecolor() == "none"  # beyond the edge
    shown = {n: y for each in miss.lines[1:] for n, y in zip(*each.get_data(), strict=True)}
    assert shown[2] == pytest.approx(10.0) and shown[1] == shown[3] == miss.get_ylim()[1]
    assert miss.get_title() == "miss [mm]" and turn.get_title() == "turn [°]"
    assert sum(turn.get_ylim()) / 2.0 == pytest.approx(np.degrees(1.0))
    assert not [line for line in turn.lines if line.get_label() == "limit"]
    (band,) = turn.patches
    edges = band.get_path().transformed(band.get_patch_transform()).get_extents()
    assert [edges.y0, edges.y1] == pytest.approx(np.degrees([0.9, 1.1]))


def test_stiffness_about_its_own_mean_is_in_percent() -> None:
    part = np.linspace(0.0, 1.0, 11)
    profile = 300.0 + 30.0 * (part - 0.5)
    figure = figures.stiffness(
        {"level": np.full(5, 450.0), "learnt": profile * np.ones((3, 1))},
        np.array([[1.0, 0.2], [2.0, 0.4]]),
    )
    absolute, relative = figure.axes
    np.testing.assert_allclose(absolute.lines[1].get_ydata(), 450.0)
    np.testing.assert_allclose(absolute.lines[2].get_ydata(), profile)
    np.testing.assert_allclose(relative.lines[2].get_ydata(), 10.0 * (part - 0.5), atol=1e-12)


def test_a_film_has_as_many_frames_as_it_was_given(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frames = list(rng.integers(0, 255, (7, 24, 32, 3), dtype=np.uint8))
    figures.save_film(frames, tmp_path / "film.webp", rate=25.0)
    with Image.open(tmp_path / "film.webp") as film:
        assert film.n_frames == 7
