# SPDX-License-Identifier: Apache-2.0
"""Measured errors of a rollout and what moves them, from which corrections and plans follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wam_power_ros.learning.learner import Prediction
from wam_power_ros.learning.parametrization import Direction, Group, Parametrization, Tempo
from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.rollout import SimulatedRollout

Simulate = Callable[[Policy], SimulatedRollout | None]  # None if it ends in a fault
KNOWN = ("shift_x", "shift_y", "shift_z", "amplitude", "tempo")  # see `direction`
SHOWN_IN = {"m": (1000.0, ".1f", " mm"), "rad": (math.degrees(1.0), ".1f", "°")}  # by unit


@dataclass(frozen=True)
class Error:
    """Something that a rollout measures and that is to become 0, or what a goal asks.

    One that no effect moves is not learnt from: its limit alone counts.

    Attributes:
        unit: Its unit, such as "m" or "rad".
        tolerance: Size up to which a rollout is as good as is useful.
        limit: Size from which a rollout is no success; infinite if it does not decide that.
        scatter: Its standard deviation over rollouts of one policy, in doubt a larger one.
        target: Value from which it is measured, see `Task.targets`.
    """

    name: str
    unit: str
    tolerance: float
    limit: float = math.inf
    scatter: float = 0.0
    target: float = 0.0

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and isinstance(self.unit, str)):
            raise ValueError(f"{self}: name and unit must be text, such as 'miss' and 'm'")
        if not (0.0 < self.tolerance < math.inf and self.tolerance <= self.limit):
            raise ValueError(f"{self}: the tolerance must be above 0 and at most the limit")
        if not 0.0 <= self.scatter < math.inf:
            raise ValueError(f"{self}: the scatter must be at least 0, which is unknown")

    def shown(self, value: float | None) -> str:
        """Name and value, such as "miss x 12 mm", for a person."""
        factor, digits, unit = SHOWN_IN.get(self.unit, (1.0, ".3g", f" {self.unit}"))
        number = "unknown" if value is None else f"{factor * value:{digits}}{unit}"
        return f"{self.name.replace('_', ' ')} {number}"


@dataclass(frozen=True)
class Effect:
    """What a learnt parameter does to the errors, roughly.

    Attributes:
        group: Group of the parameter in the parametrization; one of `KNOWN` needs no
            parametrization of the task's own.
        step: Largest change of it that is made at once, in its unit.
        moves: Change of errors by name, in their units, per unit of the parameter.
        place: Place of the parameter in its group, negative from the end.
    """

    group: str
    step: float
    moves: Mapping[str, float]
    place: int = 0

    def __post_init__(self) -> None:
        if not 0.0 < self.step < math.inf:
            raise ValueError(f"{self}: the step must be above 0")
        if not all(move and math.isfinite(move) for move in self.moves.values()):
            raise ValueError(f"{self}: what it moves must change by a finite number, not 0")

    def direction(self, policy: Policy) -> Group:
        """The group of `KNOWN`, explored with a fifth of the step."""
        return direction(policy, self.group, self.step / 5.0)


def direction(policy: Policy, name: str, noise: float) -> Group:
    """Group of one parameter of any movement, by its name in `KNOWN`.

    * amplitude: Scales the movement, mu_i - mu_1 and r_i - r_1, by 1 + amplitude [1].
    * tempo: Logarithm of the tempo [1].
    * shift_x, shift_y, shift_z: Moves the end of the movement along an axis of the base, what is
      before it in proportion to its place [m].
    """
    if name == "tempo":
        return Tempo(noise)
    moved = np.zeros((policy.basis.count, 3))
    if name == "amplitude":
        turned = policy.rotation_attractors - policy.rotation_attractors[0]
        return Direction(noise, name, policy.attractors - policy.attractors[0], turned)
    moved[:, KNOWN.index(name)] = np.arange(1, len(moved) + 1) / len(moved)
    return Direction(noise, name, moved, np.zeros_like(moved))


class RoughErrors:
    """A `learner.ErrorModel` of the effects, alone or with a `predictor`.

    Attributes:
        errors: The errors, m of them.
        directions: A step along each effect, in coordinates z. Shape (d, size).
        modes: See `Parametrization.modes`.
        slopes: Change of each error by it [tolerances]. Shape (m, d).
    """

    predict: Callable[[np.ndarray], Prediction | None] | None = None

    def __init__(
        self, errors: Sequence[Error], effects: Sequence[Effect], parametrization: Parametrization
    ) -> None:
        self.errors = errors
        names, tolerances = [e.name for e in errors], np.array([e.tolerance for e in errors])
        effects = [each for each in effects if set(names) & each.moves.keys()]
        self.directions = np.zeros((len(effects), parametrization.size))
        self.modes = parametrization.modes()
        self.slopes = np.zeros((len(errors), len(effects)))
        for k, effect in enumerate(effects):
            group = range(parametrization.size)[parametrization.groups[effect.group]]
            if not -len(group) <= effect.place < len(group):
                raise ValueError(f"{effect}: the group has {len(group)} parameters")
            index = group[effect.place]
            self.directions[k, index] = effect.step / parametrization.scale[index]
            self.slopes[:, k] = [effect.step * effect.moves.get(n, 0.0) for n in names] / tolerances

    def correction(self, error: np.ndarray, gain: float) -> list[np.ndarray]:
        """Shifts of z (size,), one for each effect, that would have reduced an error.

        Args:
            error: Measured error [tolerances], NaN where it is unknown. Shape (m,).
            gain: Share of the error that is corrected; no effect goes further than its step.
        """
        known = np.isfinite(error)
        steps = -gain * np.linalg.pinv(self.slopes[known]) @ error[known]
        bounded = zip(np.clip(steps, -1.0, 1.0), self.directions, strict=True)
        return [step * direction for step, direction in bounded if step]


def predictor(
    errors: Sequence[Error],
    parametrization: Parametrization,
    simulate: Simulate,
    predicted: Callable[[SimulatedRollout], Sequence[Mapping[str, float]]],
) -> Callable[[np.ndarray], Prediction | None]:
    """`RoughErrors.predict` of what a task predicts, see `Task.predict`."""

    def predict(z: np.ndarray) -> Prediction | None:
        if (simulated := simulate(parametrization.policy(z, "predicted")[0])) is None:
            return None
        error, *others = (told(errors, each) for each in predicted(simulated))
        changes = [each - error for each in others]
        # A number that decides which parts have a value tells nothing of the others.
        known = [np.where(np.isfinite(each).all(), each, 0.0) for each in changes]
        uncertain = np.stack(known, axis=1) if known else np.empty((1, 0))
        return Prediction(error, simulated.limit_excess, uncertain)

    return predict


def told(errors: Sequence[Error], measured: Mapping[str, float]) -> np.ndarray:
    """Errors from their targets [tolerances], NaN where unknown, shape (m,), of values by name."""
    return np.array(
        [(measured.get(e.name, math.nan) - e.target) / e.tolerance for e in errors], dtype=float
    )


def learnt(errors: Sequence[Error], effects: Sequence[Effect]) -> list[Error]:
    """Those of the errors that an effect moves."""
    return [error for error in errors if any(error.name in effect.moves for effect in effects)]
