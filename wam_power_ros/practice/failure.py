# SPDX-License-Identifier: Apache-2.0
"""Why a session has failed: the first of some causes that its records show, with its numbers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from wam_power_ros import installed
from wam_power_ros.faults import FaultKind
from wam_power_ros.learning import dmp
from wam_power_ros.learning.learner import needs_errors
from wam_power_ros.learning.policy import Policy
from wam_power_ros.practice.session_log import Record
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.tasks.task import Task

# Share of a shift of the last third of the attractors that the end of a path must follow. Those of
# a flip do by 0.98; with a quarter of the stiffness by 0.47, with an eighth of it by 0.27.
FOLLOWED_MIN = 1 / 3
UNUSABLE_MIN = 1 / 3  # share of the rollouts that must show what they could not be judged for
FAULTS_MIN = 1 / 4  # share of them that faults must have ended
ROLLOUTS_MIN = 12  # with all errors known, to tell what moves them
CLEAR = 4.0  # standard deviations of a trend that is no chance
DRIFT_MIN = 2.0  # smallest trend over the session that matters [tolerances]
MOVED_MIN = 0.5  # standard deviation of the change that the task expects, to compare [tolerances]
IGNORED_MAX = 0.2  # largest share of it that is as good as none
GROUP_MIN = 3  # successes and others that are needed to compare their returns
STEP = 0.002  # [s] of the path of Eq. 1
AGREED_MIN = 0.6  # smallest probability that a success has a higher return than another rollout


class Cause(Enum):
    """Cause of a failure; what its numbers mean is beside it."""

    CLOCKS = "clocks"  # size: how late the cameras' stamps are [s]
    UNSEEN = "unseen"  # detail: why the last of the rollouts could not be judged
    PLANE = "plane"  # of the keep-out
    LIMITS = "limits"  # detail: kind of the fault
    TORQUE = "torque"  # that no command explains
    FAULTS = "faults"  # that no policy causes; the same
    SOFT = "soft"  # size: share of a shift of the last attractors that the end of the path follows
    UNMEASURED = "unmeasured"  # detail: error that has no value
    DRIFT = "drift"  # detail: error; size: its change over the session [tolerances]
    IGNORED = "ignored"  # detail: error; size: its change, as a share of the task's model
    DISAGREE = "disagree"  # size: probability that a success has a higher return
    FELL_BACK = "fell back"  # rollouts that PoWER chose, because no plan was better
    UNKNOWN = "unknown"  # none of these


_NAMED = {FaultKind.PLANE: Cause.PLANE, FaultKind.EXTERNAL_TORQUE: Cause.TORQUE}


@dataclass(frozen=True)
class Failure:
    """Cause of a failure: `count` of `total` rollouts show it."""

    cause: Cause
    count: int
    total: int
    detail: str = ""
    size: float = 0.0


def why_failed(
    records: Sequence[Record], task: Task, settings: SessionSettings, start: Policy | None
) -> Failure | None:
    """Why a session has failed; None if it goes on, or its re-tests mostly succeeded.

    `start` is the policy of the demonstration that was learnt from last, None if there is none.
    """
    rules = settings.practice
    own = [record for record in records if record.kind != "retest"]
    tests = [record for record in records if record.kind == "retest"]
    used = sum(record.ret is not None for record in own)
    reproduced = any(r.kind != "reproduction" or (r.ret is not None and not r.fault) for r in own)
    tried = own and (own[-1].ret is not None or own[-1].attempt >= rules.attempts)
    hopeless = tried and not reproduced
    learnt = tests or used >= rules.budget or len(own) >= 3 * rules.budget
    tested = len(tests) >= rules.retests or any(record.refused for record in tests)
    if not (hopeless or (learnt and tested)):
        return None
    last = [record for record in tests if record.ret is not None] or own[-1:]
    if 2 * sum(record.succeeded for record in last) >= len(last):
        return None
    learner = installed.find("learner", settings.learner)
    found = _unseen(own) or _faults(own) or _soft(own, start) or _errors(own, task, start)
    if found and found.cause is Cause.UNMEASURED and not (needs_errors(learner) or task.gain):
        found = None  # the return alone told what to change
    found = found or _disagree(own)
    drawn = sum(record.kind == "explore" for record in own)
    fell_back = hasattr(learner, "falls_back") and 2 * drawn > len(own)
    return found or Failure(Cause.FELL_BACK if fell_back else Cause.UNKNOWN, drawn, len(own))


def _unseen(own: Sequence[Record]) -> Failure | None:
    """What could not be judged, although no fault ended it."""
    lost = [record for record in own if record.ret is None and not record.fault]
    if len(lost) <= UNUSABLE_MIN * len(own):
        return None
    seen = [record.observation or {} for record in lost]
    late = [each["stamps_late"] for each in seen if each.keys() == {"stamps_late"}]  # not corrected
    if 2 * len(late) > len(lost):
        return Failure(Cause.CLOCKS, len(late), len(own), size=float(np.median(late)))
    return Failure(Cause.UNSEEN, len(lost), len(own), lost[-1].why)


def _faults(own: Sequence[Record]) -> Failure | None:
    """Faults of the controller, by their most frequent kind."""
    kinds = Counter(record.fault_kind for record in own if record.fault_kind is not None)
    if kinds.total() <= FAULTS_MIN * len(own):
        return None
    kind, count = kinds.most_common(1)[0]
    cause = Cause.LIMITS if kind.of_policy else Cause.FAULTS
    cause = _NAMED.get(kind, cause)
    return Failure(cause, count, len(own), kind.value)


def _soft(own: Sequence[Record], start: Policy | None) -> Failure | None:
    """Springs that do not bring the tool to where the last attractors are moved."""
    if start is None:
        return None
    shift = np.zeros((3, start.basis.count, 3))
    shift[:, -math.ceil(start.basis.count / 3) :] = np.eye(3)[:, np.newaxis]
    stiffness = np.broadcast_to(start.stiffness, (3, *start.stiffness.shape))
    steps, still = round(start.basis.duration / STEP), np.zeros(3)
    path, _ = dmp.reproduce_many(
        start.basis, stiffness, shift, start.damping, still, still, steps, STEP
    )
    follows = float(np.diagonal(path[:, -1]).min())
    failure = Failure(Cause.SOFT, len(own), len(own), size=follows)
    return failure if follows < FOLLOWED_MIN else None


def _errors(own: Sequence[Record], task: Task, start: Policy | None) -> Failure | None:
    """Errors without a value, that change by themselves, or not as the task expects."""
    model = None if start is None else task.rough_errors(task.parametrization(start))
    judged = [r for r in own if r.ret is not None and not r.fault]
    if start is None or model is None or not judged:
        return None
    judged = [record for record in judged if record.demonstration == start.id]
    names = [error.name for error in model.errors]
    told = [task.error(record.observation) for record in judged]
    error = np.array([np.full(len(names), math.nan) if row is None else row for row in told])
    unknown = np.isnan(error.reshape(-1, len(names)))
    worst = int(np.argmax(unknown.sum(axis=0)))
    if 3 * unknown[:, worst].sum() > 2 * len(judged):
        return Failure(Cause.UNMEASURED, int(unknown[:, worst].sum()), len(judged), names[worst])
    known = ~unknown.any(axis=1)
    if known.sum() < ROLLOUTS_MIN:
        return None
    z = np.array([record.z for record in judged])[known]
    when = np.array([record.number for record in judged])[known] / len(own)
    expected = z @ np.linalg.pinv(model.directions) @ model.slopes.T  # (k, m) [tolerances]
    trends = [_trend(*pair, when) for pair in zip(error[known].T, expected.T, strict=True)]
    change, clarity, share = (np.array(column) for column in zip(*trends, strict=True))
    drifts, ignored = int(np.argmax(clarity)), int(np.argmin(share))
    if clarity[drifts] > CLEAR and abs(change[drifts]) > DRIFT_MIN:
        return Failure(Cause.DRIFT, len(z), len(own), names[drifts], float(change[drifts]))
    if share[ignored] < IGNORED_MAX:
        return Failure(Cause.IGNORED, len(z), len(own), names[ignored], float(share[ignored]))
    return None


def _trend(error: np.ndarray, expected: np.ndarray, when: np.ndarray) -> tuple[float, float, float]:
    """Change of an error (k,) while `when` goes from 0 to 1, and what it follows of the `expected`.

    Returns:
        The change, its size in standard deviations, and the largest share of the expected change
        that the errors may have followed, infinite where nothing was to change.
    """
    terms = [np.ones_like(when), when]
    if moved := bool(np.std(expected) > MOVED_MIN):
        terms.append(expected)
    columns = np.stack(terms, axis=1)  # (k, 2 or 3)
    found = np.linalg.lstsq(columns, error)[0]
    variance = np.sum((error - columns @ found) ** 2) / (len(error) - len(terms))
    sd = np.sqrt(np.maximum(variance * np.diag(np.linalg.pinv(columns.T @ columns)), 1e-12))
    share = float(found[2] + 2.0 * sd[2]) if moved else math.inf
    return float(found[1]), float(abs(found[1]) / sd[1]), share


def _disagree(own: Sequence[Record]) -> Failure | None:
    """Returns that are no higher for a success than otherwise."""
    known = [record for record in own if record.ret is not None]
    good = np.array([record.ret for record in known if record.succeeded])
    others = np.array([record.ret for record in known if not record.succeeded])
    if min(len(good), len(others)) < GROUP_MIN:
        return None
    above = good[:, None] - others
    higher = float(np.mean(above > 0.0) + 0.5 * np.mean(above == 0.0))
    failure = Failure(Cause.DISAGREE, len(good), len(known), size=higher)
    return failure if higher < AGREED_MIN else None
