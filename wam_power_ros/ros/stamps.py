# SPDX-License-Identifier: Apache-2.0
"""Stamps of messages and goals <-> nanoseconds (int)."""

from __future__ import annotations

import random
import time
import uuid

from builtin_interfaces.msg import Time
from unique_identifier_msgs.msg import UUID

UUID_EPOCH = 0x01B21DD213814000  # [100 ns] from that of UUIDs to that of Unix


def nanoseconds(stamp: Time) -> int:
    """Stamp of a message [ns]."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def time_message(stamp_ns: int) -> Time:
    """Stamp [ns] as a message."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def sensor_stamp(message: object) -> int:
    """Stamp of a sensor message [ns], see `checked_stamp`."""
    return checked_stamp(nanoseconds(message.header.stamp))


def checked_stamp(stamp_ns: int) -> int:
    """Return the stamp of a sensor message [ns]; a ValueError if it is not set."""
    if stamp_ns <= 0:
        raise ValueError(f"stamp is {stamp_ns} ns; the driver must stamp its messages")
    return stamp_ns


def goal_id() -> UUID:
    """Id of a goal that is sent now: a UUID of version 1, which contains the time."""
    return UUID(uuid=list(uuid.uuid1(node=random.getrandbits(48)).bytes))


def sent_ns(goal: str) -> int:
    """When a goal was sent [ns of wall time]: now at the latest, and if its id does not say."""
    id, now = uuid.UUID(hex=goal), time.time_ns()
    return min((id.time - UUID_EPOCH) * 100, now) if id.version == 1 else now
