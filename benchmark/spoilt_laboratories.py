# SPDX-License-Identifier: Apache-2.0
"""Laboratories in which something is wrong while an arm measures itself.

Each takes the recording of an ordinary arm and spoils it, by sizes that are drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from wam_power_ros import rotations
from wam_power_ros.commissioning.excitation import Excitation
from wam_power_ros.commissioning.measurement import Recording

CENTRE = np.array([1.5, 1.0, 2.0])  # [m] of the cameras, about which they are turned


@dataclass(frozen=True, eq=False)
class Laboratory:
    """What a laboratory measures and tells."""

    plan: Excitation
    recorded: Recording  # begins with the movement
    payload: float  # mass of the tool beyond the URDF's, as told [kg]
    gravity_added: bool = False  # whether the driver is said to add gravity

    @property
    def t(self) -> np.ndarray:
        """Times of the poses from the beginning of the movement on [s]. Shape (P,)."""
        return self.recorded.seen_t - self.recorded.t[0]

    def after(self, share: float) -> np.ndarray:
        """1 for poses after a share of the rests, else 0. Shape (P,)."""
        end = self.plan.rests[round(share * (len(self.plan.rests) - 1)), 1]
        return (self.t > end).astype(float)

    def with_cameras(self, share: np.ndarray, mm: float, degrees: float, rng: Rng) -> Laboratory:
        """The cameras moved in a drawn direction, by a share of this for each pose."""
        turn = rotations.exp(share[:, None] * np.deg2rad(degrees) * _direction(rng))
        seen, shift = self.recorded.position - CENTRE, 1e-3 * mm * _direction(rng)
        position = np.einsum("pij,pj->pi", turn, seen) + CENTRE + share[:, None] * shift
        return self._seen(position, turn @ self.recorded.rotation)

    def with_body(self, offset: np.ndarray, vector: np.ndarray) -> Laboratory:
        """The body moved in its own frame: offsets [m], rotation vectors [rad]. Shapes (P, 3)."""
        turned = self.recorded.rotation
        position = self.recorded.position + np.einsum("pij,pj->pi", turned, offset)
        return self._seen(position, turned @ rotations.exp(vector))

    def _seen(self, position: np.ndarray, rotation: np.ndarray) -> Laboratory:
        return replace(self, recorded=replace(self.recorded, position=position, rotation=rotation))


Rng = np.random.Generator
Spoil = Callable[[Laboratory, Rng], Laboratory]


def _direction(rng: Rng) -> np.ndarray:
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def _knocked(low: float, high: float, mm: float, degrees: float = 0.0) -> Spoil:
    """Cameras are knocked between two shares of the rests."""
    return lambda lab, rng: lab.with_cameras(lab.after(rng.uniform(low, high)), mm, degrees, rng)


def _loose(lab: Laboratory, rng: Rng) -> Laboratory:
    """The body lies anew after each move, by 3 to 5 mm and 1.4 to 2.9 degrees at most."""
    moves = np.searchsorted(lab.plan.rests[:, 0] - 0.5, lab.t)
    place, turn = rng.uniform(-1.0, 1.0, (2, len(lab.plan.rests) + 1, 3))
    mm, degrees = rng.uniform(3.0, 5.0), rng.uniform(1.4, 2.9)
    return lab.with_body(1e-3 * mm * place[moves], np.deg2rad(degrees) * turn[moves])


def _hanging(lab: Laboratory, rng: Rng) -> Laboratory:
    """The body gives way to gravity, by 3 to 5 mm and 1.4 to 2.9 degrees at most."""
    down = -lab.recorded.rotation[:, 2]
    turn = np.deg2rad(rng.uniform(1.4, 2.9)) * np.cross(down, [0.0, 0.0, 1.0])
    return lab.with_body(1e-3 * rng.uniform(3.0, 5.0) * down, turn)


def _slipped(lab: Laboratory, rng: Rng) -> Laboratory:
    later = lab.after(rng.uniform(0.3, 0.9))[:, None]
    return lab.with_body(4e-3 * later * _direction(rng), np.deg2rad(2.0) * later * _direction(rng))


def _sliding(lab: Laboratory, rng: Rng) -> Laboratory:
    share = (lab.t / lab.t[-1])[:, None]
    return lab.with_body(8e-3 * share * _direction(rng), 0.0 * share * _direction(rng))


def _exchanged(lab: Laboratory, which: np.ndarray) -> Laboratory:
    """Markers were exchanged in some of the poses, whose body is turned then. Shape (P,)."""
    return lab.with_body(np.zeros((len(which), 3)), which[:, None] * [0.0, 0.0, 2.0])


def _exchanged_at_times(lab: Laboratory, rng: Rng) -> Laboratory:
    moves = np.searchsorted(lab.plan.rests[:, 0] - 0.5, lab.t)
    return _exchanged(lab, rng.random(len(lab.plan.rests) + 1)[moves] < 0.2)


def _clock(ms: float, drift_ms: float) -> Spoil:
    """The cameras' clock is ahead, and becomes slower."""

    def spoil(lab: Laboratory, rng: Rng) -> Laboratory:
        late = 1e-3 * (drift_ms * lab.t / lab.t[-1] - ms)
        return replace(lab, recorded=replace(lab.recorded, seen_t=lab.recorded.seen_t + late))

    return spoil


