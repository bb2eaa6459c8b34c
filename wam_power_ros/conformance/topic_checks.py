# SPDX-License-Identifier: Apache-2.0
"""Whether a driver is what its configuration says: rows of a table, and what any topic must keep.

Pure functions over what was heard: samples in, rows out. What concerns the arm is in
`arm_conformance`, what concerns motion capture in `mocap_conformance`. Times are `int` nanoseconds;
`received_ns` is by this machine's system clock.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

RATE_TOLERANCE = 0.1  # share by which a rate may be off
RATE_NOTED = 0.03  # share from which it is worth a word
PAIR = 1_000_000  # [ns] stamps nearer than that are of one frame, sent twice
CLOCK_NOTED = 100_000_000  # [ns] by which a stamp may differ from this machine's clock


class Verdict(Enum):
    """What a row says."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    UNCHECKED = "not checked"


@dataclass(frozen=True)
class Row:
    """One thing that was looked at.

    Attributes:
        name: Of what; unique in a table.
        expected: What the configuration asks for.
        found: What was heard.
        verdict: Whether they agree.
        advice: What to do about it.
    """

    name: str
    expected: str
    found: str
    verdict: Verdict
    advice: str = ""


class Endpoint(NamedTuple):
    """A publisher or subscription of another node, as the graph shows it."""

    node: str
    type: str
    reliable: bool
    latched: bool


def accepted(rows: Sequence[Row], names: Collection[str]) -> list[Row]:
    """The rows, with failures that a person has accepted by name as warnings.

    Raises:
        ValueError: A name that no row has; the message lists those that fail.
    """
    if unknown := set(names) - {row.name for row in rows}:
        known = [row.name for row in rows if row.verdict is Verdict.FAIL]
        raise ValueError(f"no row {sorted(unknown)} to accept; those that fail: {known}")
    return [
        replace(row, verdict=Verdict.WARN, advice=f"accepted. {row.advice}")
        if row.name in names and row.verdict is Verdict.FAIL
        else row
        for row in rows
    ]


def verdict(rows: Sequence[Row]) -> tuple[Verdict, str]:
    """The whole table in one verdict, and one sentence for whoever wants to move the arm."""
    named = {
        kind: ", ".join(row.name for row in rows if row.verdict is kind)
        for kind in (Verdict.FAIL, Verdict.WARN, Verdict.UNCHECKED)
    }
    if named[Verdict.FAIL]:
        return Verdict.FAIL, f"DOES NOT CONFORM, let nothing move: {named[Verdict.FAIL]}."
    rest = ""
    if named[Verdict.WARN]:
        rest += f" Read first: {named[Verdict.WARN]}."
    if named[Verdict.UNCHECKED]:
        rest += f" Not checked: {named[Verdict.UNCHECKED]}."
    if rest:
        return Verdict.WARN, f"CONFORMS as far as it was checked.{rest}"
    return Verdict.OK, "CONFORMS."


def heard(name: str, topic: str, count: int, seconds: float, sent_by: Sequence[Endpoint]) -> Row:
    """Whether a topic is alive."""
    nodes = ", ".join(sorted(end.node for end in sent_by)) or "nobody"
    found = f"{count} messages in {seconds:.1f} s from {nodes}"
    if count:
        return Row(name, f"messages on {topic}", found, Verdict.OK)
    advice = "start the driver, or name the topic it publishes; is it on this ROS_DOMAIN_ID? "
    advice += "check ROS_AUTOMATIC_DISCOVERY_RANGE and firewalls when it is on another machine"
    return Row(name, f"messages on {topic}", found, Verdict.FAIL, advice)


