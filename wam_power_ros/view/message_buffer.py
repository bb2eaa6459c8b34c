# SPDX-License-Identifier: Apache-2.0
"""Viser's buffer of messages to browsers, made safe for messages from other threads.

Viser wakes the senders twice: through their event loop, and at once from the thread that adds a
message. The second iterates over the list of waiting senders while the loop changes it, and
sometimes raises "deque mutated during iteration".
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import dataclass, field

from viser.infra._async_message_buffer import AsyncMessageBuffer


class LoopEvent(asyncio.Event):
    """An event that only the thread of the event loop can set."""

    def set(self) -> None:
        """Wake the waiting senders in the thread of the loop; do nothing in another thread."""
        with suppress(RuntimeError):  # no loop runs in this thread
            asyncio.get_running_loop()
            super().set()


@dataclass
class MessageBuffer(AsyncMessageBuffer):
    """Viser's buffer, whose senders are woken by their event loop alone."""

    message_event: asyncio.Event = field(default_factory=LoopEvent)
