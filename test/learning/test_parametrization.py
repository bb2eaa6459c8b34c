# SPDX-License-Identifier: Apache-2.0
"""Policies and the coordinates they are learnt in."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toss_task import demonstrated_policy

from wam_power_ros.learning.parametrization import FLOOR, VARIANTS, NoiseScales, Parameters
from wam_power_ros.learning.policy import to_json

NOISE = NoiseScales(stiffness=0.1, attractor=0.01, rotation=0.05, flick=0.03, catch_shift=0.02)
variants = pytest.mark.parametrize("variant", VARIANTS)


def parameters(variant: str, seed: int = 0) -> Parameters:
    return Parameters(demonstrated_policy(seed=seed), variant, NOISE)


def symmetric(matrices: np.ndarray) -> np.ndarray:
    return 0.5 * (matrices + np.swapaxes(matrices, 1, 2))


@pytest.mark.parametrize(
    ("variant", "size"),
    [("full", 96), ("diagonal", 48), ("symmetric", 72), ("attractors", 24), ("planar", 50)],
)
def test_each_variant_has_the_parameters_it_says(variant: str, size: int) -> None:
    p = parameters(variant)
    assert p.size == size == len(p.names) == len(set(p.names)) == len(p.scale)
    covered = np.concatenate([np.arange(size)[group] for group in p.groups.values()])
    np.testing.assert_array_equal(np.sort(covered), np.arange(size))


@variants
def test_zero_is_the_demonstrated_policy_bit_for_bit(variant: str) -> None:
    p = parameters(variant)
    policy, z = p.policy(np.zeros(p.size), "trial-0001")
    assert not z.any()
    expected = to_json(p.policy0).replace("flick-1", "trial-0001")
    assert to_json(policy) == expected
    if variant != "diagonal":
        assert to_json(p.policy0) == to_json(demonstrated_policy())


@variants
def test_a_sampled_stiffness_is_positive_definite_and_stored_as_executed(variant: str) -> None:
    p = parameters(variant)
    rng = np.random.default_rng(1)
    clipped = 0
    for _ in range(50):
        wanted = 6.0 * rng.standard_normal(p.size)
        policy, z = p.policy(wanted, "a")
        clipped += not np.array_equal(wanted, z)
        low = np.linalg.eigvalsh(symmetric(policy.stiffness)).min()
        assert low >= p.stiffness_min * (1.0 - 1e-9)
        again, same = p.policy(z, "a")
        np.testing.assert_array_equal(same, z)
        assert to_json(again) == to_json(policy)
    assert clipped == 0 if variant == "attractors" else clipped > 30


@variants
def test_clipping_touches_only_what_is_learnt_and_what_is_too_soft(variant: str) -> None:
    p = parameters(variant)
    wanted = 4.0 * np.random.default_rng(2).standard_normal(p.size)
    policy, z = p.policy(wanted, "a")
    for name, group in p.groups.items():
        if name != "stiffness":
            np.testing.assert_array_equal(z[group], wanted[group])
    if variant in ("symmetric", "planar"):
        kept = p.policy0.stiffness - symmetric(p.policy0.stiffness)
        np.testing.assert_allclose(policy.stiffness - symmetric(policy.stiffness), kept, atol=1e-10)
    if variant == "planar":
        np.testing.assert_array_equal(policy.stiffness[:, 1], p.policy0.stiffness[:, 1])
        np.testing.assert_array_equal(policy.stiffness[:, :, 1], p.policy0.stiffness[:, :, 1])
        np.testing.assert_array_equal(policy.attractors[:, 1], p.policy0.attractors[:, 1])
    if variant == "diagonal":
        assert not (policy.stiffness * (1.0 - np.eye(3))).any()
    small = 0.05 * wanted  # nothing of this is near the floor
    np.testing.assert_array_equal(p.clip(small), small)


@given(seed=st.integers(0, 1000), split=st.floats(0.0, 1.0))
@settings(max_examples=30, deadline=None)
def test_a_mean_of_clipped_samples_needs_no_clipping(seed: int, split: float) -> None:
    for variant in ("full", "planar"):
        p = parameters(variant)
        a, b = (p.clip(8.0 * z) for z in np.random.default_rng(seed).standard_normal((2, p.size)))
        mean = split * a + (1.0 - split) * b
        np.testing.assert_array_equal(p.clip(mean), mean)


@variants
def test_coordinates_are_the_inverse_of_policy(variant: str) -> None:
    p = parameters(variant)
    wanted = np.random.default_rng(3).standard_normal(p.size)
    for group in {"flick", "catch_shift"} & p.groups.keys():
        wanted[p.groups[group]] = 0.0
    policy, z = p.policy(wanted, "a")
    np.testing.assert_allclose(p.coordinates(policy), z, atol=1e-9)


@variants
def test_unit_noise_has_the_scale_of_each_group(variant: str) -> None:
    p = parameters(variant)
    moved = p.theta(np.ones(p.size)) - p.theta0
    mean = np.trace(p.policy0.stiffness, axis1=1, axis2=2).mean() / 3.0
    expected = {
        "stiffness": 0.1 * mean, "attractors": 0.01, "rotation": 0.05, "flick": 0.03,
        "catch_shift": 0.02,
    }  # fmt: skip
    for name, group in p.groups.items():
        np.testing.assert_allclose(moved[group], expected[name])


def test_the_catch_shift_moves_the_last_three_attractors_outward() -> None:
    p = parameters("planar")
    z = np.zeros(p.size)
    z[p.groups["catch_shift"]] = 5.0  # 0.1 m
    policy, _ = p.policy(z, "a")
    moved = policy.attractors - p.policy0.attractors
    np.testing.assert_allclose(moved[:, 0], [0, 0, 0, 0, 0, 0.05, 0.1, 0.1], atol=1e-12)
    assert not moved[:, 1:].any()


def test_the_flick_enlarges_what_was_demonstrated_of_the_turn() -> None:
    p = parameters("planar")
    z = np.zeros(p.size)
    z[p.groups["flick"]] = 5.0  # 0.15
    policy, _ = p.policy(z, "a")
    before, after = p.policy0.rotation_attractors, policy.rotation_attractors
    np.testing.assert_allclose(after[:, 1] - after[0, 1], 1.15 * (before[:, 1] - before[0, 1]))
    np.testing.assert_array_equal(after[0], before[0])
    np.testing.assert_array_equal(after[:, [0, 2]], before[:, [0, 2]])
    np.testing.assert_array_equal(policy.attractors, p.policy0.attractors)


def test_names_say_which_entry_moves() -> None:
    p = parameters("planar")
    z = np.zeros(p.size)
    z[p.names.index("K3_xz")] = 1.0
    z[p.names.index("r8_y")] = 1.0
    policy, _ = p.policy(z, "a")
    moved = np.argwhere(policy.stiffness != p.policy0.stiffness).tolist()
    assert moved == [[2, 0, 2], [2, 2, 0]]
    assert np.argwhere(policy.rotation_attractors != p.policy0.rotation_attractors).tolist() == [
        [7, 1]
    ]


def test_what_cannot_be_is_refused_with_its_reason() -> None:
    p = parameters("full")
    with pytest.raises(ValueError, match="'cubic' is not one of full, diagonal"):
        Parameters(demonstrated_policy(), "cubic", NOISE)
    with pytest.raises(ValueError, match=r"shape \(3,\), variant 'full' has \(96,\)"):
        p.policy(np.zeros(3), "a")
    with pytest.raises(ValueError, match="not finite"):
        p.clip(np.full(96, np.nan))
    with pytest.raises(ValueError, match="shifts the last 3 primitives"):
        Parameters(demonstrated_policy(count=2), "planar", NOISE)
    with pytest.raises(ValueError, match="has 4 primitives, expected 8"):
        p.coordinates(demonstrated_policy(count=4))


def test_the_floor_is_below_every_demonstrated_stiffness() -> None:
    for seed in range(20):
        p = parameters("full", seed)
        low = np.linalg.eigvalsh(symmetric(p.policy0.stiffness)).min()
        assert p.stiffness_min == pytest.approx(FLOOR * low) and 0.0 < p.stiffness_min < low


@variants
def test_many_at_once_are_the_policies_one_by_one(variant: str) -> None:
    p = parameters(variant)
    z = 6.0 * np.random.default_rng(2).standard_normal((20, p.size))
    many = p.arrays(z)
    for k in range(len(z)):
        policy, _ = p.policy(z[k], "a")
        np.testing.assert_allclose(many[0][k], policy.stiffness, rtol=1e-9)
        np.testing.assert_allclose(many[1][k], policy.attractors, rtol=1e-12)
        np.testing.assert_allclose(many[2][k], policy.rotation_attractors, rtol=1e-12)
