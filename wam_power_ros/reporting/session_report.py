# SPDX-License-Identifier: Apache-2.0
"""A session as one HTML file that needs nothing else: figures and film are inside it.

Every figure and sentence is computed from the session's records; running it again on the same
folder gives the same file.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from wam_power_ros.learning import policy
from wam_power_ros.learning.dmp import activations
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath
from wam_power_ros.practice import session
from wam_power_ros.practice.session import SessionHeader
from wam_power_ros.practice.session_log import Record
from wam_power_ros.reporting import figures, flip_figures, html_page
from wam_power_ros.reporting.terminal import angle, outcome, paper_return, returned

VL2 = 1.0  # factory fault speed of the WAM's safety board, elbow and forearm [m/s]


@dataclass(frozen=True)
class Exhibit:
    """One rollout to be shown in full: what the session's records do not hold.

    Attributes:
        caption: What became of it.
        pan: Path of the pan.
        pancake: Path of the pancake.
        t_f: When the fall was judged [s].
        film: An animated .webp, None when nothing could render it.
    """

    caption: str
    pan: EndEffectorPath
    pancake: BodyPath
    t_f: float
    film: bytes | None = None


def render(
    header: SessionHeader,
    start: policy.Policy | None,
    answer: policy.Policy | None,
    records: Sequence[Record],
    exhibit: Exhibit | None = None,
    why_no_film: str = "",
) -> str:
    """The report.

    Args:
        header: Of the session.
        start: Policy of the demonstration that was learnt from, None while it is not chosen.
        answer: Best policy so far, None while there is none.
        records: The rollouts.
        exhibit: A rollout to be shown in full, if any.
        why_no_film: Said when there is no film of it.
    """
    parts = [_cards(records), _verdict(header, records)]
    if exhibit is not None:
        parts.append(_exhibit(exhibit, why_no_film))
    if records:
        parts.append(_curves(header, records))
    if answer is not None:
        policies = [] if start is None else [("start", start)]
        profiles = {name: vertical_stiffness(one) for name, one in [*policies, (answer.id, answer)]}
        parts.append(
            html_page.section(
                "Stiffness",
                [
                    f"Vertical stiffness over the movement: the demonstration's and that of "
                    f"{answer.id}. The paper's policy changed by a few percent."
                ],
                html_page.image(figures.svg(figures.stiffness(profiles))),
            )
        )
    parts += [_speeds(records), _table(records), _settings(header)]
    return html_page.page(
        f"Session of seed {header.seed}, return {header.settings.task_settings.ret}", parts
    )


def write(folder: Path, exhibit: Exhibit | None = None, why_no_film: str = "") -> Path:
    """Write `report.html` into a session folder.

    Returns:
        Path of the report.

    Raises:
        session.SessionError: No session, or a malformed one.
    """
    header, candidates, records = session.read(folder)
    practised = [record for record in records if record.kind != "reproduction"]
    learnt_from = practised[-1].demonstration if practised else None
    start = next((candidate for candidate in candidates if candidate.id == learnt_from), None)
    saved = folder / "policy.json"
    answer = policy.from_json(saved.read_text()) if saved.exists() else None
    path = folder / "report.html"
    path.write_text(render(header, start, answer, records, exhibit, why_no_film), encoding="utf-8")
    return path


def _cards(records: Sequence[Record]) -> str:
    usable = [record.ret for record in records if record.ret is not None]
    tests = [record for record in records if record.kind == "retest"]
    angles = [turned for record in tests if (turned := angle(record)) is not None]
    cards = [("rollouts", str(len(records)))]
    if usable:
        last = usable[-5:]
        cards += [
            ("return of the first", f"{usable[0]:.3f}"),
            (f"mean return of the last {len(last)}", f"{statistics.mean(last):.3f}"),
        ]
    if tests:
        good = sum(outcome(record) == "flipped, caught" for record in tests)
        cards.append(("re-tests flipped and caught", f"{good} of {len(tests)}"))
    if angles:
        cards.append(("median angle of the re-tests", f"{statistics.median(angles):.0f}°"))
    return html_page.cards(cards)


def _verdict(header: SessionHeader, records: Sequence[Record]) -> str:
    own = header.settings.task_settings
    said = [
        f"The session has seed {header.seed}, learns {own.variant} parameters from the "
        f"return {own.ret!r} and may use {header.settings.practice.budget} rollouts."
    ]
    first = next((r for r in records if outcome(r) == "flipped, caught"), None)
    if first is not None:
        said.append(f"The pancake was first flipped and caught in rollout {first.number}.")
    elif records:
        said.append("The pancake has not been flipped and caught yet.")
    rated = [record for record in records if record.adjustment is not None]
    if rated:
        liked = sum((record.adjustment or 0.0) > 0.0 for record in rated)
        said.append(
            f"A person rewarded {liked} rollouts and punished {len(rated) - liked}; by how much "
            "stands behind their returns."
        )
    begun = header.candidates
    later = dict.fromkeys(r.demonstration for r in records if r.demonstration not in begun)
    if later:
        said.append(f"Given in the middle of learning: {', '.join(later)}.")
    unusable = [record for record in records if record.ret is None]
    if unusable:
        said.append(f"{len(unusable)} rollouts could not be judged and were not learnt from.")
    judged = [r for r in records if r.truth is not None and r.observation is not None]
    if judged:
        agree = sum(
            bool(r.truth.get("caught")) == bool(r.observation.get("resting"))
            for r in judged
            if r.truth is not None and r.observation is not None
        )
        said.append(
            f"On whether it was caught, the tracker agreed with the simulator in {agree} of "
            f"{len(judged)} rollouts."
        )
    decisions = [record.note for record in records if record.note]
    if decisions:
        said.append(f"Last decision: {decisions[-1]}.")
    return html_page.paragraphs([" ".join(said)])


def _exhibit(exhibit: Exhibit, why_no_film: str) -> str:
    if exhibit.film is not None:
        film = html_page.image(exhibit.film, "image/webp")
    else:
        film = f'<p class="quiet">No film: {escape(why_no_film)}</p>'
    figure = flip_figures.rollout(exhibit.pan, exhibit.pancake, exhibit.t_f)
    return html_page.section(
        f"The answer, {exhibit.pan.id}",
        [
            f"{exhibit.caption} Arrows are the normals of pan and pancake, as in Figs. 3 and 4 of "
            "the paper; dots are camera frames."
        ],
        film + html_page.image(figures.svg(figure)),
    )


def _curves(header: SessionHeader, records: Sequence[Record]) -> str:
    eq5 = np.array([paper_return(record) for record in records])
    first = next((r.number for r in records if outcome(r) == "flipped, caught"), None)
    marks = {} if first is None else {first: "first flip"}
    html = html_page.section(
        "Learning curve",
        ["The return of Eq. 5 in every rollout. The paper's curve is the mean of six sessions."],
        html_page.image(figures.svg(figures.learning_curve(eq5, marks, paper=True))),
    )
    if header.settings.task_settings.ret != "eq5":
        own = np.array([math.nan if r.ret is None else r.ret for r in records])
        html += html_page.section(
            "What was learnt from",
            [f"The session's own return, {header.settings.task_settings.ret!r}."],
            html_page.image(figures.svg(figures.learning_curve(own, marks, paper=False))),
        )
    names = list(dict.fromkeys(name for record in records for name in record.terms))
    values = {name: [record.terms.get(name) for record in records] for name in names}
    numbers = [record.number for record in records]
    return html + html_page.section(
        "Terms", content=html_page.image(figures.svg(figures.terms(numbers, values)))
    )


def _speeds(records: Sequence[Record]) -> str:
    """What a real arm's safety board would have had to allow, from the stand-in's account."""
    names = {"elbow": "peak_elbow_speed", "forearm, 350 mm past the elbow": "peak_forearm_speed"}
    tests = [r.truth for r in records if r.kind == "retest" and r.truth]
    known = tests or [record.truth for record in records if record.truth]
    peaks = {
        place: max(truth[key] for truth in known)
        for place, key in names.items()
        if known and all(truth.get(key) is not None for truth in known)
    }
    if not peaks:
        return ""
    rows = "; ".join(f"{place} {speed:.2f} m/s" for place, speed in peaks.items())
    which = "re-tests" if tests else "rollouts"
    top = max(peaks.values())
    advice = (
        f"That is over the factory fault speed of {VL2} m/s: the safety board would idle the arm. "
        "Its owner has to decide whether to raise that limit."
        if top > VL2
        else f"That is within the factory fault speed of {VL2} m/s."
    )
    return html_page.section("Speeds", [f"Highest in the {which}: {rows}. {advice}"])


def _table(records: Sequence[Record]) -> str:
    names = list(dict.fromkeys(name for record in records for name in record.terms))
    heads = ["#", "kind", "return", *names, "angle", "pancake", "decision"]
    rows = []
    for record in records:
        turned = angle(record)
        cells = [
            str(record.number),
            record.kind,
            returned(record),
            *(_number(record.terms.get(name)) for name in names),
            "–" if turned is None else f"{turned:.0f}°",
            outcome(record),
            record.note,
        ]
        rows.append(cells)
    good = [place for place, record in enumerate(records) if record.success]
    return html_page.section("Every rollout", content=html_page.table(heads, rows, good=good))


def _settings(header: SessionHeader) -> str:
    data: dict[str, Any] = header.model_dump(mode="json", by_alias=True)
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
    return f"<details><summary>session.yaml</summary><pre>{escape(text)}</pre></details>"


def vertical_stiffness(of: policy.Policy) -> np.ndarray:
    """K33 = sum_i h_i K_i,33 of a policy, evenly in time [1/s^2]. Shape (200,)."""
    t = np.linspace(0.0, of.basis.duration, 200)
    return activations(of.basis, t) @ of.stiffness[:, 2, 2]


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"
