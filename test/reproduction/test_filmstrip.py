# SPDX-License-Identifier: Apache-2.0
"""A filmstrip shows frames at even times, or the reason why it has none."""

from collections.abc import Sequence

import numpy as np
import pytest

from reproduction import filmstrip


def test_frames_are_evenly_spaced_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    rendered: list[float] = []

    def images(poses: Sequence[Sequence[float]]) -> np.ndarray:
        rendered.extend(pose[0] for pose in poses)
        return np.zeros((len(poses), 6, 8, 3), np.uint8)

    monkeypatch.setattr(filmstrip, "_images", images)
    trace = [[0.01 * k] for k in range(200)]
    figure = filmstrip.strip(trace, 0.7)
    np.testing.assert_allclose(rendered, np.linspace(0.0, 0.7, filmstrip.FRAMES), atol=0.005)
    assert [axes.get_xlabel() for axes in figure.axes] == [f"{t:.2f} s" for t in rendered]
