# SPDX-License-Identifier: Apache-2.0
"""Rows of the conformance table, and the checks that apply to any topic or service.

The checks are pure functions from received samples to rows; `arm_checks` and `mocap_checks` have
the checks of these devices. Times are `int` nanoseconds; `received_ns` is by the system clock of
this machine.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np

RATE_ERROR_FAIL = 0.1  # relative error of a rate above which the check fails
RATE_ERROR_WARN = 0.03  # relative error of a rate above which the check warns
MAD_TO_SD = 1.4826  # standard deviation over median absolute deviation, of a normal distribution
STAMP_JITTER_MAX = 6e-4  # [s] standard deviation that the plausibility checks were shown to bear
PAIR_NS = 1_000_000  # [ns] stamps closer than this belong to one frame that was sent twice
CLOCK_ERROR_WARN = 100_000_000  # [ns] difference between a stamp and this machine's clock


class Verdict(Enum):
    """Result of a row."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    UNCHECKED = "not checked"


OK, WARN, FAIL, UNCHECKED = Verdict.OK, Verdict.WARN, Verdict.FAIL, Verdict.UNCHECKED


@dataclass(frozen=True)
class Row:
    """Result of one check.

    Attributes:
        name: Name of the check, unique in a table.
        verdict: Whether the measured value meets the requirement.
    """

    name: str
    expected: str
    found: str
    verdict: Verdict
    advice: str = ""


class Endpoint(NamedTuple):
    """Publisher or subscription of another node in the ROS graph."""

    node: str
    reliable: bool
    latched: bool


def accept(rows: Sequence[Row], names: Collection[str]) -> list[Row]:
    """Turn failures that a person has accepted by name into warnings.

    Raises:
        ValueError: No row has one of the names; the message lists the rows that fail.
    """
    if unknown := set(names) - {row.name for row in rows}:
        known = [row.name for row in rows if row.verdict is FAIL]
        raise ValueError(f"no row {sorted(unknown)} to accept; those that fail: {known}")
    return [
        replace(row, verdict=WARN, advice=f"accepted. {row.advice}")
        if row.name in names and row.verdict is FAIL
        else row
        for row in rows
    ]


def verdict(rows: Sequence[Row]) -> tuple[Verdict, str]:
    """Verdict on the whole table, and a sentence that names the rows responsible for it."""
    failed, warned, unchecked = (
        ", ".join(row.name for row in rows if row.verdict is kind)
        for kind in (FAIL, WARN, UNCHECKED)
    )
    if failed:
        return FAIL, f"DOES NOT CONFORM, do not move the arm: {failed}."
    remarks = f" Read first: {warned}." if warned else ""
    remarks += f" Not checked: {unchecked}." if unchecked else ""
    return (WARN, f"CONFORMS as far as checked.{remarks}") if remarks else (OK, "CONFORMS.")


def reception(
    name: str,
    topic: str,
    count: int,
    seconds: float,
    ends: Sequence[Endpoint],
    unmatched: Sequence[str],
) -> Row:
    """Whether `count` messages arrive in `seconds` [s]; `unmatched` says why from some none do."""
    found = f"{count} messages in {seconds:.1f} s from {_nodes(ends)}"
    advice = "start the driver, or configure the topic it publishes; is it on this ROS_DOMAIN_ID? "
    advice += "check ROS_AUTOMATIC_DISCOVERY_RANGE and firewalls if it is on another machine"
    advice = "its publishers cannot be received: see the row on QoS" if unmatched else advice
    result = (OK,) if count else (FAIL, advice)
    return Row(name, f"messages on {topic}", found, *result)


def rate(name: str, stamp_ns: np.ndarray, expected: float) -> Row:
    """Compare the rate of stamps (n,) [ns] with the expected rate [Hz], and count losses."""
    row = partial(Row, name, f"{expected:.4g} Hz")
    intervals = np.diff(np.unique(stamp_ns))
    intervals = intervals[intervals >= PAIR_NS]
    if len(intervals) < 3:
        return row("too few different stamps", FAIL, "see the stamps")
    typical = float(np.median(intervals))
    near = intervals[intervals < 1.5 * typical]  # averaged: stamps may have a coarse resolution
    found = 1e9 / float(near.mean())
    missing = int(np.maximum(np.rint(intervals / typical) - 1, 0).sum())
    share = missing / (len(intervals) + 1 + missing)
    text = f"{found:.1f} Hz, {share:.1%} missing"
    error = abs(found / expected - 1.0)
    if error > RATE_ERROR_FAIL:
        slow = "; below 200 Hz torque control is not stable" if found < 200.0 < expected else ""
        return row(text, FAIL, f"set the driver to {expected:.4g} Hz{slow}")
    if error > RATE_ERROR_WARN or share > 0.05:
        return row(text, WARN, "is the machine or the network busy?")
    return row(text, OK)


