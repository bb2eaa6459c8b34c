# SPDX-License-Identifier: Apache-2.0
"""Frame and zeros from postures; what cannot be right is named."""

from __future__ import annotations

import numpy as np
import pytest
import true_arm

from wam_power_ros import rotations
from wam_power_ros.commissioning.camera_frame import Pose, calibrate, closed_form

ARM = true_arm.plain()


def postures(count: int = 20, spread: float = 40.0) -> np.ndarray:
    rng = np.random.default_rng(3)
    return true_arm.HOME + np.deg2rad(spread) * rng.uniform(-1.0, 1.0, (count, 7))


def seen(q: np.ndarray, zeros: np.ndarray = true_arm.ZEROS) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) and orientations (N, 3, 3) of the body without noise."""
    poses = [true_arm._seen(ARM, each - zeros) for each in q]
    return np.array([p.position for p in poses]), np.array([p.rotation for p in poses])


def test_without_noise_and_zeros_the_closed_form_is_exact() -> None:
    q = postures()
    base, body = closed_form([Pose(*ARM.tool_pose(each)) for each in q], *seen(q, np.zeros(7)))
    for got, expected in ((base, true_arm.CAMERAS), (body, true_arm.MOUNTED)):
        assert np.allclose(got.position, expected.position, atol=1e-9)
        assert np.allclose(got.rotation, expected.rotation, atol=1e-9)


def test_the_last_zero_is_seen_of_a_body_that_lies_flat() -> None:
    q, zeros = postures(), true_arm.ZEROS + np.deg2rad([0, 0, 0, 0, 0, 0, 2.0])
    flat = Pose(true_arm.MOUNTED.position, rotations.exp(np.array([0.0, 0.0, 0.3])))
    poses = [true_arm._seen(ARM, each - zeros, flat) for each in q]
    seen_at = np.array([p.position for p in poses]), np.array([p.rotation for p in poses])
    assert calibrate(ARM, q, *seen_at).zeros[-1] == 0.0
    found = calibrate(ARM, q, *seen_at, flat=True)
    assert np.allclose(found.zeros, zeros, atol=np.deg2rad(0.05))
    assert 0.0 < found.zeros_sd[-1] < np.deg2rad(1.0)


def test_a_body_that_was_seen_elsewhere_is_rejected_by_number() -> None:
    q = postures()
    position, rotation = seen(q)
    position[[0, 11]] += 0.03
    found = calibrate(ARM, q, position, rotation)
    assert found.rejected == (0, 11)
    assert np.allclose(found.zeros, true_arm.ZEROS, atol=np.deg2rad(0.1))


def mirrored(position: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places in cameras of which one axis is reversed."""
    mirror = np.diag([1.0, -1.0, 1.0])
    return position @ mirror, mirror @ rotation @ mirror


def turned(q: np.ndarray) -> np.ndarray:
    """Postures of which a joint has the other sign."""
    return np.where(np.arange(7) == 3, 2.0 * true_arm.HOME - q, q)


@pytest.mark.parametrize(
    ("q", "places", "why"),
    [
        (postures(9), seen(postures(9)), "9 postures, at least 10 are needed"),
        (postures(spread=3.0), seen(postures(spread=3.0)), "turn the tool by at most"),
        (postures(12), mirrored(*seen(postures(12))), "mirrored"),
        (turned(postures(12)), seen(postures(12)), "order or sign"),
    ],
)
def test_what_tells_nothing_or_cannot_be_is_refused_with_the_cause(
    q: np.ndarray, places: tuple[np.ndarray, np.ndarray], why: str
) -> None:
    with pytest.raises(ValueError, match=why):
        calibrate(ARM, q, *places)
