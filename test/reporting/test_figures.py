# SPDX-License-Identifier: Apache-2.0
"""Figures show the data they are given."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from wam_power_ros.learning.policy import Basis, Policy
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.reporting import figures


def a_policy(stiffness: float) -> Policy:
    count = 4
    return Policy(
        id="a",
        basis=Basis(count, 1.0, 0.02),
        stiffness=np.tile(stiffness * np.eye(3), (count, 1, 1)),
        attractors=np.zeros((count, 3)),
        damping=30.0,
        orientation_reference=np.array([0.0, 0.0, 0.0, 1.0]),
        rotation_attractors=np.zeros((count, 3)),
        rotation_stiffness=400.0,
        rotation_damping=36.0,
        q_start=np.zeros(7),
    )


def a_toss() -> tuple[EndEffectorPath, BodyPath]:
    """A level pan that stays, a pancake that turns by pi in a second and rises by .5 m."""
    t = np.linspace(0.0, 1.0, 101)
    pan = EndEffectorPath(
        "toss", t, np.tile([0.7, 0.0, 0.4], (101, 1)), np.tile([0.0, 0.0, 0.0, 1.0], (101, 1))
    )
    frames = t[::4]
    half = 0.5 * np.pi * frames
    quat = np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], axis=1)
    position = np.stack([0.7 + 0 * frames, 0 * frames, 0.4 + 2.0 * frames * (1.0 - frames)], axis=1)
    return pan, BodyPath("toss", frames, position, quat)


def test_the_papers_tables_hold_its_anchors() -> None:
    fig5, k33 = figures.paper_table("fig5"), figures.paper_table("k33")
    assert fig5.shape == (50, 2)
    assert fig5[:5, 1].mean() == pytest.approx(0.683, abs=0.001)
    assert fig5[-5:, 1].mean() == pytest.approx(1.034, abs=0.001)
    assert k33[0].tolist() == [0.0, 322.6]


def test_a_learning_curve_holds_every_usable_return_and_the_papers() -> None:
    returns = np.array([0.5, np.nan, 0.7, 0.8])
    axes = figures.learning_curve([returns], {3: "first flip"}).axes[0]
    paper, dots, mean = (line.get_ydata() for line in axes.lines[:3])
    np.testing.assert_array_equal(paper, figures.paper_table("fig5")[:, 1])
    np.testing.assert_array_equal(dots, returns)
    np.testing.assert_allclose(mean, [0.5, 0.5, 0.6, 2.0 / 3.0])
    assert [text.get_text() for text in axes.texts] == ["first flip"]


def test_sessions_of_different_length_are_averaged_where_they_are() -> None:
    axes = figures.learning_curve([np.array([0.4, 0.6]), np.array([0.8, np.nan, 1.0])]).axes[0]
    np.testing.assert_allclose(axes.lines[1].get_ydata(), [0.6, 0.6, 1.0])


def test_no_session_gives_no_learning_curve() -> None:
    with pytest.raises(ValueError, match="at least one session"):
        figures.learning_curve([])


def test_the_bars_of_the_terms_add_up_to_the_return() -> None:
    axes = figures.terms([1, 2], {"angle": [0.2, 0.3], "landing": [0.1, None]}).axes[0]
    tops = {}
    for bar in axes.patches:
        tops[round(bar.get_x() + bar.get_width() / 2)] = bar.get_y() + bar.get_height()
    assert tops == pytest.approx({1: 0.3, 2: 0.3})


def test_the_normal_of_a_flipped_pancake_points_down_in_the_figure() -> None:
    side = figures.rollout(*a_toss(), t_f=0.9).axes[0]
    pan, pancake = side.collections
    assert np.all(pan.V > 0.0)
    assert pancake.V[0] == pytest.approx(figures.NORMAL)
    assert pancake.V[-1] == pytest.approx(-figures.NORMAL)


def test_a_rollout_without_a_single_frame_is_drawn_all_the_same() -> None:
    pan, _ = a_toss()
    empty = BodyPath("toss", np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))
    assert len(figures.rollout(pan, empty).axes[0].lines) == 1


def test_equal_vertical_stiffness_everywhere_is_a_level_line() -> None:
    axes = figures.stiffness({"start": a_policy(300.0), "learnt": a_policy(450.0)}).axes[0]
    np.testing.assert_allclose(axes.lines[1].get_ydata(), 300.0)
    np.testing.assert_allclose(axes.lines[2].get_ydata(), 450.0)


def test_a_filmstrip_goes_from_the_first_frame_to_the_last() -> None:
    frames = [np.full((6, 8, 3), shade, np.uint8) for shade in range(20)]
    strip = figures.filmstrip(frames, count=5, times=np.arange(20) / 10)
    shades = [int(axes.images[0].get_array()[0, 0, 0]) for axes in strip.axes]
    assert (shades[0], shades[-1], len(shades)) == (0, 19, 5)
    assert strip.axes[-1].get_xlabel() == "1.90 s"


@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_a_film_has_as_many_frames_as_it_was_given(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(0)
    frames = list(rng.integers(0, 255, (7, 24, 32, 3), dtype=np.uint8))
    figures.save_film(frames, tmp_path / f"film{suffix}", rate=25.0)
    with Image.open(tmp_path / f"film{suffix}") as film:
        assert film.n_frames == 7


def test_the_same_figure_is_the_same_file() -> None:
    one, other = (figures.svg(figures.learning_curve([np.array([0.5, 0.6])])) for _ in range(2))
    assert one == other
    assert b"<svg" in one