def jitter(name: str, received_ns: np.ndarray, period: float) -> Row:
    """Jitter of arrival at a period [s]; at most a warning, as this machine may be the cause."""
    row = partial(Row, name, f"99 % within {2e3 * period:.4g} ms of the previous one")
    gaps = np.diff(received_ns) * 1e-6  # [ms]
    if len(gaps) == 0:
        return row("nothing to measure", UNCHECKED)
    median, percentile, worst = np.percentile(gaps, [50, 99, 100])
    text = f"median {median:.2f}, 99 % {percentile:.2f}, worst {worst:.2f} ms"
    if percentile <= 2e3 * period:
        return row(text, OK)
    return row(text, WARN, "end other programs; use a cable instead of wireless")


def stamp_jitter(name: str, stamp_ns: np.ndarray) -> Row:
    """Jitter of stamps (n,) [ns] around a constant rate."""
    row = partial(Row, name, f"at most {STAMP_JITTER_MAX * 1e3:.1f} ms (standard deviation)")
    intervals = np.diff(np.unique(stamp_ns)) * 1e-9
    if len(intervals) < 3:
        return row("too few different stamps", UNCHECKED)
    # From the median, which lost messages do not change; an interval has the jitter of two stamps.
    spread = float(np.median(np.abs(intervals - np.median(intervals))))
    deviation = MAD_TO_SD * spread / math.sqrt(2.0)
    text = f"{deviation * 1e3:.2f} ms"
    if deviation <= STAMP_JITTER_MAX:
        return row(text, OK)
    advice = "a fast movement such as a flip may be stopped: stamp each state when it is measured"
    return row(text, WARN, advice)


def stamps(name: str, stamp_ns: np.ndarray) -> Row:
    """Whether stamps (n,) [ns], in order of arrival, are set and increase."""
    row = partial(Row, name, "set, each later than the previous one")
    total, steps = len(stamp_ns), np.diff(stamp_ns)
    if total == 0:
        return row("none", UNCHECKED)
    unset = int((stamp_ns <= 0).sum())
    back, same = int((steps < 0).sum()), int((steps == 0).sum())
    pairs = int(((steps > 0) & (steps < PAIR_NS)).sum())
    if unset:
        return row(f"{unset} of {total} not set", FAIL, "the driver must stamp its messages")
    if same > 0.02 * total:
        advice = "the driver repeats messages; for stand-ins in lockstep set pace: real_time"
        return row(f"{same} of {total} repeated", FAIL, advice)
    if back > 0.02 * total:
        advice = "two drivers on one topic, or a clock that is being adjusted"
        return row(f"{back} of {total} go back", FAIL, advice)
    if pairs > 0.1 * total:
        text = f"{pairs} of {total} less than 1 ms after the previous one"
        advice = "frames come in pairs and are stamped on receipt; one of each pair is used"
        return row(text, WARN, advice)
    exceptions = f"; {same + back} out of order" if same + back else ""
    return row(f"{total} in order{exceptions}", OK)


def clock(name: str, received_ns: np.ndarray, stamp_ns: np.ndarray) -> Row:
    """Whether stamps (n,) [ns] are by the system clock, from their times of arrival (n,) [ns]."""
    row = partial(Row, name, "of this machine's system clock")
    if len(stamp_ns) == 0:
        return row("nothing to measure", UNCHECKED)
    age = float(np.median(received_ns - stamp_ns))
    text = f"received {age * 1e-6:.1f} ms after the stamp"
    if abs(age) <= CLOCK_ERROR_WARN:
        return row(text, OK)
    if age > 1e9 * 86_400 * 365:
        return row("of a clock that began at its start", WARN, "the driver must use system time")
    advice = "synchronise the machines (chrony); arm and motion capture must share a clock"
    return row(text, WARN, advice)