def rate(name: str, stamp_ns: np.ndarray, wanted: float) -> Row:
    """Rate by the stamps, as the median of their intervals tells it, and what is missing.

    Args:
        name: Of the row.
        stamp_ns: As sent [ns]. Shape (n,).
        wanted: [Hz].
    """
    expected = f"{wanted:.4g} Hz"
    intervals = np.diff(np.unique(stamp_ns))
    intervals = intervals[intervals >= PAIR]
    if len(intervals) < 3:
        return Row(name, expected, "too few different stamps", Verdict.FAIL, "see the stamps")
    typical = float(np.median(intervals))
    near = intervals[intervals < 1.5 * typical]  # stamps are on the grid of some other clock
    found = 1e9 / float(near.mean())
    missing = int(np.maximum(np.rint(intervals / typical) - 1, 0).sum())
    share = missing / (len(intervals) + 1 + missing)
    text = f"{found:.1f} Hz, {share:.1%} missing"
    off = abs(found / wanted - 1.0)
    if off > RATE_TOLERANCE:
        advice = f"set the driver to {wanted:.4g} Hz"
        advice += "; below 200 Hz torque control is not stable" if found < 200.0 < wanted else ""
        return Row(name, expected, text, Verdict.FAIL, advice)
    if off > RATE_NOTED or share > 0.05:
        return Row(name, expected, text, Verdict.WARN, "is the machine or the network busy?")
    return Row(name, expected, text, Verdict.OK)


def jitter(name: str, received_ns: np.ndarray, period: float) -> Row:
    """How regularly messages arrive here [period in s]; never a failure, this machine has a part.

    Args:
        name: Of the row.
        received_ns: Shape (n,).
        period: That is wanted [s].
    """
    expected = f"99 % within {2e3 * period:.4g} ms of the one before"
    gaps = np.diff(received_ns) * 1e-6  # [ms]
    if len(gaps) == 0:
        return Row(name, expected, "nothing to measure", Verdict.UNCHECKED)
    middle, most, worst = np.percentile(gaps, [50, 99, 100])
    text = f"median {middle:.2f}, 99 % {most:.2f}, worst {worst:.2f} ms"
    if most <= 2e3 * period:
        return Row(name, expected, text, Verdict.OK)
    return Row(name, expected, text, Verdict.WARN, "end other programs; wire instead of radio")


def stamps(name: str, stamp_ns: np.ndarray) -> Row:
    """Whether stamps are set and increase.

    Args:
        name: Of the row.
        stamp_ns: As sent, in order of arrival [ns]. Shape (n,).
    """
    expected = "set, each later than the one before"
    if len(stamp_ns) == 0:
        return Row(name, expected, "none", Verdict.UNCHECKED)
    steps = np.diff(stamp_ns)
    unset, back, same = (
        int((stamp_ns <= 0).sum()),
        int((steps < 0).sum()),
        int((steps == 0).sum()),
    )
    pairs = int(((steps > 0) & (steps < PAIR)).sum())
    if unset:
        return Row(
            name,
            expected,
            f"{unset} of {len(stamp_ns)} not set",
            Verdict.FAIL,
            "the driver must stamp its messages",
        )
    if same > 0.02 * len(stamp_ns):
        advice = (
            "the driver repeats itself; a stand-in in lockstep does: start it with pace real_time"
        )
        return Row(name, expected, f"{same} of {len(stamp_ns)} repeated", Verdict.FAIL, advice)
    if back > 0.02 * len(stamp_ns):
        advice = "two drivers on one topic, or a clock that is being set"
        return Row(name, expected, f"{back} of {len(stamp_ns)} go back", Verdict.FAIL, advice)
    if pairs > 0.1 * len(stamp_ns):
        text = f"{pairs} of {len(stamp_ns)} less than 1 ms after the one before"
        advice = "frames come in pairs and are stamped on receipt; one of each pair is used"
        return Row(name, expected, text, Verdict.WARN, advice)
    few = f"; {same + back} out of order" if same + back else ""
    return Row(name, expected, f"{len(stamp_ns)} in order{few}", Verdict.OK)


