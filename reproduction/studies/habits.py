# SPDX-License-Identifier: Apache-2.0
"""Habits of a demonstrator that make a toss harder to learn from."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from hardware_sim.demonstrator import Target
from hardware_sim.scenes.flip import TossScript
from wam_power_ros import rotations

LATE = 0.06  # [s] by which the wrist turns after it has risen
SLOWER = 1.3  # duration of a slow toss, relative to the intended one
TREMOR_RATE = 5.0  # [Hz]; below the cut-off of the filter of demonstrations
TREMOR = 0.004  # amplitude along x and z [m]
TREMOR_TURN = 0.026  # amplitude of the pitch [rad]


class _LateTwist(TossScript):
    """The pan turns later than the wrist rises."""

    @property
    def end(self) -> float:
        return float(self.t[-1]) + LATE

    @cached_property
    def _wrist(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(*self._held(self.t, self.wrist, self.wrist_speed))

    @cached_property
    def _pitch(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(
            np.concatenate([[0.0], self.t + LATE]),
            np.concatenate([self.pitch[:1], self.pitch]),
            np.concatenate([self.pitch_rate[:1], self.pitch_rate]),
        )

    @staticmethod
    def _held(
        t: np.ndarray, values: np.ndarray, rates: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Keyframes that stay at their last value for LATE."""
        return (
            np.append(t, t[-1] + LATE),
            np.concatenate([values, values[-1:]]),
            np.concatenate([rates, np.zeros_like(rates[-1:])]),
        )


class _Tremor(TossScript):
    """The hand shakes along x, along z and about y, each at another phase."""

    def target(self, t: float, position: np.ndarray, rotation: np.ndarray) -> Target:
        wanted = super().target(t, position, rotation)
        if t >= self.end:
            return wanted
        omega = 2.0 * np.pi * TREMOR_RATE
        phase = omega * t + np.array([0.0, 2.0, 4.0])
        amplitude = np.array([TREMOR, TREMOR, TREMOR_TURN])
        x, z, pitch = amplitude * (np.sin(phase) - np.sin([0.0, 2.0, 4.0]))
        vx, vz, rate = amplitude * omega * np.cos(phase)
        turn = rotations.exp(np.array([0.0, -pitch, 0.0]))
        return Target(
            wanted.position + np.array([x, 0.0, z]),
            turn @ wanted.rotation,
            wanted.velocity + np.array([vx, 0.0, vz]),
            wanted.omega + np.array([0.0, -rate, 0.0]),
        )


def _slower(script: TossScript) -> TossScript:
    return dataclasses.replace(
        script,
        t=SLOWER * script.t,
        wrist_speed=script.wrist_speed / SLOWER,
        pitch_rate=script.pitch_rate / SLOWER,
    )


HABITS: Mapping[str, Callable[[TossScript], TossScript]] = {
    "late twist": lambda script: _LateTwist(**vars(script)),
    "slow": _slower,
    "tremor": lambda script: _Tremor(**vars(script)),
}
