# SPDX-License-Identifier: Apache-2.0
"""A state of the past, with the torque that was sent for it."""

from typing import NamedTuple

import numpy as np


class PastState(NamedTuple):
    """A reported posture [rad], the motor torque sent for it, and the one known beyond the model.

    Attributes:
        q: Joint positions [rad]. Shape (n,).
        tau: Motor torque commanded for `dt` after it [N m]. Shape (n,).
        external: Torque that acted beyond the model [N m]. n numbers.
        dt: Time until the next state [s].
    """

    q: np.ndarray
    tau: np.ndarray
    external: list[float]
    dt: float
