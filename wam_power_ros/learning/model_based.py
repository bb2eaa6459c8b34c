# SPDX-License-Identifier: Apache-2.0
"""Planning on the vector error of rollouts: what is predicted of it, and what rollouts show.

Not in the paper. The return of a rollout is one number; its error is a vector of which is known
roughly how it changes. As in [Cully2015], a Gaussian process models what rollouts differ from what
was predicted. See `ModelBased`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from pydantic import Field

from wam_power_ros.learning.learner import ErrorModel, GaussianLearner, LearnerSettings, Prediction
from wam_power_ros.learning.power import Power

UNKNOWN_ERROR = 8.0  # [tolerances] assumed of an error without a value
MODEL_ERROR = 4.0  # [tolerances] standard deviation of an error from what is predicted
ROLLOUT_NOISE = 0.5  # [tolerances] standard deviation of an error over rollouts of one policy
EXCESS_UNIT = 0.02  # [share of a limit] beyond it that weighs as much as an error of a tolerance
OTHER_STEP = 5.0  # [sd of the exploration] step along a direction that is none of the model's
PROBE_STEP = 0.15  # [steps] by which coordinates differ that tell slopes, and are not the same
RADIUS_MIN = 0.5 * PROBE_STEP  # [steps] of a step that is given up
DESCENT = 120  # predictions for steps from one point
MODE_STEP = 2.0  # [sd of the exploration] along a mode
EVOLUTION_SD = 0.25  # [steps] with which evolution starts
POPULATION = 10  # of evolution
LOST = 1e4  # [tolerances^2] loss of what cannot be executed, for evolution


class _Point(NamedTuple):
    """Coordinates that may be a plan.

    `residuals` has the expected error, NaN where unknown, then how far it may be off because a
    prediction assumes numbers; `loss` is the sum of the squares of these and of what exceeds a
    limit.
    """

    z: np.ndarray  # (size,)
    residuals: np.ndarray  # (m + m j,) [tolerances]
    limit_excess: np.ndarray  # predicted share by which each limit is exceeded, (c,)
    loss: float  # [tolerances^2]

    @property
    def feasible(self) -> bool:
        """Whether no limit is exceeded, as far as it is predicted."""
        return math.isfinite(self.loss) and bool((self.limit_excess < 0.0).all())

    @property
    def values(self) -> np.ndarray:
        """All that changes with the coordinates. Shape (m + m j + c,)."""
        return np.append(self.residuals, self.limit_excess)


_Points = dict[bytes, _Point]  # by coordinates
_Expected = Callable[[np.ndarray], _Point]


class ModelBased(GaussianLearner):
    """Planning on the vector error. Not in the paper.

    Predicted is what the model tells of a rollout, or its rough slopes where it tells nothing.
    Rollouts correct that by a constant, by what changes slowly, and by the numbers that a
    prediction only assumes. A part of an error that is unknown teaches nothing, the others do.

    A plan has a small expected error, within the limits. What the assumed numbers may change counts
    as an error: near an edge, as of a throw that hardly comes off, that is much. Predictions cost
    nothing but time, so it is searched for by steps, and where these do not suffice by evolution of
    the whole movement (see `_search`). It is executed without exploration. Between the best rollout
    and one of which less was known, as one that a fault ended, is an edge, too: a plan is nearer to
    the former.

    PoWER learns from the same rollouts, as told. It decides when a part of the error was never
    measured and is not predicted; when no better plan is found than one that was run and is not
    within the tolerances; after `patience` rollouts without progress; after `planned` rollouts: the
    error may leave out something that matters; and once a person has rated a rollout.

    What was predicted for a plan is known to later ones: the state is a function of the rollouts
    and of the draws between them, as in a session that is replayed.
    """

    class Settings(LearnerSettings):
        """Settings of model-based learning."""

        simulations: int = Field(default=540, ge=1)  # largest number of predictions for a plan
        # Distance over which what is not predicted changes [sd of the exploration]
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
        self._whole = np.vstack([self._model.directions, MODE_STEP * self._model.modes])
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
            stuck = stuck or len(losses) >= self.settings.planned
            self._plan = None if stuck else self._new_plan(self._search())
        return self._plan

    def _was_run(self, z: np.ndarray) -> bool:
        """Whether z is no new plan, and its rollouts are not within the tolerances."""
        near = self._apart(z) < PROBE_STEP
        return bool(near.any() and _within(self._errors[near]).mean() < 0.5)

    def _apart(self, z: np.ndarray) -> np.ndarray:
        """Distance of each rollout from z along the axes of the search [steps]. Shape (n,)."""
        distances: np.ndarray = np.linalg.norm((self._z - z) @ self._inverse, axis=1)
        return distances

    def _predicted(self, z: np.ndarray) -> Prediction | None:
        """What the model predicts, or its rough slopes; None if z cannot be executed."""
        if self._model.predict is None:
            return Prediction(self._model.slopes @ (z @ self._inverse)[: self._d], np.empty(0))
        if z.tobytes() not in self._known:
            self._known[z.tobytes()] = self._model.predict(z)
        return self._known[z.tobytes()]

    def _expected(self) -> _Expected:
        """Function of coordinates (size,): what is predicted, corrected by the rollouts."""
        rollouts = zip(self._z, self._errors, strict=True)
        known = [(z, e, p) for z, e in rollouts if (p := self._predicted(z)) is not None]
        n, m = len(known), self._m
        at = np.array([z for z, _, _ in known]).reshape(n, self.size)
        rest: np.ndarray = np.array([e - p.error for _, e, p in known]).reshape(n, m)
        noise = ROLLOUT_NOISE**2 * np.eye(n)

        def covariance(z: np.ndarray, uncertain: np.ndarray) -> np.ndarray:
            """Covariance of the errors at z with those of the rollouts. Shape (m, n)."""
            square = ((at - z) ** 2).sum(axis=1) / self.settings.length**2
            slow = MODEL_ERROR**2 * (1.0 + 0.25 * np.exp(-0.5 * square))
            assumed = [np.zeros(m) + (p.uncertain * uncertain).sum(axis=1) for _, _, p in known]
            return slow + np.array(assumed).reshape(n, m).T

        among = np.array([covariance(z, p.uncertain) for z, _, p in known]).reshape(n, m, n)
        inverse = np.zeros((m, n, n))
        for k, told in enumerate(np.isfinite(rest).T):
            both = np.ix_(told, told)
            inverse[k][both] = np.linalg.inv((among[:, k] + noise)[both])
        rest = np.nan_to_num(rest)

        def expected(z: np.ndarray) -> _Point:
            # Near a rollout it is that of the rollout: what a model sees between them is not real.
            apart = self._apart(z)
            near = self._z[apart.argmin()] if apart.min(initial=math.inf) < PROBE_STEP else z
            if (p := self._predicted(near)) is None:
                return _Point(z, np.full(m, math.nan), np.empty(0), math.inf)
            weights = np.einsum("kn,kni->ki", covariance(near, p.uncertain), inverse)
            error = p.error + (weights * rest.T).sum(axis=1)
            assumed = np.reshape([q.uncertain for _, _, q in known], (n, *p.uncertain.shape))
            spread = p.uncertain - np.einsum("ki,ikj->kj", weights, assumed)
            excess = p.limit_excess + EXCESS_UNIT * self._faults  # its model keeps more than it
            over = np.maximum(excess / EXCESS_UNIT + 0.5, 0.0)
            loss = _squares(error[np.newaxis])[0] + (spread**2).sum() + (over**2).sum()
            return _Point(z, np.append(error, spread), excess, float(loss))

        return expected

    def _search(self) -> _Points:
        """Points on the way to a small expected error, from the best known, by coordinates.

        Steps first. A landscape with edges has more than one valley: where they end in one that is
        not good enough, CMA-ES [Hansen2016] moves directions and modes together, and steps go on.
        """
        expected = self._expected()
        starts = [np.zeros(self.size), *self._z, *map(np.frombuffer, self._known)]
        points = {z.tobytes(): expected(z) for z in starts}
        most = len(points) + self.settings.simulations
        self._descend(points, expected, min(most, len(points) + DESCENT))
        best = min(points.values(), key=lambda point: point.loss)
        if not (best.feasible and best.loss < self._m) and self._model.predict is not None:
            self._evolve(best, points, expected, most - DESCENT)
            self._descend(points, expected, most)
        return points

    def _descend(self, points: _Points, expected: _Expected, most: int) -> None:
        """Gauss-Newton steps from the best of the points, until there may be so many.

        They are shorter after each that is no better: along the model's directions, then among all
        coordinates.
        """
        radius, among_all = 1.0, False
        for _ in range(most - len(points)):
            known = list(points.values())
            best = min(known, key=lambda point: point.loss)
            if radius < RADIUS_MIN:
                if among_all:
                    return
                radius, among_all = 1.0, True
            if best.loss < ROLLOUT_NOISE**2 and best.feasible:
                return
            probe = self._probe(best, known, among_all)
            step = self._step(best, known, radius) if probe is None else probe
            z = best.z + step @ self._axes
            points[z.tobytes()] = found = expected(z)
            if found.loss < best.loss:
                radius = min(2.0 * radius, 1.0)
            elif probe is None:
                radius *= 0.5

    def _evolve(self, best: _Point, points: _Points, expected: _Expected, most: int) -> None:
        """Generations of points around the best, until there may be so many."""
        from cmaes import CMA  # imports SciPy: slow

        # Not the session's generator, which only `ask` may draw from: a plan is a function of the
        # rollouts.
        options = {"population_size": POPULATION, "seed": len(points)}
        search = CMA(mean=np.zeros(len(self._whole)), sigma=EVOLUTION_SD, **options)
        for _ in range((most - len(points)) // POPULATION):
            moves = [search.ask() for _ in range(POPULATION)]
            found = [expected(best.z + move @ self._whole) for move in moves]
            points |= {point.z.tobytes(): point for point in found}
            losses = [min(point.loss, LOST) for point in found]
            search.tell([*zip(moves, losses, strict=True)])

    def _new_plan(self, points: _Points) -> np.ndarray | None:
        """The best of the points that is a new plan and no worse than the best rollout, or None."""
        ascending = sorted(points.values(), key=lambda point: point.loss)
        new = next((p for p in ascending if p.feasible and not self._was_run(p.z)), None)
        unknown = np.isnan(self._errors).sum(axis=1)
        if new is None or (unknown.all() and np.isnan(new.residuals).any()):
            return None
        if not len(self._z):
            return new.z
        closest = int(np.argmin(_squares(self._errors)))
        origin, lost = self._z[closest], self._z[unknown > unknown[closest]]
        if new.loss > points[origin.tobytes()].loss:
            return None
        z = new.z
        while (np.linalg.norm(lost - z, axis=1) < np.linalg.norm(origin - z)).any():
            z = 0.5 * (origin + z)
        return None if self._was_run(z) else z

    def _probe(self, best: _Point, points: list[_Point], among_all: bool) -> np.ndarray | None:
        """Step in which the changes near the best point are unknown, `among_all` or the model's."""
        if self._model.predict is None or not np.isfinite(best.values).all():
            return None
        moved = np.stack([point.z - best.z for point in points]) @ self._inverse
        near = moved[np.linalg.norm(moved, axis=1) <= 2.0]
        for unit in np.eye(self.size)[: None if among_all else self._d]:
            if ((near @ unit) ** 2).sum() < 0.5 * PROBE_STEP**2:
                return PROBE_STEP * unit
        return None

    def _step(self, best: _Point, points: list[_Point], radius: float) -> np.ndarray:
        """Damped Gauss-Newton step along the axes of the search. Shape (size,)."""
        m, d, r = self._m, self._d, len(best.residuals)
        alike = [point for point in points if len(point.values) == len(best.values)]
        moved = np.stack([point.z - best.z for point in alike]) @ self._inverse  # (k, size)
        changed = np.stack([point.values - best.values for point in alike])  # (k, m + c)
        width = max(radius, 2.0 * PROBE_STEP)
        near = np.exp(-0.5 * (moved**2).sum(axis=1, keepdims=True) / width**2)
        slopes = np.zeros((len(best.values), self.size))
        slopes[:m, :d] = self._model.slopes
        for row in np.flatnonzero(np.isfinite(best.values)):
            # Ridge regression of the changes, towards the rough slopes.
            known = np.isfinite(changed[:, row])
            x, y = moved[known], changed[known, row]
            a = (near[known] * x).T @ x + 0.01 * np.eye(self.size)
            slopes[row] += np.linalg.solve(a, (near[known] * x).T @ (y - x @ slopes[row]))
        rows = np.flatnonzero(np.isfinite(best.residuals))
        step: np.ndarray = np.zeros(self.size)
        limits, excess = slopes[r:] / EXCESS_UNIT, best.limit_excess / EXCESS_UNIT + 0.5
        for _ in range(8):  # rounds in which it finds the limits that it would exceed
            over = excess + limits @ step > 0.0
            j, e = np.vstack([slopes[rows], limits[over]]), [*best.values[rows], *excess[over]]
            step = -j.T @ np.linalg.solve(j @ j.T + np.eye(len(e)), e)
        return step * (radius / max(radius, float(np.linalg.norm(step))))


def _squares(errors: np.ndarray) -> np.ndarray:
    """Squared errors of rollouts (n, m), where unknown parts are large. Shape (n,)."""
    return (np.where(np.isnan(errors), UNKNOWN_ERROR, errors) ** 2).sum(axis=1)


def _within(errors: np.ndarray) -> np.ndarray:
    """Which errors (n, m) are known and within the tolerances. Shape (n,)."""
    return (np.abs(errors) <= 1.0).all(axis=1)
