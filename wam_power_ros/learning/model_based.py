# SPDX-License-Identifier: Apache-2.0
"""Planning on the vector error of rollouts: what is foreseen of it, and what rollouts show.

Not in the paper. The return of a rollout is one number; its error is a vector of which is known
roughly how it changes. As in [Cully2015], a Gaussian process models what rollouts differ from what
was foreseen. See `ModelBased`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import ErrorModel, GaussianLearner, LearnerSettings, Prediction
from wam_power_ros.learning.power import Power

UNKNOWN_ERROR = 8.0  # [tolerances] assumed of an error without a value
MODEL_ERROR = 4.0  # [tolerances] standard deviation of an error from what is foreseen
ROLLOUT_NOISE = 0.5  # [tolerances] standard deviation of an error over rollouts of one policy
EXCESS_UNIT = 0.02  # [share of a limit] beyond it that weighs as much as an error of a tolerance
OTHER_STEP = 5.0  # [sd of the exploration] step along a direction that is none of the model's
PROBE_STEP = 0.15  # [steps] by which coordinates differ that tell slopes


class _Point(NamedTuple):
    """Coordinates that may be a plan.

    `values` has the expected error, NaN where unknown, and the predicted excess; `loss` is the sum
    of the squares of the errors and of what exceeds a limit.
    """

    z: np.ndarray  # (size,)
    values: np.ndarray  # (m + c,) [tolerances] and [share]
    feasible: bool  # whether no limit is exceeded, as far as it is predicted
    loss: float  # [tolerances^2]


class ModelBased(GaussianLearner):
    """Planning on the vector error. Not in the paper.

    Foreseen of a rollout is what the model predicts, or its rough slopes where it predicts nothing.
    Rollouts correct that by a constant, by what changes slowly, and by the numbers that a
    prediction only assumes. A part of an error that is unknown teaches nothing, the others do.

    A plan is found by Gauss-Newton steps on the expected error, within the limits, whose slopes are
    a regression of the points near by: along the model's few directions first, then along random
    ones among all coordinates. It is executed without exploration. Between the best rollout and one
    of which less was known, as a throw that did not come off or that a fault ended, is an edge: a
    plan is nearer to the former.

    PoWER learns from the same rollouts, as told. It decides when a part of the error was never
    measured and is not foreseen; when no better plan is found than one that was run and is not
    within the tolerances; after `patience` rollouts without progress; after `planned` rollouts: the
    error may leave out something that matters; and once a person has rated a rollout.

    What was predicted for a plan is known to later ones: the state is a function of the rollouts
    and of the draws between them, as in a session that is replayed.
    """

    class Settings(LearnerSettings):
        """Settings of model-based learning."""

        simulations: int = Field(default=40, ge=1)  # largest number of predictions for a plan
        # Distance over which what is not foreseen changes [sd of the exploration]
        length: float = Field(default=10.0, gt=0.0, allow_inf_nan=False)
        patience: int = Field(default=8, ge=1)  # rollouts without progress until PoWER decides
        # Rollouts after which it decides in any case: small errors alone have not sufficed
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
        self._known: dict[bytes, Prediction | None] = {}  # predictions by coordinates
        self._m, self._d = self._model.slopes.shape
        self._z, self._errors = np.empty((0, size)), np.empty((0, self._m))
        self._latest: np.ndarray | None = None  # error of the rollout told next
        self._faults = 0  # rollouts without a measured error and with return 0
        others = np.linalg.svd(self._model.directions)[2][self._d :]  # an orthonormal basis
        self._axes = np.vstack([self._model.directions, OTHER_STEP * others])  # (size, size)
        self._inverse = np.linalg.inv(self._axes)
        self._plan: np.ndarray | None = None
        self._searched = self._rated = False  # for a plan since the last rollout; by a person
        self._draws = 0  # since the last rollout

    @property
    def falls_back(self) -> bool:
        """Whether PoWER decides."""
        return self._planned() is None

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
        if self._draws == 1 or not len(self._z):
            return plan.copy()
        best = self._z[np.argmin(_squares(self._errors))]
        moved = best + 0.8 ** (self._draws - 1) * (plan - best)
        return self._power.ask() if self._was_run(moved) else moved

    def measure(self, z: np.ndarray, error: np.ndarray) -> None:
        """See `MeasuringLearner`."""
        self._latest = np.append(z, error)

    def trust_returns(self) -> None:
        """See `MeasuringLearner`: PoWER decides."""
        self._searched, self._plan, self._rated = True, None, True

    def tell(self, z: np.ndarray, ret: float) -> None:
        """Learn from a rollout; see `Learner.tell`."""
        self._power.tell(z, ret)
        if self._latest is None and ret == 0.0:  # a fault ended it: there is no error
            self._faults += 1
            self.measure(z, np.full(self._m, math.nan))
        if self._latest is not None:
            self._z = np.vstack([self._z, self._latest[: self.size]])
            self._errors = np.vstack([self._errors, self._latest[self.size :]])
        self._latest, self._plan, self._searched, self._draws = None, None, self._rated, 0

    def _update(self) -> None:
        """Nothing: `tell` is this learner's own."""

    def _planned(self) -> np.ndarray | None:
        """Coordinates of the next rollout, computed once for each; None if PoWER decides."""
        if not self._searched:
            losses, patience, self._searched = _squares(self._errors), self.settings.patience, True
            before, last = losses[:-patience], losses[-patience:]
            stuck = len(before) and last.min() > 0.8 * before.min()
            stuck = stuck and not _within(self._errors[-patience:]).any()
            self._plan = None if stuck or len(losses) >= self.settings.planned else self._search()
        return self._plan

    def _was_run(self, z: np.ndarray) -> bool:
        """Whether z is no new plan, and its rollouts are not within the tolerances."""
        near = np.linalg.norm((self._z - z) @ self._inverse, axis=1) < PROBE_STEP
        return bool(near.any() and _within(self._errors[near]).mean() < 0.5)

    def _foreseen(self, z: np.ndarray) -> Prediction | None:
        """What the model predicts, or its rough slopes; None if z cannot be executed."""
        if self._model.predict is None:
            return Prediction(self._model.slopes @ (z @ self._inverse)[: self._d], np.empty(0))
        if z.tobytes() not in self._known:
            self._known[z.tobytes()] = self._model.predict(z)
        return self._known[z.tobytes()]

    def _expected(self) -> Callable[[np.ndarray], _Point]:
        """Function of coordinates (size,): what is foreseen, corrected by the rollouts."""
        rollouts = zip(self._z, self._errors, strict=True)
        known = [(z, e, p) for z, e in rollouts if (p := self._foreseen(z)) is not None]
        n, m = len(known), self._m
        at = np.array([z for z, _, _ in known]).reshape(n, self.size)
        rest = np.array([e - p.error for _, e, p in known]).reshape(n, m)
        noise = ROLLOUT_NOISE**2 * np.eye(n)

        def covariance(z: np.ndarray, uncertain: np.ndarray) -> np.ndarray:
            """Covariance of the errors at z with those of the rollouts. Shape (m, n)."""
            square = ((at - z) ** 2).sum(axis=1) / self.settings.length**2
            slow = MODEL_ERROR**2 * (1.0 + 0.25 * np.exp(-0.5 * square))
            assumed = [np.zeros(m) + (p.uncertain * uncertain).sum(axis=1) for _, _, p in known]
            return slow + np.array(assumed).reshape(n, m).T

        among = np.array([covariance(z, p.uncertain) for z, _, p in known]).reshape(n, m, n)
        weights = np.zeros((m, n))
        for k, told in enumerate(np.isfinite(rest).T):
            a = (among[:, k] + noise)[np.ix_(told, told)]
            weights[k, told] = np.linalg.solve(a, rest[told, k])

        def expected(z: np.ndarray) -> _Point:
            if (p := self._foreseen(z)) is None:
                return _Point(z, np.full(m, math.nan), False, math.inf)
            error = p.error + (covariance(z, p.uncertain) * weights).sum(axis=1)
            excess = p.excess + EXCESS_UNIT * self._faults  # an arm exceeds what its model keeps
            over = np.maximum(excess / EXCESS_UNIT + 0.5, 0.0)
            loss = float(_squares(error[np.newaxis])[0] + (over**2).sum())
            return _Point(z, np.append(error, excess), bool((excess < 0.0).all()), loss)

        return expected

    def _search(self) -> np.ndarray | None:
        """Gauss-Newton steps from the best known coordinates to a small expected error."""
        expected, failed = self._expected(), 0
        starts = [np.zeros(self.size), *self._z, *map(np.frombuffer, self._known)]
        points = {z.tobytes(): expected(z) for z in starts}
        for _ in range(self.settings.simulations):
            known = list(points.values())
            best = _best(known)
            if best.loss < ROLLOUT_NOISE**2:
                break
            inside = _best([point for point in known if point.feasible] or known)
            step = probe = self._probe(best, known, failed > 1)
            if probe is None and failed and inside is not best:
                step = 0.5 * (inside.z - best.z) @ self._inverse  # limits bend: slopes lead astray
            elif probe is None:
                step = 0.5**failed * self._step(best, known)
            z = best.z + step @ self._axes
            if z.tobytes() in points:
                break
            points[z.tobytes()] = found = expected(z)
            failed = failed + 1 if probe is None and found.loss >= best.loss else 0
        feasible = [point for point in points.values() if point.feasible]
        unknown = np.isnan(self._errors).sum(axis=1)
        if not feasible or (unknown.all() and np.isnan(_best(feasible).values).any()):
            return None
        z = _best(feasible).z
        if len(unknown):
            closest = int(np.argmin(_squares(self._errors)))
            origin, lost = self._z[closest], self._z[unknown > unknown[closest]]
            while (np.linalg.norm(lost - z, axis=1) < np.linalg.norm(origin - z)).any():
                z = 0.5 * (origin + z)
        return None if self._was_run(z) else z

    def _probe(self, best: _Point, points: list[_Point], beyond: bool) -> np.ndarray | None:
        """Step in which the changes near the best point are unknown; `beyond` all known ones."""
        if self._model.predict is None or not np.isfinite(best.values).all():
            return None
        moved = np.stack([point.z - best.z for point in points]) @ self._inverse
        near = moved[np.linalg.norm(moved, axis=1) <= 2.0]
        for unit in np.eye(self.size)[: self._d]:
            if ((near @ unit) ** 2).sum() < 0.5 * PROBE_STEP**2:
                return PROBE_STEP * unit
        if not beyond or np.linalg.matrix_rank(near, tol=0.1 * PROBE_STEP) >= self.size:
            return None
        # Not from the session's generator, which only `ask` may draw from: a plan is a function of
        # the rollouts.
        drawn = np.random.Generator(np.random.PCG64(len(self._known))).standard_normal(self.size)
        drawn[: self._d] = 0.0
        return 2.0 * PROBE_STEP * drawn / np.linalg.norm(drawn)

    def _step(self, best: _Point, points: list[_Point]) -> np.ndarray:
        """Damped Gauss-Newton step along the axes of the search. Shape (size,)."""
        m, d = self._m, self._d
        alike = [point for point in points if len(point.values) == len(best.values)]
        moved = np.stack([point.z - best.z for point in alike]) @ self._inverse  # (k, size)
        changed = np.stack([point.values - best.values for point in alike])  # (k, m + c)
        near = np.exp(-0.5 * (moved**2).sum(axis=1, keepdims=True))
        slopes = np.zeros((len(best.values), self.size))
        slopes[:m, :d] = self._model.slopes
        for row in np.flatnonzero(np.isfinite(best.values)):
            # Ridge regression of the changes, towards the rough slopes.
            known = np.isfinite(changed[:, row])
            x, y = moved[known], changed[known, row]
            a = (near[known] * x).T @ x + 0.01 * np.eye(self.size)
            slopes[row] += np.linalg.solve(a, (near[known] * x).T @ (y - x @ slopes[row]))
        rows = np.flatnonzero(np.isfinite(best.values[:m]))
        step: np.ndarray = np.zeros(self.size)
        limits, excess = slopes[m:] / EXCESS_UNIT, best.values[m:] / EXCESS_UNIT + 0.5
        for _ in range(8):  # rounds in which it finds the limits that it would exceed
            over = excess + limits @ step > 0.0
            j, e = np.vstack([slopes[rows], limits[over]]), [*best.values[rows], *excess[over]]
            step = -j.T @ np.linalg.solve(j @ j.T + np.eye(len(e)), e)
        return step / max(1.0, float(np.abs(step).max()))


def _best(points: Sequence[_Point]) -> _Point:
    return min(points, key=lambda point: point.loss)


def _squares(errors: np.ndarray) -> np.ndarray:
    """Squared errors of rollouts (n, m), where unknown parts are large. Shape (n,)."""
    return (np.where(np.isnan(errors), UNKNOWN_ERROR, errors) ** 2).sum(axis=1)


def _within(errors: np.ndarray) -> np.ndarray:
    """Which errors (n, m) are known and within the tolerances. Shape (n,)."""
    return (np.abs(errors) <= 1.0).all(axis=1)
