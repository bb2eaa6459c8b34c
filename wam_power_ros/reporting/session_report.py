# SPDX-License-Identifier: Apache-2.0
"""Report of a session as one self-contained HTML file, figures and film included.

All figures and sentences are computed from the session's records; the same folder gives the same
file. What is specific to a task comes from the task.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from markupsafe import Markup
from matplotlib.figure import Figure

from wam_power_ros import durable_files, plotting
from wam_power_ros.learning import policy
from wam_power_ros.learning.dmp import activations
from wam_power_ros.learning.rollout import Rollout
from wam_power_ros.practice import session
from wam_power_ros.practice.best_policy import reproduction_learnt_from
from wam_power_ros.practice.failure import why_failed
from wam_power_ros.practice.session import Session, SessionHeader
from wam_power_ros.practice.session_log import KIND_NAMES, Record
from wam_power_ros.reporting import figures, html_page
from wam_power_ros.reporting.terminal import (
    before_and_after,
    choice,
    counted,
    failed,
    number,
    resets,
    returned,
    term_names,
)
from wam_power_ros.tasks.task import Task


@dataclass(frozen=True)
class ShownRollout:
    """A rollout of the session's policy, shown in detail."""

    caption: str
    rollout: Rollout
    film: bytes | None = None  # animated .webp image, None without a film


def render(
    found: Session,
    answer: policy.Policy | None,
    shown: ShownRollout | None = None,
    why_no_film: str = "",
) -> str:
    """HTML of the report of a session and its best policy so far, if it has one.

    `shown` is a rollout in detail, whose film may be missing.
    """
    task, records, start = found.task, found.records, found.start
    parts = [_cards(task, records), _verdict(found, answer)]
    if shown is not None:
        parts.append(_shown(task, shown, why_no_film))
    if records:
        parts += [_curves(task, records), _errors(task, records)]
    if answer is not None:
        profiles = {} if start is None else {"start": vertical_stiffness(start)}
        profiles[answer.id] = vertical_stiffness(answer)
        text = f"Vertical stiffness over the movement: the demonstration's and that of {answer.id}."
        drawn = figures.stiffness(profiles)
        parts.append(html_page.section("Stiffness", [text], _svg(drawn, text)))
    parts += [_table(task, records), _settings(found.header)]
    return html_page.page(f"Session of seed {found.header.seed}, task {task.name}", parts)


def write(folder: Path, shown: ShownRollout | None = None, why_no_film: str = "") -> Path:
    """Write `report.html` into a session folder.

    Raises:
        ValueError: There is no session, or it is malformed.
    """
    found = session.read(folder)
    saved = folder / "policy.json"
    answer = policy.from_json(saved.read_text()) if saved.exists() else None
    path = folder / "report.html"
    durable_files.replace(path, render(found, answer, shown, why_no_film))
    return path


def vertical_stiffness(of: policy.Policy) -> np.ndarray:
    """K33 = sum_i h_i K_i,33 of a policy at evenly spaced times [1/s^2]. Shape (200,)."""
    t = np.linspace(0.0, of.basis.duration, 200)
    return activations(of.basis, t) @ of.stiffness[:, 2, 2]


def _first(task: Task, records: Sequence[Record]) -> int | None:
    """Number of the first rollout that achieved the goal, None if there is none."""
    return next((record.number for record in records if task.achieved(record)), None)


def _svg(drawn: Figure, alt: str) -> Markup:
    return html_page.image(plotting.svg(drawn), alt, style="drawn")


def _cards(task: Task, records: Sequence[Record]) -> Markup:
    usable = [record.ret for record in records if record.ret is not None]
    tests = [record for record in records if record.kind == "retest"]
    cards = [("rollouts", str(len(records)))]
    if usable:
        last = usable[-5:]
        first = reproduction_learnt_from(records)
        if first is not None:
            cards.append(("return of the reproduction, before learning", number(first.ret)))
        cards.append((f"mean return of the last {len(last)}", f"{statistics.mean(last):.3f}"))
    if tests:
        achieved = sum(task.achieved(record) for record in tests)
        cards.append((f"re-tests {task.goal.retests}", f"{achieved} of {len(tests)}"))
    cards += task.measured(tests).items()
    return html_page.cards(cards)


