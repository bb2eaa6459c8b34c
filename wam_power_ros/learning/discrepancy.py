# SPDX-License-Identifier: Apache-2.0
"""What two descriptions of an error leave unexplained, and how probable each of them is."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from wam_power_ros.learning.learner import Prediction

NOISE = 0.5  # standard deviation of a measured error [tolerances]
VAGUE = 2.0  # the same of one beside a component without a value
CLIP = 6.0  # [tolerances] largest unexplained part that is believed of such a rollout
AMPLITUDES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # [tolerances] that an unexplained part may have
MISSED = 1.0  # log-likelihood of a component that the model predicted to have no value
LOCAL = 0.5  # standard deviation of its change, relative to that of its mean


class _Process:
    """Gaussian process of the unexplained part of one component.

    Its kernel is that of an unknown mean and of a smooth change about it, of which the amplitude is
    that of the highest likelihood, and of the numbers that a model only assumes.
    """

    def __init__(
        self,
        z: np.ndarray,
        uncertain: np.ndarray,
        rest: np.ndarray,
        noise: np.ndarray,
        length: float,
    ) -> None:
        self._z, self._uncertain, self._length = z, uncertain, length
        self.evidence, self.amplitude = 0.0, 1.0
        self._solved = np.empty(0)
        if len(rest) == 0:
            return
        self.evidence = -math.inf
        shape, assumed = self._kernel(z), uncertain @ uncertain.T
        for amplitude in AMPLITUDES:
            factor = cho_factor(amplitude**2 * shape + assumed + np.diag(noise**2))
            solved = cho_solve(factor, rest)
            evidence = -0.5 * float(rest @ solved) - float(np.log(np.diag(factor[0])).sum())
            if evidence > self.evidence:
                self.evidence, self.amplitude = evidence, amplitude
                self._factor, self._solved = factor, solved

    def _kernel(self, z: np.ndarray) -> np.ndarray:
        square = ((z[:, np.newaxis] - self._z) ** 2).sum(axis=2)
        return 1.0 + LOCAL**2 * np.exp(-0.5 * square / self._length**2)

    def at(self, z: np.ndarray, uncertain: np.ndarray) -> tuple[float, float]:
        """Mean and variance at z (size,), where the numbers of a model matter by (k,)."""
        variance = self.amplitude**2 * (1.0 + LOCAL**2) + float(uncertain @ uncertain)
        if len(self._solved) == 0:
            return 0.0, variance
        k = self.amplitude**2 * self._kernel(z[np.newaxis])[0] + self._uncertain @ uncertain
        return float(k @ self._solved), variance - float(k @ cho_solve(self._factor, k))


class Discrepancy:
    """Errors of rollouts against a model's predictions, and against rough ones.

    Attributes:
        weight: Probability of the model given the rollouts, if it was .5 before them.
    """

    def __init__(
        self,
        z: np.ndarray,
        errors: np.ndarray,
        predictions: Sequence[Prediction | None],
        rough: np.ndarray,
        length: float,
    ) -> None:
        """Fit both.

        Args:
            z: Coordinates of the rollouts. Shape (n, size).
            errors: Measured errors [tolerances], NaN where there is none. Shape (n, m).
            predictions: Prediction of each rollout by the model, None where it had none. Length n.
            rough: Errors that a rough linear description predicts. Shape (n, m).
            length: Distance over which the unexplained part changes.
        """
        predicted, known = np.full_like(errors, math.nan), ~np.isnan(errors)
        numbers = max(
            (each.uncertain.shape[1] for each in predictions if each is not None), default=0
        )
        uncertain = np.zeros((*errors.shape, numbers))
        for row, each in enumerate(predictions):
            if each is not None:
                predicted[row], uncertain[row] = each.error, each.uncertain
        vague = ~known.all(axis=1)
        noise = np.where(vague, VAGUE, NOISE)
        self._processes: list[list[_Process]] = []
        for given, assumed in ((predicted, uncertain), (rough, uncertain[..., :0])):
            rest = errors - given
            rest = np.where(vague[:, np.newaxis], np.clip(rest, -CLIP, CLIP), rest)
            usable = ~np.isnan(rest)
            self._processes.append(
                [
                    _Process(z[use], assumed[use, k], rest[use, k], noise[use], length)
                    for k, use in enumerate(usable.T)
                ]
            )
        missed = int((known & np.isnan(predicted)).sum())
        ratio = -MISSED * missed + sum(
            model.evidence - other.evidence for model, other in zip(*self._processes, strict=True)
        )
        self.weight = 1.0 / (1.0 + math.exp(min(max(-ratio, -50.0), 50.0)))

    def expected(
        self, z: np.ndarray, prediction: Prediction | None, rough: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance of the error at z.

        Args:
            z: Coordinates. Shape (size,).
            prediction: Prediction at z by the model, None to ignore the model.
            rough: Error that the rough description predicts. Shape (m,).
        """
        descriptions = [Prediction(rough, np.empty(0))]
        if prediction is not None:
            descriptions.insert(0, prediction)
        means, variances = [], []
        for (error, _, uncertain), processes in zip(
            descriptions, self._processes[-len(descriptions) :], strict=True
        ):
            rows = np.broadcast_to(uncertain, (len(error), uncertain.shape[1]))
            rest = np.array([each.at(z, row) for each, row in zip(processes, rows, strict=True)])
            means.append(error + rest[:, 0])
            variances.append(rest[:, 1])
        if prediction is None:
            return means[0], variances[0]
        w = self.weight
        mean = w * means[0] + (1.0 - w) * means[1]
        spread = w * (1.0 - w) * (means[0] - means[1]) ** 2
        variance = w * variances[0] + (1.0 - w) * variances[1] + np.nan_to_num(spread)
        return mean, variance
