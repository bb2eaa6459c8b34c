# SPDX-License-Identifier: Apache-2.0
"""Stamps of messages <-> nanoseconds (int)."""

from __future__ import annotations

from builtin_interfaces.msg import Time


def nanoseconds(time: Time) -> int:
    """Stamp of a message [ns]."""
    return time.sec * 1_000_000_000 + time.nanosec


def time_message(stamp_ns: int) -> Time:
    """Stamp [ns] as a message."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def sensor_stamp(message: object) -> int:
    """Stamp of a sensor message [ns].

    Raises:
        ValueError: When the stamp is not set: such messages cannot be put in order.
    """
    return checked_stamp(nanoseconds(message.header.stamp))


def checked_stamp(stamp_ns: int) -> int:
    """Return the stamp of a sensor message [ns] if it is set.

    Raises:
        ValueError: When it is not set.
    """
    if stamp_ns <= 0:
        raise ValueError(f"stamp is {stamp_ns} ns; the driver must stamp its messages")
    return stamp_ns
