# SPDX-License-Identifier: Apache-2.0
"""Viser's buffer of messages to browsers, which threads other than the server's may fill.

Its own wakes the senders twice, by way of their event loop and at once from the thread that brings
a message. The latter goes through the list of those who wait while they enter and leave it, and
now and then ends in "deque mutated during iteration".
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import dataclass, field

from viser.infra._async_message_buffer import AsyncMessageBuffer


class LoopEvent(asyncio.Event):
    """An event that a thread without an event loop does not set: it asks the loop to."""

    def set(self) -> None:
        """Wake who waits, in the thread of the loop; without effect in another."""
        with suppress(RuntimeError):  # no loop runs in this thread
            asyncio.get_running_loop()
            super().set()


@dataclass
class MessageBuffer(AsyncMessageBuffer):
    """As viser's, woken by its event loop alone."""

    message_event: asyncio.Event = field(default_factory=LoopEvent)
