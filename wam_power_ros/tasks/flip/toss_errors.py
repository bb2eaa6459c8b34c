# SPDX-License-Identifier: Apache-2.0
"""Vector error of a toss, rotation and landing: measured, and predicted for a simulated pan.

The simulated arm carries the pan along a path. On it the pancake is a point that slides with
friction as far as the rim and leaves the pan where that accelerates downwards faster than gravity.
It then flies with the pan's angular velocity, which drag slows. Fallen back before it was tossed,
as in a dip, it slides on. How much drag slows the spin is a number that rollouts tell, see
`learner.Prediction`; what the model leaves out (the pancake's size, how its edge leaves the rim) is
for a learner to find from them, too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.learning.learner import Prediction
from wam_power_ros.learning.parametrization import Parametrization
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import EndEffectorPath, Foreseen
from wam_power_ros.tasks.flip.ballistic_fit import GRAVITY
from wam_power_ros.tasks.flip.flight import DELTA_H
from wam_power_ros.tasks.flip.frames import PAN_RADIUS, PANCAKE_RADIUS
from wam_power_ros.tasks.flip.parametrization import TURN_OF_FLICK, TURN_OF_TEMPO, TURN_OF_VIGOUR
from wam_power_ros.tasks.flip.settings import FlipSettings

TURN_TOLERANCE = math.radians(15.0)  # [rad]
LANDING_TOLERANCE = 0.03  # [m]
# Drag slows the spin of a pancake, d omega / dt = -SPIN_DECAY omega^2 [1/rad], the more the larger
# and lighter it is: mean and standard deviation.
SPIN_DECAY, SPIN_DECAY_SD = 0.4, 0.3
SLACK = PAN_RADIUS - PANCAKE_RADIUS  # between the pancake in the middle of the pan and its rim [m]
FRICTION = 0.2  # between pancake and pan [1]
# Group, size of a step, and additional rotation [rad] and landing error [m] per unit of it.
DIRECTIONS = (
    ("vigour", 0.3, TURN_OF_VIGOUR, (0.0, 0.0)),
    ("tempo", 0.15, TURN_OF_TEMPO, (0.0, 0.0)),
    ("flick", 0.3, TURN_OF_FLICK, (0.0, 0.0)),
    ("catch_shift", 0.25, 0.0, (-1.0, 0.0)),
    ("side_shift", 0.25, 0.0, (0.0, -1.0)),
)


class Toss(NamedTuple):
    """A predicted toss.

    Attributes:
        tossed: Whether the pancake rises above the pan by more than Delta_h.
        angle: Rotation when it falls through that height [rad]; 0 if not tossed.
        landing_error: Position of pancake minus pan along x and y at that time [m]; 0 if not
            tossed.
        angle_by_decay: Derivative of the rotation by the decay of the spin [rad^2].
    """

    tossed: bool
    angle: float = 0.0
    landing_error: tuple[float, float] = (0.0, 0.0)
    angle_by_decay: float = 0.0


def predict_toss(
    pan: EndEffectorPath, delta_h: float = DELTA_H, spin_decay: float = SPIN_DECAY
) -> Toss:
    """Predict the toss of a pan that moves along a path in the x-z plane.

    Args:
        pan: Path of the pan, evenly sampled.
        delta_h: Height above the pan at which the flight ends [m].
        spin_decay: Decay of the pancake's spin, above 0 [1/rad].
    """
    dt = float(pan.t[1] - pan.t[0])
    normal = rotations.matrix(pan.quat_xyzw)[:, :, 2]
    pitch = np.unwrap(np.arctan2(-normal[:, 0], normal[:, 2]))  # front edge up
    velocity = np.gradient(pan.position, dt, axis=0)
    acceleration = np.gradient(velocity, dt, axis=0)
    rate = np.gradient(pitch, dt)
    samples = np.column_stack(
        [
            pan.position[:, [0, 2]],
            velocity[:, [0, 2]],
            acceleration[:, [0, 2]],
            *(np.cos(pitch), np.sin(pitch), pitch, rate, np.gradient(rate, dt)),
            pan.position[:, 1],
        ]
    ).tolist()
    tilted = abs(math.tan(pitch[0])) > FRICTION
    s, sliding = (-math.copysign(SLACK, pitch[0]) if tilted else 0.0), 0.0  # along the pan's x
    x = y = z = vx = vz = left = spin = turned = 0.0  # of the pancake in flight
    flying = tossed = False
    for now, after in itertools.pairwise(samples):
        px, pz, pvx, pvz, ax, az, c, sn, angle, omega, alpha, aside = now
        if not flying:
            # Acceleration of the point of the pan below the pancake, against gravity.
            gx = -(ax - s * (alpha * sn + omega**2 * c))
            gz = -(az + s * (alpha * c - omega**2 * sn)) - GRAVITY
            pressed = gx * sn - gz * c  # [m/s^2]
            if pressed < 0.0:
                flying = True
                x, y, z = px + s * c, aside, pz + s * sn
                vx, vz = pvx - omega * s * sn + sliding * c, pvz + omega * s * c + sliding * sn
                left, spin, turned = angle - samples[0][8], omega, 0.0
            else:
                pulled = sliding + dt * (gx * c + gz * sn)
                sliding = math.copysign(max(abs(pulled) - dt * FRICTION * pressed, 0.0), pulled)
                s += dt * sliding
                if abs(s) > SLACK:
                    s, sliding = math.copysign(SLACK, s), 0.0
        if flying:
            vz -= dt * GRAVITY
            x, z, turned = x + dt * vx, z + dt * vz, turned + dt * spin  # without drag
            dx, dz, c, sn = x - after[0], z - after[1], after[6], after[7]
            if dz > delta_h:
                tossed = True
            elif tossed:
                slowed, by_decay = _slowed(turned, spin_decay)
                return Toss(True, left + slowed, (dx, y - after[11]), by_decay)
            elif dz * c - dx * sn < 0.0:  # fallen back into the pan
                flying = False
                s = min(max(dx * c + dz * sn, -SLACK), SLACK)
                sliding = (vx - after[2]) * c + (vz - after[3]) * sn
    return Toss(False)


def _slowed(turned: float, decay: float) -> tuple[float, float]:
    """Rotation that is `turned` without drag [rad], and its derivative by the decay [rad^2]."""
    slowed = math.copysign(math.log1p(decay * abs(turned)) / decay, turned)
    return slowed, (turned / (1.0 + decay * abs(turned)) - slowed) / decay


def measured_error(flight: Mapping[str, Any] | None) -> np.ndarray | None:
    """Errors of rotation and landing along x and y of an observed toss, in tolerances. Shape (3,).

    None if the pancake was not observed.
    """
    if flight is None or (flight["tossed"] and not flight["seen"]):
        return None
    return _error(bool(flight["tossed"]), flight["angle"], flight["landing_error"][:2])


def _error(tossed: bool, angle: float, landing_error: Sequence[float]) -> np.ndarray:
    """Errors in tolerances; a pancake that was not tossed has not turned, and has no landing."""
    landing = np.array(landing_error) / LANDING_TOLERANCE if tossed else np.full(2, math.nan)
    return np.array([(angle - math.pi) / TURN_TOLERANCE, *landing])


class TossErrors:
    """A `learner.ErrorModel` of a toss: rotation and landing along x and y.

    Attributes:
        directions: Those of the corrections in hindsight, see `DIRECTIONS`.
        slopes: Change of the errors by each.
    """

    def __init__(
        self,
        parametrization: Parametrization,
        foresee: Callable[[Policy], Foreseen | None],
        settings: FlipSettings,
    ) -> None:
        """See `Task.error_model`."""
        self._parametrization, self._foresee = parametrization, foresee
        self._settings = settings
        self._known: dict[bytes, Prediction | None] = {}  # by coordinates; a simulation is slow
        self.directions = np.zeros((len(DIRECTIONS), parametrization.size))
        self.slopes = np.zeros((3, len(DIRECTIONS)))
        for k, (group, size, turn, shift) in enumerate(DIRECTIONS):
            index = parametrization.groups[group].start
            self.directions[k, index] = size / parametrization.scale[index]
            self.slopes[0, k] = size * turn / TURN_TOLERANCE
            self.slopes[1:, k] = size * np.array(shift) / LANDING_TOLERANCE

    def predict(self, z: np.ndarray) -> Prediction | None:
        """See `learner.ErrorModel`."""
        key = z.tobytes()
        if key not in self._known:
            policy, _ = self._parametrization.policy(z, "predicted")
            foreseen, prediction = self._foresee(policy), None
            if foreseen is not None:
                toss = predict_toss(foreseen.tool, self._settings.delta_h)
                by_decay = SPIN_DECAY_SD * toss.angle_by_decay / TURN_TOLERANCE
                error = _error(toss.tossed, toss.angle, toss.landing_error)
                uncertain = np.array([[by_decay], [0.0], [0.0]])
                prediction = Prediction(error, foreseen.excess, uncertain)
            self._known[key] = prediction
        return self._known[key]
