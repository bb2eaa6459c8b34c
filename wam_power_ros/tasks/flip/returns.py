# SPDX-License-Identifier: Apache-2.0
"""Returns of a toss: Eq. 5, and a return for a half turn that lands in the pan.

Every return is at least zero, as PoWER requires.
"""

import math
from dataclasses import dataclass

import numpy as np

from wam_power_ros.tasks.flip.flight import Flight


@dataclass(frozen=True)
class Return:
    """A return: weighted terms by name, each at least 0."""

    terms: dict[str, float]

    @property
    def total(self) -> float:
        """Sum of the terms."""
        return math.fsum(self.terms.values())


class _Weights:
    """Weights of a return: finite and at least 0."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} = {value} must be finite and at least 0")


@dataclass(frozen=True)
class PancakeWeights(_Weights):
    """Weights of Eq. 5; all 0.5 in the paper.

    Attributes:
        orientation: Weight w1 of the rotation [1].
        position: Weight w2 of the distance between pancake and pan [1].
        altitude: Weight w3 of the altitude [1/m].
    """

    orientation: float = 0.5
    position: float = 0.5
    altitude: float = 0.5


@dataclass(frozen=True)
class LandingWeights(_Weights):
    """Weights of `landing_return`; by default a perfect flip has a return of 1.

    Attributes:
        rotation: Weight of the unfolded rotation.
        altitude: Weight of the altitude up to its cap.
        altitude_cap: Altitude at which the altitude term saturates [m], so that a higher toss does
            not compensate for a bad landing.
        landing: Weight of landing near the centre of the pan.
        landing_scale: Distance at which the landing term is 1/e [m]; with a sharper term (0.1) the
            learner no longer increased the rotation.
        caught: Weight of resting in the pan at the end.
    """

    rotation: float = 0.4
    altitude: float = 0.1
    altitude_cap: float = 0.4
    landing: float = 0.3
    landing_scale: float = 0.3
    caught: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.altitude_cap > 0.0 and self.landing_scale > 0.0):
            raise ValueError(
                f"altitude_cap = {self.altitude_cap} and landing_scale = {self.landing_scale} "
                "must be positive"
            )


PAPER_WEIGHTS = PancakeWeights()


def pancake_return(flight: Flight, weights: PancakeWeights = PAPER_WEIGHTS) -> Return:
    """Return of a toss (Eq. 5).

        R = w1 arccos(v0 . v_tf) / pi + w2 exp(-|x_P - x_F|) + w3 x3_max

    The 1/pi is in the typeset paper. Not defined in the paper: if the pancake is not tossed, the
    first term is 0 and t_f the end; if it is lost from view, the second term is 0 (and the first if
    the rotation was not seen either); the altitude is measured from the pan's height at the start
    and is at least 0.
    """
    turned = 0.0
    if flight.tossed:
        cosine = float(np.dot(flight.normal_start, flight.normal))
        turned = math.acos(min(max(cosine, -1.0), 1.0)) / math.pi
    near = 0.0
    if flight.seen:
        near = math.exp(-float(np.linalg.norm(flight.position - flight.pan_position)))
    return Return(
        {
            "orientation": weights.orientation * turned,
            "position": weights.position * near,
            "altitude": weights.altitude * max(flight.apex, 0.0),
        }
    )


def landing_return(flight: Flight, weights: LandingWeights) -> Return:
    """Return that rewards half a turn and a landing in the pan. Not in the paper.

        R = w_r rho + w_a min(apex, cap) / cap + rho^2 (w_l exp(-d / d0) + w_c caught)

    rho = 1 - |angle - pi| / pi, at least 0, with the unfolded angle: 1 for half a turn, 0 for none
    or a whole turn. d is the horizontal distance at t_f. Landing and catching are weighted by the
    squared rotation, because a pancake that does not turn is easily caught.
    """
    rotation = 0.0
    if flight.tossed:
        rotation = max(0.0, 1.0 - abs(flight.angle - math.pi) / math.pi)
    near = 0.0
    if flight.seen:
        near = math.exp(-math.hypot(*flight.landing_error[:2]) / weights.landing_scale)
    altitude = min(max(flight.apex, 0.0), weights.altitude_cap) / weights.altitude_cap
    return Return(
        {
            "rotation": weights.rotation * rotation,
            "altitude": weights.altitude * altitude,
            "landing": weights.landing * rotation**2 * near,
            "caught": weights.caught * rotation**2 * float(flight.resting),
        }
    )
