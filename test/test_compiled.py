# SPDX-License-Identifier: Apache-2.0
"""The compiled loops and the Python code beside them give the same torques, faults and states."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import rigid_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from wam_power_ros import compiled, rotations
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.plausibility import (
    STANDSTILL_STATES,
    Bound,
    Interval,
    TorqueCheck,
    VelocityCheck,
)
from wam_power_ros.control.safety import LimitSprings, limit_torque, limits_of, motion_fault
from wam_power_ros.control.state_checks import JointState

ROOT = Path(__file__).resolve().parents[1]
needs_kernel = pytest.mark.skipif(compiled.kernel is None, reason="no C compiler has built it")
ARM, OTHER = rigid_arm.MODEL, Arm(rigid_arm.URDF, rigid_arm.NAMES)
LIMITS = limits_of(ARM)
seeds = st.integers(0, 2**32 - 1)


class Without:
    """Context in which the Python code answers."""

    def __enter__(self) -> None:
        self._kernel, compiled.kernel = compiled.kernel, None

    def __exit__(self, *_: object) -> None:
        compiled.kernel = self._kernel


@needs_kernel
def test_a_controller_without_the_kernel_sends_the_same_torques() -> None:
    def torques() -> np.ndarray:
        controller, plant, _ = rigid_arm.executing(0.4, friction=1.0, delay=2, sensing=True)
        sent = rigid_arm.run(controller, plant, 0.3)
        controller.fault(rigid_arm.A_TEST)
        sent += rigid_arm.run(controller, plant, 0.5)
        controller.reset()
        controller.set_gravity_compensation(True)
        return np.array([*sent, *rigid_arm.run(controller, plant, 0.1)])

    with Without():
        expected = torques()
    assert np.abs(torques() - expected).max() < 1e-9  # a reaction carries what the residual says


def _pairs(seed: int) -> Iterator[tuple[JointState, JointState, list[int]]]:
    """States of a random motion, each after the one before, and for how many a position stands.

    Some repeat, lag, stand still, jitter or contradict themselves.
    """
    random = np.random.default_rng(seed)
    q, qd, stamp_ns = random.uniform(-1.0, 1.0, 7), random.normal(0.0, 1.0, 7), 10**9
    noise = random.choice([0.0, 1e-6, 1e-4, 1e-3, 1e-2])
    scale = random.choice([1.0, 1.0, 0.0, -1.0, 1.5])
    moving = random.random(7) >= random.choice([0.0, 0.3])
    states = []
    for _ in range(40):
        qd = qd + random.normal(0.0, 0.05, 7)
        q = q + 0.002 * qd * (random.random(7) > 0.1) * moving
        stamp_ns += 2_000_000 + int(random.normal(0.0, 1e5))
        reported = q + random.normal(0.0, noise, 7) if noise else q
        states.append(JointState(stamp_ns, reported, scale * qd, 0.002, 0.002))
    counts = [0] * 7
    for last, state in itertools.pairwise(states):
        rows = zip(counts, last.positions, state.positions, strict=True)
        counts = [n + 1 if before == now else 0 for n, before, now in rows]
        yield last, state, counts


@needs_kernel
@settings(max_examples=20)
@given(seeds)
def test_the_check_of_velocities_keeps_the_same_numbers_and_finds_the_same_faults(
    seed: int,
) -> None:
    checks = VelocityCheck(7), VelocityCheck(7)
    for last, state, counts in _pairs(seed):
        dt = (state.stamp_ns - last.stamp_ns) * 1e-9
        interval = Interval(0.002, min(dt, 0.002), max(dt, 0.002))
        found = checks[0].fault(last, state, counts, interval)
        with Without():
            assert checks[1].fault(last, state, counts, interval) == found
        assert vars(checks[0]) == vars(checks[1])


@needs_kernel
@settings(max_examples=20)
@given(seeds)
def test_the_check_of_torques_finds_the_same_faults_and_nearly_the_same_residual(seed: int) -> None:
    random = np.random.default_rng(seed)
    checks = TorqueCheck(ARM), TorqueCheck(OTHER)
    bound = Bound(
        random.uniform(0.5, 40.0, 7), random.uniform(0.5, 5.0, 7), random.choice([0, 0.3])
    )
    for last, state, counts in _pairs(seed):
        tau = ARM.gravity(state.q) + random.normal(0.0, 5.0, 7)
        found = checks[0].fault(last, state, counts, tau, bound, 0.002)
        with Without():
            other = checks[1].fault(last, state, counts, tau, bound, 0.002)
        assert found == other
        assert np.allclose(checks[0].residual, checks[1].residual, rtol=1e-12, atol=1e-11)
        assert checks[0]._in_row == checks[1]._in_row


@needs_kernel
@pytest.mark.parametrize("count", [STANDSTILL_STATES - 1, STANDSTILL_STATES])
def test_the_bound_of_a_standing_joint_holds_from_the_same_state_on(count: int) -> None:
    checks = TorqueCheck(ARM), TorqueCheck(OTHER)
    bound = Bound(np.full(7, 1e3), np.full(7, 0.1))
    states = [JointState(k * 2_000_000, np.ones(7), np.zeros(7), 0.002, 0.002) for k in range(2)]
    tau = ARM.gravity(np.ones(7)) + 50.0
    for _ in range(20):
        found = checks[0].fault(*states, [count] * 7, tau, bound, 0.002)
        with Without():
            assert checks[1].fault(*states, [count] * 7, tau, bound, 0.002) == found
    assert (found is not None) == (count >= STANDSTILL_STATES)


@needs_kernel
@settings(max_examples=50)
@given(seeds)
def test_limits_motions_and_rotations_are_the_same_bit_for_bit(seed: int) -> None:
    random = np.random.default_rng(seed)
    q, qd = random.uniform(LIMITS.q_min - 0.2, LIMITS.q_max + 0.2), random.normal(0.0, 1.5, 7)
    tau, sent = random.normal(0.0, 20.0, (2, 7))
    sent, dt = np.clip(sent, -LIMITS.torque, LIMITS.torque), random.choice([0.0, 0.002, 0.05])
    axis = random.normal(size=3)
    turn = random.choice([0.0, 1e-9, 1e-3, 1.0, np.pi - 1e-9, np.pi])
    matrix = rotations.exp(turn * axis / np.linalg.norm(axis))

    def answers(arm: Arm) -> list[object]:
        motion = arm.motion(q, qd)
        springs = LimitSprings(LIMITS).torque(q, 0.002)
        return [
            limit_torque(tau, sent, dt, LIMITS).tobytes(),
            None if springs is None else springs.tobytes(),
            motion_fault(q.tolist(), qd.tolist(), motion, arm.guarded, LIMITS, 4.0, True),
            *(motion.guarded_positions, motion.guarded_speeds, arm.speeds(q, qd)),
            *(rotations.log_of_one(matrix), rotations.log_of_one(matrix.T)),
        ]

    with Without():
        expected = answers(OTHER)
    assert answers(ARM) == expected


def test_an_arm_of_more_joints_than_the_kernel_has_room_for_is_refused() -> None:
    with pytest.raises(ValueError, match="66 joints are too many, at most 64"):
        Arm(_chain(66), [f"j{k}" for k in range(66)], "link66", guarded=())
    assert Arm(_chain(64), [f"j{k}" for k in range(64)], "link64", guarded=()).n == 64


def _chain(n: int) -> str:
    """URDF of a chain of n joints."""
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="1"/>{inertia}</inertial>'
    links = [f'<link name="link{k}">{inertial}</link>' for k in range(n + 1)]
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="2"/>'
    joints = [
        f'<joint name="j{k}" type="revolute"><parent link="link{k}"/>'
        f'<child link="link{k + 1}"/>{limit}</joint>'
        for k in range(n)
    ]
    return f'<robot name="chain">{"".join(links + joints)}</robot>'


@needs_kernel
@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("joints_within", ([], [], [], 0.0)),
        ("joints_within", ([0.0] * 65, [0.0] * 65, [[0.0] * 3] * 65, 0.0)),
        ("joints_within", ([0.0], ["a"], [[0.0] * 3], 0.0)),
        ("velocity_check", (*[[0.0]] * 7, [[0.0]], 1.0, 1.0, 1.0, (1.0,) * 10)),
        ("torque_check", (np.eye(2), *[np.ones(1)] * 2, *[[0.0]] * 7, 0.3, 1.0, ())),
        ("within", (np.zeros(2), [[0.0, 1.0]])),
        ("within", (np.zeros(1, np.float32), [[0.0, 1.0]])),
        ("torque_within", (np.zeros(4)[::2], np.zeros(2), [[1.0, 1.0]] * 2, 0.1)),
        ("joints_within", ([0.0], [0.0, 0.0], [[0.0, 1.0, 1.0]], 0.05)),
        ("rotation_vector", (np.eye(4), 1e-8)),
        ("point_positions", ([(np.zeros(3), np.eye(3), np.zeros(6))],)),
        ("point_speeds", ([(np.zeros(3), np.eye(3), np.zeros(5), [0.0] * 3)],)),
    ],
)
def test_arguments_of_another_size_or_type_are_refused(
    name: str, arguments: tuple[object, ...]
) -> None:
    with pytest.raises((ValueError, TypeError)):
        getattr(compiled.kernel, name)(*arguments)


def test_a_kernel_of_another_version_of_its_source_is_not_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stale = ModuleType("wam_power_ros._kernel")
    monkeypatch.setitem(sys.modules, stale.__name__, stale)
    stale.INTERFACE = compiled._INTERFACE
    assert compiled._built() is stale
    stale.INTERFACE += 1
    assert compiled._built() is None


def test_the_package_is_built_without_a_compiler(tmp_path: Path) -> None:
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "CC": str(tmp_path / "none")}
    folders = [f"--build-{part}={tmp_path / part}" for part in ("lib", "temp")]
    command = [sys.executable, "setup.py", "-q", "build_ext", *folders]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [*tmp_path.rglob("_kernel*.so")] == []