def _swapped_motors(lab: Laboratory, rng: Rng) -> Laboratory:
    order = np.arange(lab.recorded.tau.shape[1])
    order[[4, 5]] = 5, 4
    return replace(lab, recorded=replace(lab.recorded, tau=lab.recorded.tau[:, order]))


def _slipped_encoder(lab: Laboratory, rng: Rng) -> Laboratory:
    q, t = lab.recorded.q.copy(), lab.recorded.t - lab.recorded.t[0]
    begin = lab.plan.rests[round(rng.uniform(0.3, 0.8) * (len(lab.plan.rests) - 1)), 1]
    q[t > begin, int(rng.integers(1, 6))] += np.deg2rad(1.0)
    return replace(lab, recorded=replace(lab.recorded, q=q))


def _tilted(low: float, high: float) -> Spoil:
    """A plate 3 degrees off flat, about a drawn axis from the last joint's on [degrees]."""

    def spoil(lab: Laboratory, rng: Rng) -> Laboratory:
        angle = np.deg2rad(rng.uniform(low, high)) - 0.3  # of the body on the tool
        axis = rng.choice([-1.0, 1.0]) * np.array([np.cos(angle), np.sin(angle), 0.0])
        vector = np.tile(np.deg2rad(3.0) * axis, (len(lab.t), 1))
        return lab.with_body(0.0 * vector, vector)

    return spoil


SPOILT: dict[str, Spoil] = {
    "cameras knocked by 20 mm in mid-course": _knocked(0.4, 0.6, 20.0),
    "cameras knocked by 20 mm soon": _knocked(0.08, 0.15, 20.0),
    "cameras knocked by 5 mm": _knocked(0.3, 0.7, 5.0),
    "cameras turned by 0.5 degrees after the postures": _knocked(1.0, 1.0, 0.0, 0.5),
    "cameras knocked by 10 mm in the sweeps": lambda lab, rng: lab.with_cameras(
        (lab.t > lab.plan.sweeps[2, 0]).astype(float), 10.0, 0.0, rng
    ),
    "cameras drift by 10 mm": lambda lab, rng: lab.with_cameras(lab.t / lab.t[-1], 10.0, 0.0, rng),
    "cameras' clock 20 ms ahead": _clock(20.0, 0.0),
    "cameras' clock drifts by 20 ms": _clock(0.0, 20.0),
    "body loose": _loose,
    "body gives way to gravity": _hanging,
    "body slips by 4 mm and 2 degrees": _slipped,
    "body slides by 8 mm": _sliding,
    "markers exchanged in a fifth of the rests": _exchanged_at_times,
    "markers exchanged from mid-course on": lambda lab, rng: _exchanged(lab, lab.after(0.5)),
    "motors 5 and 6 swapped": _swapped_motors,
    "an encoder slips by 1 degree": _slipped_encoder,
    "plate 3 degrees off flat": _tilted(0.0, 360.0),
    "plate 3 degrees off flat about the last axis": _tilted(-5.0, 5.0),
    "tool's mass told wrongly": lambda lab, rng: replace(
        lab, payload=lab.payload + rng.choice([-1.0, 1.0]) * rng.uniform(0.12, 0.3)
    ),
    "driver said to add gravity": lambda lab, rng: replace(lab, gravity_added=True),
}