def _verdict(found: Session, answer: policy.Policy | None) -> Markup:
    header, task, records = found.header, found.task, found.records
    settings = header.settings
    text = [
        f"Seed {header.seed}, {settings.described(task)}; at most "
        f"{counted(settings.practice.budget, 'rollout')}, then "
        f"{counted(settings.practice.retests, 're-test')} of the final policy."
    ]
    goal = task.goal
    if (first := _first(task, records)) is not None:
        text.append(f"Rollout {first} was the first that {goal.achieved}.")
    elif records:
        text.append(f"No rollout {goal.achieved} yet.")
    if ratings := [record.adjustment for record in records if record.adjustment is not None]:
        rewarded = sum(rating > 0.0 for rating in ratings)
        text.append(
            f"A person rewarded {counted(rewarded, 'rollout')} and punished "
            f"{len(ratings) - rewarded}; the table has the amounts beside the returns."
        )
    begun = header.candidates
    if added := dict.fromkeys(r.demonstration for r in records if r.demonstration not in begun):
        text.append(f"Demonstrations added while learning: {', '.join(added)}.")
    if unusable := sum(record.ret is None for record in records):
        text.append(f"Without a return, and not learnt from: {counted(unusable, 'rollout')}.")
    pairs = [(r.truth, r.observation) for r in records if r.truth and r.observation]
    true, seen = goal.true, goal.observed
    if answers := [(t[true], o[seen]) for t, o in pairs if true in t and seen in o]:
        agree = sum(bool(one) == bool(other) for one, other in answers)
        text.append(
            f"{goal.question[0].upper()}{goal.question[1:]}: measurements and the simulator's "
            f"ground truth agree in {agree} of {counted(len(answers), 'rollout')}."
        )
    lines = [*before_and_after(records, task), *task.summary(records), *resets(records)]
    lines += [] if answer is None else choice(records, answer.id)
    lines += failed(why_failed(records, task, settings, found.start))
    text += [f"{line[0].upper()}{line[1:]}." for line in lines]
    if decisions := [record.note for record in records if record.note]:
        text.append(f"Last decision: {decisions[-1]}.")
    return html_page.items([line.strip() for line in text])


def _shown(task: Task, shown: ShownRollout, why_no_film: str) -> Markup:
    rollout = shown.rollout
    if shown.film is not None:
        alt = f"Film of the arm that executes {rollout.tool.id}: {shown.caption}"
        content = html_page.image(shown.film, alt, "image/webp")
    else:
        content = Markup('<p class="quiet">No film: {}</p>').format(why_no_film)
    text = shown.caption
    if (drawn := task.figure(rollout)) is not None:
        figure, remark = drawn
        text = f"{text} {remark}".rstrip()
        content += _svg(figure, f"Measured path of {rollout.tool.id}. {remark}".rstrip())
    return html_page.section(f"The session's policy, {rollout.tool.id}", [text], content)


def _curves(task: Task, records: Sequence[Record]) -> Markup:
    first = _first(task, records)
    marks = {} if first is None else {first: task.goal.first}
    kinds = [record.kind for record in records]
    own = [math.nan if record.ret is None else record.ret for record in records]
    text = "The session's return of every rollout, without ratings."
    drawn = figures.learning_curve(own, kinds, marks)
    known = [each for each in own if math.isfinite(each)]
    reached = f" From {known[0]:.3f} to {known[-1]:.3f}, at most {max(known):.3f}." if known else ""
    alt = f"Learning curve of {counted(len(own), 'rollout')}.{reached}"
    return html_page.section("Learning curve", [text], _svg(drawn, alt))


def _errors(task: Task, records: Sequence[Record]) -> Markup:
    """Errors of every rollout; empty if the task measures none."""
    values = [task.measure(r.observation or {}) or {} if r.observation else {} for r in records]
    wanted = [error for error in task.wanted_errors() if any(error.name in one for one in values)]
    if not wanted:
        return Markup()
    drawn = figures.errors(wanted, values, [record.kind for record in records])
    text = "What every rollout measured; hollow points are far outside, at the edge."
    return html_page.section("Errors", [text], _svg(drawn, text))


def _table(task: Task, records: Sequence[Record]) -> Markup:
    names = term_names(records)
    heads = ["#", "kind", "return", *names, "outcome", "decision"]
    rows = []
    for record in records:
        cells = [str(record.number), KIND_NAMES[record.kind], returned(record)]
        cells += [number(record.terms.get(name)) for name in names]
        rows.append([*cells, task.outcome(record), record.note])
    good = [index for index, record in enumerate(records) if record.success]
    return html_page.section("Every rollout", (), html_page.table(heads, rows, good=good))


def _settings(header: SessionHeader) -> Markup:
    data: dict[str, Any] = header.model_dump(mode="json", by_alias=True)
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
    html = "<details><summary>session.yaml</summary><pre>{}</pre></details>"
    return Markup(html).format(text)
