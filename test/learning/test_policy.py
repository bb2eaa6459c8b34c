# SPDX-License-Identifier: Apache-2.0
"""Invalid policies are refused, and JSON preserves valid ones bit for bit."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toss_task import demonstrated_policy

from wam_power_ros.arm_identity import ArmIdentity
from wam_power_ros.learning.dmp import acceleration, tabulate
from wam_power_ros.learning.policy import (
    SIZE_MAX,
    Basis,
    Policy,
    at_tempo,
    from_json,
    to_json,
    with_id,
)


def make(seed: int = 0, count: int = 8) -> Policy:
    return demonstrated_policy("trial-0007", count, seed)


@settings(max_examples=20)
@given(st.integers(0, 2**32), st.integers(1, 20))
def test_text_and_back_is_the_same_to_the_last_bit(seed: int, count: int) -> None:
    policy = make(seed, count)
    again = from_json(to_json(policy))
    assert to_json(again) == to_json(policy)
    assert again.basis == policy.basis
    for name in ("stiffness", "attractors", "rotation_attractors", "q_start"):
        assert np.array_equal(getattr(again, name), getattr(policy, name))


def followed(policy: Policy, dt: float) -> np.ndarray:
    """Position and rotation vector at every tick of an integration from rest. Shape (T, 6)."""
    tables = tabulate(policy, dt)
    path, twist = np.full((len(tables.b), 6), 0.1), np.zeros(6)
    for k in range(len(tables.b) - 1):
        twist = twist + dt * acceleration(tables, k, path[k, :3], path[k, 3:], twist)
        path[k + 1] = path[k] + dt * twist
    return path


@settings(max_examples=5)
@given(st.floats(0.5, 2.0), st.integers(0, 2**32))
def test_a_faster_policy_moves_and_turns_along_the_same_path_in_the_new_time(
    tempo: float, seed: int
) -> None:
    policy = make(seed)
    quick = at_tempo(policy, tempo)
    assert quick.basis.duration == pytest.approx(policy.basis.duration / tempo)
    path = followed(policy, 0.005)
    np.testing.assert_allclose(followed(quick, 0.005 / tempo), path, atol=1e-9)
    assert np.ptp(path, axis=0).min() > 0.01


def spoilt(name: str, index: tuple[int, ...], value: float) -> dict[str, np.ndarray]:
    array = np.array(getattr(make(), name))
    array[index] = value
    return {name: array}


COUPLED = np.tile([[100.0, 300.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 100.0]], (8, 1, 1))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"id": "a/b"}, "id 'a/b'"),
        ({"id": "a\n"}, "id"),
        ({"id": "x" * 65}, "id"),
        (spoilt("stiffness", (3, 1, 2), math.nan), r"stiffness\[3, 1, 2\] = nan"),
        (spoilt("stiffness", (1, 0, 0), -500.0), r"stiffness\[1\] has eigenvalue"),
        ({"stiffness": COUPLED}, r"stiffness\[0\] has eigenvalue"),  # of the symmetric part
        ({"stiffness": 300.0 * np.eye(3)}, r"stiffness has shape \(3, 3\)"),
        ({"attractors": [["a"] * 3] * 8}, "attractors is not an array of numbers"),
        ({"rotation_attractors": np.zeros((7, 3))}, "rotation_attractors has shape"),
        ({"orientation_reference": [0.0, 0.0, 0.0, 1.0 - 2e-6]}, "orientation_reference has leng"),
        ({"damping": 0.0}, "damping = 0.0"),
        ({"rotation_stiffness": -1.0}, "rotation_stiffness = -1.0"),
        ({"q_start": np.zeros(0)}, "q_start has 0 joints"),
        ({"q_start": np.zeros(17)}, "17 joints"),
        ({"q_start": np.zeros((7, 1))}, "q_start has shape"),
    ],
)
def test_a_wrong_policy_cannot_exist(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(make(), **change)


@pytest.mark.parametrize(
    ("name", "limit", "shape"),
    [
        ("stiffness", 1e5, (8, 3, 3)),  # [1/s^2]
        ("attractors", 10.0, (8, 3)),  # [m]
        ("rotation_attractors", 30.0, (8, 3)),  # [rad]
        ("q_start", 30.0, (7,)),  # [rad]
        ("damping", 1e3, ()),  # [1/s]
        ("rotation_stiffness", 1e5, ()),  # [1/s^2]
        ("rotation_damping", 1e3, ()),  # [1/s]
    ],
)
def test_a_value_at_its_limit_is_allowed_and_the_next_beyond_is_not(
    name: str, limit: float, shape: tuple[int, ...]
) -> None:
    at = np.full(shape, limit) * (np.eye(3) if name == "stiffness" else 1.0)
    signs = (1.0,) if name == "stiffness" or not shape else (1.0, -1.0)
    for sign in signs:
        assert np.array_equal(getattr(replace(make(), **{name: sign * at}), name), sign * at)
        with pytest.raises(ValueError, match=rf"{name}.* = .*{limit}"):
            replace(make(), **{name: sign * at * (1.0 + 1e-15)})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0, 1.0, 0.1), "count = 0"),
        ((True, 1.0, 0.1), "count = True"),
        ((8, 0.0, 0.1), "duration = 0.0"),
        ((8, 60.0 + 1e-9, 0.1), "duration"),
        ((8, math.nan, 0.1), "duration"),
        ((8, 1.0, 0.999e-8), "variance"),
        ((8, 1.0, 3600.0 + 1e-6), "variance"),
    ],
)
def test_a_wrong_basis_cannot_exist(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Basis(*arguments)


def changed(**keys: object) -> str:
    data = json.loads(to_json(make()))
    data.update(keys)
    return json.dumps({key: value for key, value in data.items() if value is not ...})


@pytest.mark.requirement("S-15")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", "policy text"),
        (to_json(make()).replace("32.0", "NaN"), "NaN is not a finite number"),
        (changed(schema="wam_power_ros/policy/3"), "schema"),
        (changed(damping=...), "damping"),
        (changed(damping="32"), "damping"),
        (changed(count=3), "shape"),
        (changed(extra=1), "extra"),
        (changed(attractors=[[1.0, 2.0]] * 8), "attractors.0"),
        (changed(q_start=[0.0] * 17), "q_start"),
        (changed(id="../x"), "id"),
        (" " * SIZE_MAX + to_json(make()), "bytes"),
        (to_json(make()).encode(), "bytes"),
    ],
)
def test_a_wrong_text_is_refused_and_the_fault_named(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        from_json(text)


ARM = ArmIdentity("wam7", tuple(f"wam_j{i}" for i in range(1, 8)), "1" * 64, "2" * 64)


@pytest.mark.requirement("S-59")
def test_a_policy_keeps_the_arm_it_is_of_and_an_old_text_has_none() -> None:
    policy = replace(make(), arm=ARM)
    assert from_json(to_json(policy)).arm == ARM
    assert with_id(policy, "again").arm == ARM
    old = json.loads(to_json(make())) | {"schema": "wam_power_ros/policy/1"}
    del old["arm"]
    assert from_json(json.dumps(old)).arm is None
    assert to_json(from_json(json.dumps(old))) == to_json(make())


def test_an_arm_that_does_not_fit_the_policy_or_is_no_identity_is_refused() -> None:
    with pytest.raises(ValueError, match="q_start has 7 joints, the arm is wam7"):
        replace(make(), arm=ARM._replace(joint_names=("wam_j1",)))
    text = json.loads(to_json(replace(make(), arm=ARM)))
    text["arm"]["kinematics"] = "x"
    with pytest.raises(ValueError, match="'x' of an arm's identity"):
        from_json(json.dumps(text))
