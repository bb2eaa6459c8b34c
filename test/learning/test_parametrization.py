# SPDX-License-Identifier: Apache-2.0
"""Parametrization: policies and their learnt coordinates."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toss_task import demonstrated_policy

from wam_power_ros.learning.parametrization import (
    Attractors,
    Direction,
    Group,
    NoiseScales,
    Parametrization,
    Rotation,
    Stiffness,
    parametrization_of,
)
from wam_power_ros.learning.policy import symmetric_part, to_json

NOISE = NoiseScales(stiffness=0.1, attractor=0.01, rotation=0.05)
PATTERN = 0.05 * np.arange(24.0).reshape(8, 3) * [1.0, 0.0, 1.0]
LIFT = Direction(0.03, "lift", attractors=PATTERN, rotation=np.zeros((8, 3)))
TWIST = Direction(0.02, "twist", attractors=np.zeros((8, 3)), rotation=PATTERN[::-1])
GROUPS = {
    "full": (Stiffness(0.1), Attractors(0.01)),
    "diagonal": (Stiffness(0.1, "diagonal"), Attractors(0.01)),
    "symmetric": (Stiffness(0.1, "symmetric"), Attractors(0.01)),
    "attractors": (Attractors(0.01),),
    "planar": (Stiffness(0.1, "symmetric", (0, 2)), Attractors(0.01, (0, 2)), Rotation(0.05, (1,))),
}
variants = pytest.mark.parametrize("variant", GROUPS)


def of(variant: str, *others: Group, seed: int = 0) -> Parametrization:
    policy = demonstrated_policy(seed=seed)
    if variant == "diagonal":
        policy = replace(policy, stiffness=policy.stiffness * np.eye(3))
    return Parametrization(policy, (*GROUPS[variant], *others))


def parametrization(variant: str, seed: int = 0) -> Parametrization:
    return of(variant, LIFT, TWIST, seed=seed)


@variants
def test_zero_is_the_demonstrated_policy_bit_for_bit(variant: str) -> None:
    p = parametrization(variant)
    policy, z = p.policy(np.zeros(p.size), "trial-0001")
    assert not z.any()
    expected = to_json(p.policy0).replace("flick-1", "trial-0001")
    assert to_json(policy) == expected
    if variant != "diagonal":
        assert to_json(p.policy0) == to_json(demonstrated_policy())


@variants
def test_a_sampled_stiffness_is_positive_definite_and_stored_as_executed(variant: str) -> None:
    p = parametrization(variant)
    rng = np.random.default_rng(1)
    clipped = 0
    for _ in range(20):
        wanted = 6.0 * rng.standard_normal(p.size)
        policy, z = p.policy(wanted, "a")
        clipped += not np.array_equal(wanted, z)
        low = np.linalg.eigvalsh(symmetric_part(policy.stiffness)).min()
        assert low >= p.stiffness_min * (1.0 - 1e-9)
        again, same = p.policy(z, "a")
        np.testing.assert_array_equal(same, z)
        assert to_json(again) == to_json(policy)
    assert clipped == 0 if variant == "attractors" else clipped > 10


@given(seed=st.integers(0, 1000), split=st.floats(0.0, 1.0))
@settings(max_examples=20)
def test_a_mean_of_clipped_samples_needs_no_clipping(seed: int, split: float) -> None:
    for variant in ("full", "planar"):
        p = parametrization(variant)
        a, b = (p.clip(8.0 * z) for z in np.random.default_rng(seed).standard_normal((2, p.size)))
        mean = split * a + (1.0 - split) * b
        np.testing.assert_array_equal(p.clip(mean), mean)


@variants
def test_unit_noise_has_the_scale_of_each_group(variant: str) -> None:
    p = parametrization(variant)
    moved = p.theta(np.ones(p.size)) - p.theta0
    mean = np.trace(p.policy0.stiffness, axis1=1, axis2=2).mean() / 3.0
    expected = {"attractors": 0.01, "rotation": 0.05, "lift": 0.03, "twist": 0.02}
    expected["stiffness"] = 0.1 * mean
    for name, group in p.groups.items():
        np.testing.assert_allclose(moved[group], expected[name])


ENTRIES = {  # learnt entries of K_i, mu_i and r_i, in the order of the parameters
    "full": ([(i, j) for i in range(3) for j in range(3)], [0, 1, 2], []),
    "diagonal": ([(0, 0), (1, 1), (2, 2)], [0, 1, 2], []),
    "symmetric": ([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)], [0, 1, 2], []),
    "attractors": ([], [0, 1, 2], []),
    "planar": ([(0, 0), (2, 2), (0, 2)], [0, 2], [1]),
}


@variants
def test_each_parameter_moves_its_own_entry_to_its_value_and_no_other(variant: str) -> None:
    p = of(variant)
    matrices, axes, turned = ENTRIES[variant]
    places = [("stiffness", (i, *entry)) for i in range(8) for entry in matrices]
    places += [("attractors", (i, axis)) for i in range(8) for axis in axes]
    places += [("rotation_attractors", (i, axis)) for i in range(8) for axis in turned]
    assert p.size == len(places)
    for k, (name, place) in enumerate(places):
        z = np.zeros(p.size)
        z[k] = 0.5
        policy, _ = p.policy(z, "a")
        moved = np.array(getattr(p.policy0, name))
        moved[place] += 0.5 * p.scale[k]
        if variant in ("symmetric", "planar") and name == "stiffness" and place[1] != place[2]:
            moved[place[0], place[2], place[1]] += 0.5 * p.scale[k]
        np.testing.assert_allclose(getattr(policy, name), moved, rtol=0.0, atol=1e-12)
        for other in {"stiffness", "attractors", "rotation_attractors"} - {name}:
            np.testing.assert_array_equal(getattr(policy, other), getattr(p.policy0, other))


@variants
def test_a_mode_moves_one_axis_smoothly_by_a_standard_deviation(variant: str) -> None:
    p = parametrization(variant)
    _, axes, turned = ENTRIES[variant]
    modes = p.modes()
    assert len(modes) == 4 * (len(axes) + len(turned))
    np.testing.assert_allclose(modes @ modes.T, 8.0 * np.eye(len(modes)), atol=1e-9)
    for z in modes:
        policy, _ = p.policy(z, "a")
        np.testing.assert_array_equal(policy.stiffness, p.policy0.stiffness)
        moved = np.hstack(
            [
                (policy.attractors - p.policy0.attractors) / 0.01,
                (policy.rotation_attractors - p.policy0.rotation_attractors) / 0.05,
            ]
        )
        rms = np.sqrt((moved**2).mean(axis=0))
        np.testing.assert_allclose(np.sort(rms), [0.0] * 5 + [1.0], atol=1e-9)
        signs = np.sign(moved[:, rms.argmax()])
        assert np.count_nonzero(np.diff(signs)) <= 3


def test_what_cannot_be_is_refused_with_its_reason() -> None:
    p = parametrization("full")
    for call, why in (
        (lambda: parametrization_of(demonstrated_policy(), "cubic", NOISE), "'cubic' is not one"),
        (lambda: Stiffness(0.1, axes=(2,)), "must be two or three"),
        (lambda: p.policy(np.zeros(3), "a"), r"shape \(3,\), the parameters have \(98,\)"),
        (lambda: p.clip(np.full(98, np.nan)), "not finite"),
        (lambda: Parametrization(demonstrated_policy(count=4), (LIFT,)), "'lift' has 8 attractors"),
        (lambda: of("full", replace(LIFT, name="attractors")), "is used by two groups"),
        (lambda: Direction(0.0, "lift", PATTERN, PATTERN), r"noise = 0\.0"),
        (lambda: Direction(1.0, "lift", PATTERN, PATTERN[1:]), r"rotation has shape \(7, 3\)"),
    ):
        with pytest.raises(ValueError, match=why):
            call()


@pytest.mark.parametrize("variant", ["full", "diagonal", "symmetric", "attractors"])
def test_a_variant_by_name_is_that_of_its_groups(variant: str) -> None:
    named, p = parametrization_of(demonstrated_policy(), variant, NOISE), of(variant)
    assert named.groups == p.groups
    np.testing.assert_array_equal(named.theta(np.ones(p.size)), p.theta(np.ones(p.size)))


@variants
def test_many_at_once_are_the_policies_one_by_one(variant: str) -> None:
    p = parametrization(variant)
    z = 6.0 * np.random.default_rng(2).standard_normal((5, p.size))
    many = p.arrays(z)
    for k in range(len(z)):
        policy, _ = p.policy(z[k], "a")
        np.testing.assert_allclose(many[0][k], policy.stiffness, rtol=1e-9)
        np.testing.assert_allclose(many[1][k], policy.attractors, rtol=1e-12)
        np.testing.assert_allclose(many[2][k], policy.rotation_attractors, rtol=1e-12)