def clock(name: str, received_ns: np.ndarray, stamp_ns: np.ndarray) -> Row:
    """Of which clock the stamps are.

    Args:
        name: Of the row.
        received_ns: Shape (n,).
        stamp_ns: Shape (n,).
    """
    expected = "of this machine's system clock"
    if len(stamp_ns) == 0:
        return Row(name, expected, "nothing to measure", Verdict.UNCHECKED)
    age = float(np.median(received_ns - stamp_ns))
    text = f"received {age * 1e-6:.1f} ms after the stamp"
    if abs(age) <= CLOCK_NOTED:
        return Row(name, expected, text, Verdict.OK)
    advice = "synchronise the machines (chrony); arm and motion capture must share a clock"
    if age > 1e9 * 86_400 * 365:
        text, advice = "of a clock that began at its start", "the driver must stamp by system time"
    return Row(name, expected, text, Verdict.WARN, advice)


def publishers(name: str, type: str, ends: Sequence[Endpoint], latched: bool = False) -> Row:
    """Whether what others publish can be heard by our best-effort (or latched) subscription."""
    expected = f"{type}, {'reliable, latched' if latched else 'any reliability'}"
    text = ", ".join(sorted(f"{end.node}: {_qos(end)}" for end in ends)) or "no publisher"
    if not ends:
        return Row(name, expected, text, Verdict.UNCHECKED)
    if wrong := [end for end in ends if end.type != type]:
        text = ", ".join(f"{end.node}: {end.type}" for end in wrong)
        return Row(name, expected, text, Verdict.FAIL, "another type cannot be heard at all")
    if latched and not all(end.latched and end.reliable for end in ends):
        return Row(name, expected, text, Verdict.FAIL, "publish it reliable and transient local")
    if len(ends) > 1:
        advice = "each message is taken for the same device: is one of them another's?"
        return Row(name, expected, text, Verdict.WARN, advice)
    return Row(name, expected, text, Verdict.OK)


def _qos(end: Endpoint) -> str:
    return f"{'reliable' if end.reliable else 'best effort'}{', latched' if end.latched else ''}"


def offered(name: str, type: str, services: dict[str, str], wanted: str) -> Row:
    """Whether a service is there, of the right type; `services` are those of the graph."""
    if not wanted:
        return Row(
            name,
            "a service that idles the arm",
            "none configured",
            Verdict.WARN,
            "without one the arm is only carried when its states are lost",
        )
    found = services.get(wanted)
    if found == type:
        return Row(name, f"{wanted}, {type}", "offered", Verdict.OK)
    advice = 'name the service the driver has in idle_service, or "" for none'
    return Row(name, f"{wanted}, {type}", found or "not offered", Verdict.FAIL, advice)


def command_path(
    topic: str,
    type: str,
    drivers: Sequence[Endpoint],
    commanders: Sequence[Endpoint],
    count: int,
) -> Row:
    """Whether one driver listens to torques and nobody sends any.

    Args:
        topic: Of the torques.
        type: Their message type.
        drivers: Subscriptions to it that are not ours.
        commanders: Publishers on it that are not ours.
        count: Torques heard meanwhile.
    """
    expected = f"one driver listens on {topic}, {type}; nobody commands"
    text = f"heard by {', '.join(sorted(end.node for end in drivers)) or 'nobody'}"

    def row(found: str, result: Verdict, advice: str = "") -> Row:
        return Row("command path", expected, found, result, advice)

    if commanders:
        text += f"; {', '.join(sorted(end.node for end in commanders))} may command too"
        return row(text, Verdict.FAIL, "end it: the arm can follow one commander only")
    if count:
        advice = "deactivate the controller before checking"
        return row(f"{text}; {count} torques are being sent", Verdict.FAIL, advice)
    if not drivers:
        advice = "no driver takes torques: is its effort controller loaded and active?"
        return row(text, Verdict.FAIL, advice)
    if wrong := [end for end in drivers if end.type != type]:
        advice = "command_type of the configuration must be what the driver takes"
        return row(f"{wrong[0].node} wants {wrong[0].type}", Verdict.FAIL, advice)
    if any(end.latched for end in drivers):
        advice = "it asks for transient local, which torques never are"
        return row(f"{text}, latched", Verdict.FAIL, advice)
    if len(drivers) > 1:
        return row(text, Verdict.WARN, "which of them drives the arm?")
    return row(text, Verdict.OK)
