# SPDX-License-Identifier: Apache-2.0
"""Returns of a toss: Eq. 5, and a return for a half turn that lands in the pan.

A return is the sum of its terms, each at least zero, as PoWER requires.
"""

import math

import numpy as np

from wam_power_ros.tasks.flip.flight import Flight

WEIGHT = 0.5  # of each term of Eq. 5: of rotation and distance [1], of altitude [1/m]
ALTITUDE_MAX = 0.4  # [m]; a higher toss does not make up for a bad landing
LANDING_SCALE = 0.3  # [m]; with a sharper term (0.1) the learner no longer increased the rotation


def pancake_return(flight: Flight) -> dict[str, float]:
    """Terms of the return of a toss, by name (Eq. 5).

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
    return {
        "orientation": WEIGHT * turned,
        "position": WEIGHT * near,
        "altitude": WEIGHT * max(flight.apex, 0.0),
    }


def landing_return(flight: Flight) -> dict[str, float]:
    """Terms of a return of half a turn and a landing in the pan. Not in the paper.

        R = 0.4 rho + 0.1 min(apex, cap) / cap + rho^2 (0.3 exp(-d / d0) + 0.2 caught)

    rho = 1 - |angle - pi| / pi, at least 0, with the unfolded angle: 1 for half a turn, 0 for none
    or a whole turn. d is the horizontal distance at t_f. Landing and catching are weighted by the
    squared rotation, because a pancake that does not turn is easily caught. A perfect flip earns 1.
    """
    rotation = 0.0
    if flight.tossed:
        rotation = max(0.0, 1.0 - abs(flight.angle - math.pi) / math.pi)
    near = 0.0
    if flight.seen:
        near = math.exp(-math.hypot(*flight.landing_error[:2]) / LANDING_SCALE)
    altitude = min(max(flight.apex, 0.0), ALTITUDE_MAX) / ALTITUDE_MAX
    return {
        "rotation": 0.4 * rotation,
        "altitude": 0.1 * altitude,
        "landing": 0.3 * rotation**2 * near,
        "caught": 0.2 * rotation**2 * float(flight.resting),
    }
