# SPDX-License-Identifier: Apache-2.0
"""Amplitude, wrist amplitude, catch shift and tempo of a toss."""

import numpy as np
import pytest
from toss_task import demonstrated_policy

from wam_power_ros.learning.parametrization import parametrization_of
from wam_power_ros.learning.policy import Policy, to_json
from wam_power_ros.tasks.flip.parametrization import FlipNoise, flip_parametrization

NOISE = FlipNoise(
    stiffness=0.1,
    attractor=0.01,
    rotation=0.05,
    amplitude=0.04,
    wrist_amplitude=0.03,
    catch_shift=0.02,
)


def moved(group: str, value: float) -> tuple[Policy, Policy]:
    """Demonstrated policy, and the policy with `group` moved by `value` standard deviations."""
    p = flip_parametrization(demonstrated_policy(), "planar", NOISE)
    z = np.zeros(p.size)
    z[p.groups[group]] = value
    return p.policy0, p.policy(z, "a")[0]


@pytest.mark.parametrize(
    ("group", "sds", "name", "axis"),
    [  # each moves by 0.1, outward, aside, or lowers the front of the pan that catches
        ("catch_shift", 5.0, "attractors", 0),
        ("side_shift", 5.0, "attractors", 1),
        ("catch_pitch", 2.0, "rotation_attractors", 1),
    ],
)
def test_what_moves_the_catch_moves_the_last_three_attractors_along_one_axis(
    group: str, sds: float, name: str, axis: int
) -> None:
    before, after = moved(group, sds)
    for other in ("attractors", "rotation_attractors"):
        change = getattr(after, other) - getattr(before, other)
        if other == name:
            ramp = [0, 0, 0, 0, 0, 0.05, 0.1, 0.1]
            np.testing.assert_allclose(change[:, axis], ramp, atol=1e-12)
            change[:, axis] = 0.0
        assert not change.any()


def test_the_flick_enlarges_the_demonstrated_turn() -> None:
    before, after = moved("wrist_amplitude", 5.0)  # 0.15
    old, new = before.rotation_attractors, after.rotation_attractors
    np.testing.assert_allclose(new[:, 1] - new[0, 1], 1.15 * (old[:, 1] - old[0, 1]))
    np.testing.assert_array_equal(new[0], old[0])
    np.testing.assert_array_equal(new[:, [0, 2]], old[:, [0, 2]])
    np.testing.assert_array_equal(after.attractors, before.attractors)


def test_only_the_planar_variant_has_a_tempo_and_parameters_of_its_own() -> None:
    policy = demonstrated_policy()
    for variant in ("full", "attractors"):
        p, plain = (
            make(policy, variant, NOISE) for make in (flip_parametrization, parametrization_of)
        )
        assert p.groups == plain.groups
        same = [q.policy(np.ones(q.size), "a")[0] for q in (p, plain)]
        assert to_json(same[0]) == to_json(same[1])
    p = flip_parametrization(policy, "planar", NOISE)
    own = ["side_shift", "catch_pitch", "amplitude", "wrist_amplitude", "catch_shift", "tempo"]
    assert list(p.groups) == ["stiffness", "attractors", "rotation", *own]
    assert p.size == 6 * policy.basis.count + len(own)
    unchanged = p.policy(np.zeros(p.size), policy.id)[0]
    assert to_json(unchanged) == to_json(policy)
