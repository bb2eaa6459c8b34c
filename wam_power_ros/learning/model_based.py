# SPDX-License-Identifier: Apache-2.0
"""Planning on a model of the vector error, corrected and weighted by the session's rollouts.

Not in the paper. The return of a rollout is one number; its error is a vector of which a model
predicts how it changes. As in [Cully2015], rollouts are compared with a model by a Gaussian process
of what it leaves unexplained; as in [Pautrat2018], the likelihood of the rollouts weighs the model
against a poorer one. See `ModelBased`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydantic import Field

from wam_power_ros.learning.discrepancy import Discrepancy
from wam_power_ros.learning.learner import ErrorModel, GaussianLearner, LearnerSettings, Prediction
from wam_power_ros.learning.power import Power

UNKNOWN = 8.0  # [tolerances] assumed of an error without a value
GOOD = 0.5  # [tolerances] of an expected error that needs no better plan
FINE = 1.25  # [tolerances] of a rollout's error that needs no progress
PROGRESS = 0.8  # share of an earlier squared error, below which there is progress
CAUTION = 0.02  # weight of the variance of an expected error
EXCESS = 0.02  # excess that weighs as much as an error of a tolerance, see `Prediction`
SLACK = 0.01  # excess that a plan keeps below 0
IGNORED = 0.02  # weight below which the model is not asked any more
BLIND = 4  # rollouts without a complete error, after which PoWER decides
REST = 5.0  # unit of the search beyond the model's directions [sd of the exploration]
STEP_MAX = 1.0  # largest step along an axis of the search
PROBE = 0.15  # step along a direction in which the changes are unknown
SAME = 0.1  # distance along the axes from a rollout below which a plan is not a new one
NEAR = 1.0  # distance along the axes over which slopes are alike
SLOPE_SD = 0.1  # change along an axis whose observation weighs as much as the rough slopes
ACTIVE_SETS = 8  # rounds in which a step finds the limits that it would exceed


class _Point(NamedTuple):
    """Coordinates that may be a plan.

    Attributes:
        z: Coordinates. Shape (size,).
        values: Expected error, NaN where it has no value, and predicted excess. Shape (m + c,).
        feasible: Whether no limit is exceeded, as far as it is predicted.
        loss: Expected squared error, and the squares of what is exceeded.
    """

    z: np.ndarray
    values: np.ndarray
    feasible: bool
    loss: float


def _best(points: Sequence[_Point]) -> _Point:
    return min(points, key=lambda point: point.loss)


class ModelBased(GaussianLearner):
    """Planning on a model of the vector error. Not in the paper.

    Two descriptions of the error are corrected by a Gaussian process of what the rollouts differ
    from them: the model's prediction, and the rough linear slopes that come with it. They are
    weighted by their probabilities given the rollouts, so a model that is wrong is soon ignored.

    A plan is found by Gauss-Newton steps on the expected error, with the limits that they would
    exceed, from the best coordinates that were executed or predicted so far. Their slopes are a
    regression of the predictions near by. The model's few directions are probed first, then random
    ones among all coordinates. A rollout is executed at the plan, without exploration. Each that
    had no complete error, as a throw that did not come off or that a fault ended, halves the way of
    the next plan from the best rollout: there is an edge between them.

    PoWER learns from the same rollouts, as told. It decides when no complete error has been
    measured in `BLIND` rollouts, or is foreseen before that; when no better plan is found than one
    that was run and is not within the tolerances; after `patience` rollouts without progress;
    after `planned` rollouts: the error may leave out something that matters; and once a person has
    rated a rollout.

    What was predicted for a plan is known to later ones. So the state is a function of the rollouts
    and of the draws between them, as in a session that is replayed.
    """

    class Settings(LearnerSettings):
        """Settings of model-based learning.

        Attributes:
            simulations: Largest number of predictions for a plan.
            length: Distance over which what a description leaves unexplained changes [sd of the
                exploration].
            patience: Number of rollouts without progress after which PoWER decides.
            planned: Number of rollouts after which it decides in any case: small errors alone have
                not sufficed.
            fallback: Settings of PoWER.
        """

        simulations: int = Field(default=40, ge=1)
        length: float = Field(default=10.0, gt=0.0, allow_inf_nan=False)
        patience: int = Field(default=8, ge=1)
        planned: int = Field(default=24, ge=1)
        fallback: Power.Settings = Power.Settings(sigma=6, weights="sharpened", decay=0.97)

    settings: Settings
    needs_error_model = True
    _model: ErrorModel

    def __init__(
        self,
        size: int,
        settings: Settings,
        rng: np.random.Generator,
        model: ErrorModel | None = None,
    ) -> None:
        """Start at z = 0; see `LearnerClass`."""
        super().__init__(size, settings, rng, model)
        self._power = Power(size, settings.fallback, rng)
        self._known: dict[bytes, Prediction | None] = {}  # by coordinates
        self._measured: list[tuple[np.ndarray, np.ndarray]] = []  # coordinates and errors
        self._latest: tuple[np.ndarray, np.ndarray] | None = None  # of the rollout told next
        self._faults = 0  # rollouts without a measured error and with return 0
        directions = self._model.directions
        others = np.linalg.svd(directions)[2][len(directions) :]  # an orthonormal basis
        self._axes = np.vstack([directions, REST * others])  # of the search, (size, size)
        self._inverse = np.linalg.inv(self._axes)
        self._plan: np.ndarray | None = None
        self._searched = False  # for a plan since the last rollout
        self._rated = False  # a rollout, by a person
        self._draws = 0  # since the last rollout

    @property
    def falls_back(self) -> bool:
        """Whether PoWER decides."""
        return self._planned() is None

    @property
    def weight(self) -> float:
        """Probability of the model's prediction, against that of the rough slopes."""
        return self._discrepancy().weight

    @property
    def mean(self) -> np.ndarray:
        """The plan, or the mean of PoWER. Shape (size,)."""
        plan = self._planned()
        return self._power.mean if plan is None else plan.copy()

    def ask(self) -> np.ndarray:
        """The plan, or a draw of PoWER. Shape (size,).

        A plan that is asked for again has been rejected: each time it is moved nearer to the best
        rollout, and PoWER draws instead where that is no new plan.
        """
        plan = self._planned()
        if plan is None:
            return self._power.ask()
        self._draws += 1
        if self._draws == 1 or not self._measured:
            return plan.copy()
        best = self._measured[int(np.argmin(self._losses()))][0]
        moved = best + 0.8 ** (self._draws - 1) * (plan - best)
        return self._power.ask() if self._was_run(moved) else moved

    def measure(self, z: np.ndarray, error: np.ndarray) -> None:
        """See `MeasuringLearner`."""
        self._latest = np.array(z, dtype=float), np.array(error, dtype=float)

    def trust_returns(self) -> None:
        """See `MeasuringLearner`: PoWER decides."""
        self._searched, self._plan, self._rated = True, None, True

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn from a rollout; see `Learner.tell`."""
        self._power.tell(z, ret)
        if self._latest is None and ret == 0.0:  # a fault ended it: there is no error
            self._faults += 1
            self._latest = np.array(z, dtype=float), np.full(len(self._model.slopes), math.nan)
        if self._latest is not None:
            self._measured.append(self._latest)
        self._latest, self._plan, self._searched, self._draws = None, None, self._rated, 0

    def _update(self) -> None:
        """Nothing: `tell` is this learner's own."""

    def _losses(self) -> np.ndarray:
        """Squared errors of the measured rollouts. Shape (n,)."""
        errors = np.stack([error for _, error in self._measured])
        return (np.where(np.isnan(errors), UNKNOWN, errors) ** 2).sum(axis=1)

    def _complete(self) -> list[bool]:
        """Whether every component of the measured errors has a value, oldest first."""
        return [bool(np.isfinite(error).all()) for _, error in self._measured]

    def _stuck(self) -> bool:
        """Whether the latest plans have not come closer than an earlier one."""
        losses = self._losses()
        if len(losses) >= (self.settings.planned if any(self._complete()) else BLIND):
            return True
        last = losses[-self.settings.patience :]
        before = losses[: -self.settings.patience]
        if not len(before):
            return False
        return bool(last.min() > max(FINE**2, PROGRESS * before.min()))

    def _planned(self) -> np.ndarray | None:
        """Coordinates of the next rollout, computed once for each; None if PoWER decides."""
        if not self._searched:
            self._searched = True
            self._plan = None if self._measured and self._stuck() else self._search()
        return self._plan

    def _predicted(self, z: np.ndarray) -> Prediction | None:
        """What the model predicts at z."""
        key = z.tobytes()
        if key not in self._known:
            predict = self._model.predict
            self._known[key] = None if predict is None else predict(z)
        return self._known[key]

    def _along(self, z: np.ndarray) -> np.ndarray:
        """Coordinates of z (..., size) along the axes of the search. Shape (..., size)."""
        return z @ self._inverse

    def _rough(self, z: np.ndarray) -> np.ndarray:
        """Error by the rough slopes alone, 0 at the start. Shape (..., m)."""
        return self._along(z)[..., : len(self._model.directions)] @ self._model.slopes.T

    def _discrepancy(self) -> Discrepancy:
        m = len(self._model.slopes)
        z = np.array([z for z, _ in self._measured]).reshape(-1, self.size)
        errors = np.array([e for _, e in self._measured]).reshape(-1, m)
        predictions = [self._predicted(each) for each in z]
        return Discrepancy(z, errors, predictions, self._rough(z), self.settings.length)

    def _search(self) -> np.ndarray | None:
        """Gauss-Newton steps from the best known coordinates to a small expected error."""
        discrepancy = self._discrepancy()
        trusted = self._model.predict is not None and discrepancy.weight >= IGNORED
        starts = [np.zeros(self.size), *(z for z, _ in self._measured)]
        if trusted:
            starts += [np.frombuffer(key) for key in self._known]
        points = {z.tobytes(): self._point(z, discrepancy, trusted) for z in starts}
        failed = 0
        for _ in range(self.settings.simulations):
            known = list(points.values())
            best = _best(known)
            if best.loss < GOOD**2:
                break
            inside = _best([point for point in known if point.feasible] or known)
            probe = self._probe(best, known, failed > 1) if trusted else None
            if probe is not None:
                z = best.z + probe @ self._axes
            elif failed and inside is not best:
                z = 0.5 * (inside.z + best.z)  # where limits bend, slopes lead astray
            else:
                z = best.z + 0.5**failed * self._step(best, known) @ self._axes
            if z.tobytes() in points:
                break
            points[z.tobytes()] = point = self._point(z, discrepancy, trusted)
            failed = failed + 1 if probe is None and point.loss >= best.loss else 0
        feasible = [point for point in points.values() if point.feasible]
        if not feasible:
            return None
        plan, complete = _best(feasible), self._complete()
        if not any(complete):
            foreseen = np.isfinite(plan.values[: len(self._model.slopes)]).all()
            return plan.z if foreseen else None
        closest = int(np.argmin(np.where(complete, self._losses(), math.inf)))
        origin = self._measured[closest][0]
        z = origin + 0.5 ** complete[closest:].count(False) * (plan.z - origin)
        return None if self._was_run(z) else z

    def _was_run(self, z: np.ndarray) -> bool:
        """Whether z is no new plan, and its rollouts are not within the tolerances."""
        near = [
            loss
            for (at, _), loss in zip(self._measured, self._losses(), strict=True)
            if float(np.linalg.norm(self._along(at - z))) < SAME
        ]
        return bool(near) and float(np.mean(near)) > FINE**2

    def _point(self, z: np.ndarray, discrepancy: Discrepancy, trusted: bool) -> _Point:
        rough, excess = self._rough(z), np.empty(0)
        predicted = self._predicted(z) if trusted else None
        if trusted and predicted is None:
            return _Point(z, np.full(len(rough), math.nan), False, math.inf)
        error, variance = discrepancy.expected(z, predicted, rough)
        if predicted is not None:
            excess = predicted.excess
        excess = excess + EXCESS * self._faults  # the arm exceeds a limit that its model keeps
        over = np.maximum(excess + SLACK, 0.0) / EXCESS
        filled = np.where(np.isnan(error), UNKNOWN, error)
        loss = float((filled**2 + CAUTION * variance).sum() + (over**2).sum())
        if any((z == at).all() and np.isnan(seen).any() for at, seen in self._measured):
            loss = math.inf  # whatever is expected there, it has no complete error
        return _Point(z, np.append(error, excess), bool((excess < 0.0).all()), loss)

    def _probe(self, best: _Point, points: list[_Point], beyond: bool) -> np.ndarray | None:
        """Step along a direction in which the changes near a point are unknown, if there is one.

        Args:
            best: The point.
            points: All points.
            beyond: Whether to leave the model's directions once they are known.
        """
        if not np.isfinite(best.values).all():
            return None
        moved = self._along(np.stack([point.z - best.z for point in points]))
        near = moved[np.sqrt((moved**2).sum(axis=1)) <= 2.0 * NEAR]
        known = near.T @ near
        designed = len(self._model.directions)
        for unit in np.eye(self.size)[:designed]:
            if unit @ known @ unit < 0.5 * PROBE**2:
                return PROBE * unit
        if not beyond or np.linalg.matrix_rank(near, tol=0.1 * PROBE) >= self.size:
            return None
        # Not from the session's generator, which only `ask` may draw from: a plan is a function of
        # the rollouts.
        probes = np.random.Generator(np.random.PCG64(len(self._known)))
        drawn = probes.standard_normal(self.size)
        drawn[:designed] = 0.0
        return 2.0 * PROBE * drawn / np.linalg.norm(drawn)

    def _step(self, best: _Point, points: list[_Point]) -> np.ndarray:
        """Damped Gauss-Newton step along the axes of the search. Shape (size,)."""
        m = len(self._model.slopes)
        alike = [point for point in points if len(point.values) == len(best.values)]
        moved = self._along(np.stack([point.z - best.z for point in alike]))  # (k, size)
        changed = np.stack([point.values - best.values for point in alike])  # (k, m + c)
        weights = np.exp(-0.5 * (moved**2).sum(axis=1) / NEAR**2)
        slopes = np.zeros((len(best.values), moved.shape[1]))
        slopes[:m, : len(self._model.directions)] = self._model.slopes
        for row in np.flatnonzero(np.isfinite(best.values)):
            # Ridge regression of the changes, towards the rough slopes.
            valid = np.isfinite(changed[:, row])
            x, y, w = moved[valid], changed[valid, row], weights[valid][:, np.newaxis]
            a = (w * x).T @ x + SLOPE_SD**2 * np.eye(x.shape[1])
            slopes[row] += np.linalg.solve(a, (w * x).T @ (y - x @ slopes[row]))
        rows = np.flatnonzero(np.isfinite(best.values[:m]))
        step = np.zeros(moved.shape[1])
        if not len(rows):
            return step
        limits, excess = slopes[m:] / EXCESS, (best.values[m:] + SLACK) / EXCESS
        for _ in range(ACTIVE_SETS):
            over = excess + limits @ step > 0.0
            j = np.vstack([slopes[rows], limits[over]])
            e = np.append(best.values[rows], excess[over])
            step = -j.T @ np.linalg.solve(j @ j.T + np.eye(len(e)), e)
        return step * min(1.0, STEP_MAX / max(float(np.abs(step).max()), 1e-12))
