# SPDX-License-Identifier: Apache-2.0
"""Five tasks from the examples of dmpbbo and movement_primitives, with other words and numbers.

Each function returns what is taught and the return of a policy, which `learn` improves.
"""

from collections.abc import Callable

import numpy as np

import wam_power_ros as power

Taught = tuple[power.Policy, Callable[[power.Policy], float]]


def minimum_jerk(points: np.ndarray, duration: float) -> power.Policy:
    """Policy of a movement that passes through points (M, 3) on straight lines."""
    t = np.linspace(0.0, duration, 101)
    s = t / duration
    s = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)  # rest to rest
    at = np.linspace(0.0, 1.0, len(points))
    return power.fit(t, np.column_stack([np.interp(s, at, axis) for axis in np.transpose(points)]))


def effort(t: np.ndarray, path: np.ndarray) -> float:
    """Mean square of the acceleration."""
    return float(np.mean(np.gradient(np.gradient(path, t, axis=0), t, axis=0) ** 2))


def via_point() -> Taught:
    """Pass through a point at any time (dmpbbo, demo_bbo_of_dmps)."""
    start, via = np.array([0.18, 0.20, 0.0]), np.array([0.30, 0.30, 0.0])

    def return_of(tried: power.Policy) -> float:
        t, path = power.path(tried, start)
        missed = max(np.linalg.norm(path - via, axis=1).min() - 0.01, 0.0)
        return float(np.exp(-20.0 * missed - 1e-3 * effort(t, path)))

    return minimum_jerk([start, [0.40, 0.30, 0.0]], 0.5), return_of


def throw_a_ball() -> Taught:
    """Release a ball so that it lands on a spot of the floor (dmpbbo, demos/robot)."""
    start, spot, gravity = np.array([0.3, 0.0, 0.2]), 1.4, 9.81

    def return_of(tried: power.Policy) -> float:
        t, path = power.path(tried, start)
        released = int(0.6 * len(t))
        x, _, z = path[released]
        vx, _, vz = np.gradient(path, t, axis=0)[released]
        flight = (vz + np.sqrt(max(vz**2 + 2.0 * gravity * z, 0.0))) / gravity
        return float(np.exp(-2.0 * abs(x + vx * flight - spot) - 1e-4 * effort(t, path)))

    return minimum_jerk([start, [0.5, 0.0, 0.15], [0.7, 0.0, 0.5]], 0.8), return_of


def arm_with_joints() -> Taught:
    """Lead the tip of a planar arm through a point: the policy moves joints (dmpbbo, arm2D)."""
    via, start = np.array([0.5, 0.5]), np.zeros(3)

    def return_of(tried: power.Policy) -> float:
        t, angles = power.path(tried, start)  # [rad] in place of [m]
        along = np.cumsum(angles, axis=1)
        tip = np.stack([np.cos(along), np.sin(along)], axis=-1).mean(axis=1)  # links of 1/3 m
        missed = np.linalg.norm(tip - via, axis=1).min()
        return float(np.exp(-10.0 * missed - 1e-4 * effort(t, angles)))

    return minimum_jerk([start, np.array([np.pi / 6, np.pi / 3, np.pi / 3])], 0.8), return_of


def avoid_an_obstacle() -> Taught:
    """Bend around an obstacle on the taught path (movement_primitives, obstacle avoidance 2D)."""
    start, goal, obstacle = np.zeros(3), np.array([1.0, 1.0, 0.0]), np.array([0.92, 0.5, 0.0])

    def return_of(tried: power.Policy) -> float:
        _, path = power.path(tried, start)
        near = max(0.15 - np.linalg.norm(path - obstacle, axis=1).min(), 0.0)
        missed = np.linalg.norm(path[-1] - goal)
        return float(np.exp(-10.0 * near - 5.0 * missed))

    return minimum_jerk([start, obstacle, goal], 1.0), return_of


def change_the_goal() -> Taught:
    """End at another goal than the taught one (movement_primitives, scaling of a DMP)."""
    start, goal = np.zeros(3), np.array([0.35, 0.25, 0.0])

    def return_of(tried: power.Policy) -> float:
        t, path = power.path(tried, start)
        return float(np.exp(-10.0 * np.linalg.norm(path[-1] - goal) - 1e-3 * effort(t, path)))

    return minimum_jerk([start, [0.4, 0.1, 0.0]], 1.0), return_of


def learn(task: Callable[[], Taught], rollouts: int = 100, seed: int = 0) -> tuple[float, float]:
    """Return of what was taught, and of what was learnt from so many rollouts."""
    taught, return_of = task()
    attempts = [*power.practise(return_of, taught, np.random.default_rng(seed), rollouts)]
    return attempts[0].ret, return_of(attempts[-1].mean)


TASKS = (via_point, throw_a_ball, arm_with_joints, avoid_an_obstacle, change_the_goal)
if __name__ == "__main__":
    for task in TASKS:
        before, after = learn(task)
        print(f"{task.__name__:18} taught {before:.3f}, learnt {after:.3f}")
