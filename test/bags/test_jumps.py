# SPDX-License-Identifier: Apache-2.0
"""Jumps of recorded angles never become a movement: unwrapped, left out, or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_samples import NAMES, QOS, START, joint_state
from hypothesis import given
from hypothesis import strategies as st

from wam_power_ros.bags import importing, layout, reader, takes
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.jumps import checked
from wam_power_ros.bags.quality import Grade
from wam_power_ros.bags.writer import BagWriter
from wam_power_ros.control.replay_trajectory import movement

STEP = 4_000_000  # [ns] between states
STAMPS = START + STEP * np.arange(300, dtype=np.int64)


def smooth(offset: float = 0.0) -> np.ndarray:
    """Joints that move by 0.4, 0.1 and 0 rad within 1.2 s. Shape (300, 3)."""
    t = (STAMPS - STAMPS[0]) * 1e-9
    share = 0.5 - 0.5 * np.cos(np.pi * t / t[-1])
    return np.stack([offset + 0.4 * share, 0.5 - 0.1 * share, np.full(300, 1.0)], axis=1)


def wrapped(q: np.ndarray) -> np.ndarray:
    """As a driver reports them that knows angles within [-pi, pi) only."""
    return (q + np.pi) % (2.0 * np.pi) - np.pi


def bag(path: Path, q: np.ndarray, stamps: np.ndarray = STAMPS) -> Path:
    writer = BagWriter(path)
    writer.add("/joint_states", layout.JOINT_STATE, QOS)
    for stamp_ns, row in zip(stamps.tolist(), q, strict=True):
        writer.write("/joint_states", stamp_ns, joint_state(stamp_ns, NAMES, row))
    return writer.close({})


def with_bad(*places: int, value: float = 0.0) -> np.ndarray:
    q = smooth()
    q[list(places)] = value
    return q


@pytest.mark.requirement("S-32")
@given(offset=st.floats(-20.0, 20.0), jitter=st.integers(0, 2**32))
def test_a_wrapped_joint_is_continuous_wherever_and_however_often_it_wraps(
    offset: float, jitter: int
) -> None:
    rng = np.random.default_rng(jitter)
    stamps = STAMPS + rng.integers(-STEP // 3, STEP // 3, len(STAMPS))
    q = smooth(offset) + rng.normal(scale=1e-3, size=(300, 3))
    found = checked(stamps, wrapped(q), NAMES)
    np.testing.assert_array_equal(found.kept, np.arange(300))
    np.testing.assert_allclose(found.q - found.q[0], q - q[0], atol=1e-12)
    turned = np.abs(np.diff(wrapped(q), axis=0)).max() > 3.0
    assert [remark.text.split()[0] for remark in found.remarks] == ["wam_j1"] * int(turned)


@pytest.mark.requirement("S-32")
@pytest.mark.parametrize("value", [0.0, np.nan, 9.0])
@pytest.mark.parametrize("places", [[0], [150], [299], [40, 150, 299]])
def test_single_bad_states_are_left_out_and_counted(places: list[int], value: float) -> None:
    found = checked(STAMPS, with_bad(*places, value=value), NAMES)
    np.testing.assert_array_equal(found.kept, np.delete(np.arange(300), places))
    np.testing.assert_array_equal(found.q, np.delete(smooth(), places, axis=0))
    ((grade, text),) = found.remarks
    assert grade is Grade.FAIR and text.startswith(f"{len(places)} state")
    assert f"{0.004 * places[0]:.3f}" in text


def test_states_of_a_driver_that_is_not_active_yet_are_left_out() -> None:
    found = checked(STAMPS, with_bad(0, 1, 2, 298, 299, value=np.nan), NAMES)
    np.testing.assert_array_equal(found.kept, np.arange(3, 298))


@pytest.mark.parametrize("other", [0.25, 3.0])
@pytest.mark.requirement("S-32")
@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda q, away: q[150:].__iadd__(away), "wam_j1 jumps from 0.199 .* 0.600 s after"),
        (lambda q, away: q[150:152].__iadd__(away), "wam_j1 jumps .* 4.0 ms, 0.600 s after"),
        (lambda q, away: q[::2].__iadd__(away), "wam_j1 jumps"),  # two drivers in turn
        (lambda q, away: q[::3].__iadd__(away), "100 of 300 states|wam_j1 jumps"),
        (lambda q, away: q[10:300:20].__iadd__(away), "15 of 300 states .* at most 1%"),
        (lambda q, away: q[150:152].__imul__(np.nan), "nan.* not finite, 0.600 s after.* are 1"),
        (lambda q, away: q.__imul__(np.nan), "all 300 positions are not finite"),
    ],
)
def test_other_jumps_are_refused_with_joint_and_time(
    change: Callable[[np.ndarray, float], object], why: str, other: float
) -> None:
    q = smooth()
    change(q, other)
    with pytest.raises(ValueError, match=why):
        checked(STAMPS, q, NAMES)


@given(
    period_ms=st.sampled_from([1, 2, 4, 10, 30]),
    speed=st.floats(0.1, 15.0),
    seed=st.integers(0, 2**32),
)
def test_a_movement_without_a_jump_is_returned_bit_for_bit(
    period_ms: int, speed: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    stamps = START + period_ms * 1_000_000 * np.arange(200, dtype=np.int64)
    q = np.cumsum(rng.uniform(-1.0, 1.0, (200, 3)) * speed * period_ms * 1e-3, axis=0)
    found = checked(stamps, q, NAMES)
    assert found.q.tobytes() == q.tobytes() and not found.remarks


@pytest.mark.requirement("S-32")
@pytest.mark.parametrize("speed", [0.01, 1.0])
def test_no_replay_goes_along_a_jump_at_any_speed(tmp_path: Path, speed: float) -> None:
    limit = 1.2 * 0.4  # [rad] of joint 1, whose movement is 0.4 rad
    for name, q in (("wrapped", wrapped(smooth(3.0))), ("zeros", with_bad(150))):
        stamps, angles = reader.read_demonstration(bag(tmp_path / name, q), NAMES)
        _, played = movement(stamps, angles, speed)
        assert np.abs(np.diff(played[:, 0])).sum() < limit
    path = bag(tmp_path / "jump", smooth() + (STAMPS > STAMPS[150])[:, None] * [[0.0, 0.5, 0.0]])
    with pytest.raises(ValueError, match="wam_j2 jumps"):
        reader.read_demonstration(path, NAMES)


def test_what_was_unwrapped_or_left_out_is_a_remark_on_the_take_and_on_its_import(
    tmp_path: Path,
) -> None:
    q = wrapped(smooth(3.0))
    q[20] = 0.0
    path = bag(tmp_path / "theirs", q)
    texts = [remark.text for remark in takes.read(Bag(path), NAMES).states.remarks]
    assert len(texts) == 2 and texts[0].startswith("1 state left out")
    assert texts[1].startswith("wam_j1 was unwrapped")
    made, remarks = importing.import_bag(Bag(path), tmp_path / "ours", NAMES)
    assert [remark.text for remark in remarks] == texts
    again = takes.read(Bag(made), NAMES).states
    assert again.remarks == ()
    np.testing.assert_allclose(again.q, np.delete(smooth(3.0), 20, axis=0), atol=1e-12)
    for text in texts:
        assert text.partition(":")[0] in Bag(made).notes["imported"]
