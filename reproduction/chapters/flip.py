# SPDX-License-Identifier: Apache-2.0
"""Statistics, tables and figures of the pancake sessions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import mannwhitneyu

from reproduction import figures
from reproduction.chapter import Study
from reproduction.jobs import Results
from reproduction.paper_curves import FIG5, K33
from reproduction.studies import flip_sessions
from reproduction.studies.flip_sessions import ABLATION, HINDSIGHT, PAPER
from wam_power_ros.learning.rollout import BodyPath, EndEffectorPath, Rollout
from wam_power_ros.reporting.figures import stiffness
from wam_power_ros.reporting.terminal import counted
from wam_power_ros.tasks.side_view import side_view

Row = Mapping[str, Any]  # a rollout in a result of the study
RELIABLE = 0.9  # share of the re-tests of a final policy
PAPER_LABEL = "paper's settings"
BLOCK = 10  # rollouts averaged in the ablation


@dataclass(frozen=True)
class Sessions:
    """Sessions under one condition: results of `flip_sessions.session` and their statistics."""

    runs: Sequence[Mapping[str, Any]]

    def __len__(self) -> int:
        return len(self.runs)

    @property
    def retests(self) -> list[Row]:
        """Re-tests of all sessions."""
        return [row for run in self.runs for row in run["retests"]]

    @property
    def used(self) -> np.ndarray:
        """Number of rollouts used by each session. Shape (n,)."""
        return np.array([run["used"] for run in self.runs])

    @property
    def landed(self) -> np.ndarray:
        """Share of each session's re-tests that landed. Shape (n,)."""
        return np.array([share(run["retests"], "landed") for run in self.runs])

    @property
    def true_flips(self) -> np.ndarray:
        """Share of each session's re-tests that were true flips. Shape (n,)."""
        return np.array([share(run["retests"], "true_flip") for run in self.runs])

    @property
    def reproduced(self) -> int:
        """Number of sessions in which the chosen reproduction was a true flip.

        A session learns from the reproduction of highest return.
        """
        count = 0
        for run in self.runs:
            first = [trial for trial in run["trials"] if trial["kind"] == "reproduction"]
            best = max(first, key=lambda trial: trial["ret"] or 0.0, default=None)
            count += best is not None and bool(best["true_flip"])
        return count

    @property
    def curves(self) -> list[list[float]]:
        """Returns of the rollouts of each session, without those that have none."""
        return [[ret for ret in run["curve"] if ret is not None] for run in self.runs]

    @property
    def gain(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean return of the first and of the last five rollouts of each session. Shapes (n,)."""
        return figures.first_and_last_five(self.curves)

    def means(self, name: str, form: str) -> list[str]:
        """Cells: quantiles over sessions of the mean of a quantity over the re-tests, if any."""
        tested = [run["retests"] for run in self.runs if run["retests"]]
        return quantile_cells(np.array([column(rows, name).mean() for rows in tested]), form)

    def stiffness(self, which: str) -> np.ndarray:
        """K33 profile of each policy, "learnt" or "demonstrated". Shape (<= n, T)."""
        return np.array([run["k33"][which] for run in self.runs if run["k33"]])

    @property
    def count(self) -> str:
        """Number of sessions as text."""
        return counted(len(self), "session")


def values(results: Results) -> dict[str, Any]:
    """Names of the template; ignores results of other studies."""
    hindsight, paper = (Sessions([*results[s].values()]) for s in (HINDSIGHT, PAPER))
    ablated = {
        name.removeprefix(ABLATION): runs
        for name, runs in results.items()
        if name.startswith(ABLATION)
    }
    seeds = next(iter(ablated.values()))
    ablated["full"] = {key: results[PAPER][key] for key in seeds}  # same seeds
    ablation = {name: Sessions([*runs.values()]) for name, runs in ablated.items()}
    return {
        "hindsight": hindsight,
        "paper": paper,
        "reliable": RELIABLE,
        "block": BLOCK,
        "hindsight_shown": _shown(hindsight),
        "paper_shown": _shown(paper),
        **_hindsight(hindsight),
        **_robustness(hindsight),
        **_paper(paper),
        **_stiffness(hindsight, paper),
        **_ablation(ablation),
    }


def _hindsight(sessions: Sessions) -> dict[str, Any]:
    """Our preset of PoWER with corrections."""
    retests = sessions.retests
    trials = [row for run in sessions.runs for row in run["trials"]]
    peaks = np.array([row["peak_qd"] for row in retests]).max(axis=0)
    return {
        "trials": len(trials),
        "faults": sum(bool(row["fault"]) for row in trials),
        "confirmed": sum(run["ended_by"] == "confirmation" for run in sessions.runs),
        "beyond": sum(row["beyond_no_load"] for row in retests),
        "elbow": column(retests, "elbow_speed"),
        "forearm": column(retests, "forearm_speed"),
        "speeds": ", ".join(f"J{k} {peak:.1f}" for k, peak in enumerate(peaks, start=1)),
        "hindsight_rows": [
            ["landed, share of re-tests", *quantile_cells(sessions.landed, ".0%")],
            ["true flips, share of re-tests", *quantile_cells(sessions.true_flips, ".0%")],
            ["angle at t_f, mean [degrees]", *sessions.means("angle_deg", ".0f")],
            ["rollouts until the final policy", *quantile_cells(sessions.used, ".0f")],
            ["miss at t_f, mean [m]", *sessions.means("miss", ".3f")],
            ["apex, mean [m]", *sessions.means("apex", ".2f")],
        ],
    }


def _robustness(sessions: Sessions) -> dict[str, Any]:
    """Policies of this preset in other conditions."""
    carried: dict[str, list[Row]] = {}
    for run in sessions.runs:
        for condition, rows in run["carried"].items():
            carried.setdefault(condition, []).extend(rows)
    conditions = {"as learnt": sessions.retests, **carried}
    return {
        "shares": {name: share(rows, "landed") for name, rows in carried.items()},
        "condition_rows": [[n, f"{len(r)}", *outcome_cells(r)] for n, r in conditions.items()],
    }


def _paper(sessions: Sessions) -> dict[str, Any]:
    """The paper's preset beside Fig. 5."""
    six = Sessions(sessions.runs[:6])
    rows = []
    for name, some in (("50", sessions), ("50, the first six sessions", six)):
        means = [f"{returns.mean():.2f}" for returns in some.gain]
        apex = f"{column(some.retests, 'apex').mean():.2f}"
        rows.append([name, f"{len(some)}", *means, *outcome_cells(some.retests)[:3], apex])
    curves = {"first six": six.curves, "all": sessions.curves}
    return {
        "fig5": FIG5[:, 1],
        "fired": [run["fires"] for run in sessions.runs if run["fires"] is not None],
        "paper_rows": rows,
        "learning_curve": figures.sessions_over_paper(curves, FIG5),
    }


def _stiffness(hindsight: Sessions, paper: Sessions) -> dict[str, Any]:
    """Variation of the vertical stiffness along the movements."""
    profiles = {"hindsight": hindsight.stiffness("learnt"), PAPER_LABEL: paper.stiffness("learnt")}
    ours, paper_like = (_variation(rows) for rows in profiles.values())
    return {
        "published": _variation(K33[:, 1]),
        "variation": {
            "demonstrated": _variation(paper.stiffness("demonstrated")),
            "hindsight": ours,
            "paper": paper_like,
        },
        "profiles": stiffness(profiles, K33),
    }


def _ablation(ablation: Mapping[str, Sessions]) -> dict[str, Any]:
    """The paper's settings with fewer matrix entries to learn."""
    stacked = {name: figures.stack(sessions.curves) for name, sessions in ablation.items()}
    finals = {name: np.nanmean(curves[:, -BLOCK:], axis=1) for name, curves in stacked.items()}
    p = {name: _p(finals["full"], final) for name, final in finals.items()}
    rows = []
    for name, sessions in ablation.items():
        curves, final = stacked[name], finals[name]
        blocks = [np.nanmean(curves[:, k : k + BLOCK]) for k in range(0, curves.shape[1], BLOCK)]
        returns = " ".join(f"{value:.2f}" for value in blocks)
        cells = [returns, f"{final.mean():.3f} ± {final.std():.3f}"]
        cells += [f"{shares.mean():.0%}" for shares in (sessions.landed, sessions.true_flips)]
        rows.append([name, *cells, "" if name == "full" else f"{p[name]:.3g}"])
    return {
        "finals": finals,
        "p": p,
        "ablation_rows": rows,
        "best": max(range(len(rows)), key=lambda k: finals[rows[k][0]].mean()),
        "ablation_curves": figures.learner_curves(
            {name: sessions.curves for name, sessions in ablation.items()},
            ours=("full",),
            ylabel="return (Eq. 5)",
        ),
    }


def _shown(sessions: Sessions) -> dict[str, Figure]:
    """Figures of the rollouts of the session that kept its paths, if any, by name."""
    kept = next((run["paths"] for run in sessions.runs if run["paths"]), {})
    shown = {}
    for name, paths in kept.items():
        pan, pancake = ({k: np.array(v) for k, v in path.items()} for path in paths.values())
        rollout = Rollout(EndEffectorPath("shown", **pan), BodyPath("shown", **pancake))
        shown[name] = side_view(rollout, "pancake")
    return shown


def _variation(profiles: np.ndarray) -> np.ndarray:
    """(Maximum - minimum) / mean of each profile (..., T). Shape (...)."""
    return np.ptp(profiles, axis=-1) / profiles.mean(axis=-1)


def _p(one: np.ndarray, other: np.ndarray) -> float:
    return float(mannwhitneyu(one, other, alternative="two-sided").pvalue)


def column(rows: Iterable[Row], name: str) -> np.ndarray:
    """Values of a quantity in all rows. Shape (n,)."""
    return np.array([row[name] for row in rows], dtype=float)


def share(rows: Sequence[Row], name: str) -> float:
    """Share of the rows in which a flag is set; 0 without rows."""
    return float(column(rows, name).mean()) if rows else 0.0


def outcome_cells(rows: Sequence[Row]) -> list[str]:
    """Cells: landed, true flips, median angle, number beyond the motors' no-load speed."""
    angle = f"{np.median(column(rows, 'angle_deg')):.0f}°" if rows else ""
    beyond = f"{sum(row['beyond_no_load'] for row in rows)}"
    shares = [f"{share(rows, name):.0%}" if rows else "" for name in ("landed", "true_flip")]
    return [*shares, angle, beyond]


def quantile_cells(sample: np.ndarray, form: str) -> list[str]:
    """Cells: minimum, lower quartile, median, upper quartile and maximum of a sample."""
    return [f"{value:{form}}" for value in np.quantile(sample, (0.0, 0.25, 0.5, 0.75, 1.0))]


STUDY = Study(
    "Flipping a pancake (Sec. III-B, Figs. 3 to 5)",
    flip_sessions.jobs,
    values,
    Path(__file__).with_suffix(".html.j2"),
)
