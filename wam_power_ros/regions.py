# SPDX-License-Identifier: Apache-2.0
"""Guarded regions: named shapes that end a rollout."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Region:
    """Sphere in the base frame; a rollout ends when the tool's centre enters it.

    Raises:
        ValueError: The name is empty, or a value is out of range.
    """

    name: str  # as a stopped rollout says it
    centre: tuple[float, float, float]  # [m]
    radius: float  # [m]

    def __post_init__(self) -> None:
        if not self.name:
            raise ValueError("a guarded region must have a name")
        object.__setattr__(self, "centre", tuple(map(float, self.centre)))
        sphere = (*self.centre, self.radius)
        if len(sphere) != 4 or not all(map(math.isfinite, sphere)) or self.radius <= 0.0:
            raise ValueError(f"region {self.name!r} = {sphere}: x, y, z and a positive radius")

    def contains(self, position: np.ndarray) -> bool:
        """Whether a position [m] (3,) is inside."""
        return math.dist(position.tolist(), self.centre) < self.radius


def region_of(name: str, sphere: Sequence[float]) -> Region | None:
    """Region of a parameter: x, y, z and radius [m]; None for a radius of 0."""
    x, y, z, radius = sphere
    return Region(name, (x, y, z), radius) if radius else None