def publishers(name: str, kind: str, ends: Sequence[Endpoint], unmatched: Sequence[str]) -> Row:
    """Whether our subscription matches all publishers; `unmatched` says why some it does not."""
    row = partial(Row, name, f"{kind}, any reliability")
    text = ", ".join(sorted(f"{end.node}: {_qos(end)}" for end in ends)) or "no publisher"
    if not ends:
        return row(text, UNCHECKED)
    if unmatched:
        advice = (
            "configure the topic of a driver that publishes this type; of a motion capture set "
        )
        advice += "message_type to what it publishes"
        return row("; ".join(unmatched), FAIL, advice)
    if len(ends) > 1:
        return row(text, WARN, "messages are used as from one device: does one belong to another?")
    return row(text, OK)


def _qos(end: Endpoint) -> str:
    return f"{'reliable' if end.reliable else 'best effort'}{', latched' if end.latched else ''}"


def _nodes(ends: Sequence[Endpoint]) -> str:
    return ", ".join(sorted(end.node for end in ends)) or "nobody"


def service(name: str, kind: str, services: dict[str, str], configured: str) -> Row:
    """Whether the configured service is among `services` (name -> type) and has the right type."""
    if not configured:
        advice = "without one, loss of states only leads to braking and gravity compensation"
        return Row(name, "a service that idles the arm", "none configured", WARN, advice)
    row, found = partial(Row, name, f"{configured}, {kind}"), services.get(configured)
    if found == kind:
        return row("offered", OK)
    advice = 'set idle_service to the service of the driver, or to "" for none'
    return row(found or "not offered", FAIL, advice)


def command_path(
    topic: str,
    kind: str,
    drivers: Sequence[Endpoint],
    commanders: Sequence[Endpoint],
    count: int,
    unmatched: Sequence[str],
) -> Row:
    """Whether one driver subscribes to torques and no node publishes them.

    Args:
        drivers: Subscriptions of other nodes.
        commanders: Publishers of other nodes.
        unmatched: Sentence on each driver that cannot receive torques of this type and QoS.
    """
    expected = f"one driver subscribes to {topic}, {kind}; nobody publishes"
    row, text = partial(Row, "command path", expected), f"received by {_nodes(drivers)}"
    if commanders:
        advice = "end it: the arm can follow one commander only"
        return row(f"{text}; {_nodes(commanders)} may command too", FAIL, advice)
    if count:
        advice = "deactivate the controller before checking"
        return row(f"{text}; {count} torques are being sent", FAIL, advice)
    if not drivers:
        advice = "no driver receives torques: is its effort controller loaded and active?"
        return row(text, FAIL, advice)
    if unmatched:
        advice = "set command_type to the driver's message type; let it subscribe as volatile"
        return row("; ".join(unmatched), FAIL, advice)
    if len(drivers) > 1:
        return row(text, WARN, "which of them drives the arm?")
    return row(text, OK)


def torque_order(
    driver: str,
    joints: Sequence[str],
    interface: str,
    joint_names: Sequence[str],
    expected: str = "effort",
) -> Row:
    """Whether a ros2_control forwarder passes on commands, in the order in which they are sent.

    Args:
        driver: Name of the node that receives the torques.
        joints: Its parameter `joints`; empty if it has none.
        interface: Its parameter `interface_name`; empty if it has none.
        joint_names: Order in which commands are sent.
        expected: Its interface for them, "effort" or "position".
    """
    row = partial(Row, "torque order", f"{' '.join(joint_names)}, as {expected}")
    if not joints:
        advice = "not a forwarder of ros2_control: compare the driver's order with joint_names"
        return row(f"{driver} has no parameter joints", UNCHECKED, advice)
    text = f"{driver}: {' '.join(joints)}{f', as {interface}' if interface else ''}"
    if tuple(joints) != tuple(joint_names):
        advice = "commands would act on other joints: set joints of that controller to joint_names"
        return row(text, FAIL, advice)
    if interface not in ("", expected):
        return row(text, FAIL, f"set interface_name of that controller to {expected}")
    return row(text, OK)


def pose_frames(driver: str, frames: Sequence[str], expected: Sequence[str]) -> Row:
    """Whether a driver's base and tool frame, empty if it has no such parameters, are ours."""
    row = partial(Row, "pose frames", f"base {expected[0]}, tool {expected[1]}")
    if not frames:
        advice = "compare the driver's frames with base_frame and tool_frame"
        return row(f"{driver} has no parameters of its frames", UNCHECKED, advice)
    text = f"{driver}: base {frames[0]}, tool {frames[1]}"
    if tuple(frames) == tuple(expected):
        return row(text, OK)
    advice = "it would ignore poses, or lead another point: set base_frame and tool_frame to these"
    return row(text, FAIL, advice)
