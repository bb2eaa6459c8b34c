# SPDX-License-Identifier: Apache-2.0
"""Results that the paper publishes on flipping a pancake, digitised from its plots."""

from __future__ import annotations

import numpy as np

# Rollout and mean return (Eq. 5) of six sessions (Fig. 5). Shape (50, 2).
_MEANS = [
    [0.644, 0.728, 0.643, 0.714, 0.684, 0.686, 0.696, 0.757, 0.705, 0.772],
    [0.776, 0.747, 0.752, 0.771, 0.808, 0.775, 0.822, 0.819, 0.848, 0.807],
    [0.742, 0.783, 0.752, 0.809, 0.803, 0.774, 0.836, 0.837, 0.819, 0.887],
    [0.909, 0.819, 0.938, 0.918, 0.838, 0.942, 0.818, 0.918, 0.860, 0.876],
    [0.844, 0.926, 0.914, 0.932, 0.980, 0.996, 1.039, 1.029, 1.054, 1.050],
]
FIG5 = np.column_stack([np.arange(1.0, 51.0), np.ravel(_MEANS)])
# Time [s] and vertical stiffness [1/s^2] of the learnt policy. Shape (11, 2).
K33 = np.column_stack(
    [
        [0.00, 0.12, 0.25, 0.37, 0.49, 0.74, 0.99, 1.24, 1.48, 1.61, 1.75],
        [322.6, 317.5, 311.5, 306.2, 302.6, 300.5, 303.2, 305.3, 311.3, 312.4, 312.0],
    ]
)
