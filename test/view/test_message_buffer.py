# SPDX-License-Identifier: Apache-2.0
"""Messages to browsers from threads other than the server's."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator

import pytest

pytest.importorskip("viser", reason="no viser")

from viser import _messages

from wam_power_ros.view.guarded_server import open_server
from wam_power_ros.view.message_buffer import MessageBuffer


def message(name: str) -> _messages.Message:
    """A message that replaces no other: the buffer keeps one message per name."""
    return _messages.SetSceneNodeVisibilityMessage(name, True)


@pytest.fixture
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    yield loop
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
    loop.close()


def test_a_message_of_another_thread_wakes_senders_in_their_own_thread_alone(
    loop: asyncio.AbstractEventLoop,
) -> None:
    async def make() -> MessageBuffer:
        return MessageBuffer(loop, persistent_messages=True)

    def let_it_run() -> None:
        asyncio.run_coroutine_threadsafe(asyncio.sleep(0.02), loop).result()

    buffer = asyncio.run_coroutine_threadsafe(make(), loop).result()
    waiting = asyncio.run_coroutine_threadsafe(buffer.message_event.wait(), loop)
    let_it_run()
    buffer.atomic_start()  # the loop is not woken before its end
    buffer.push(message("/arm"))
    let_it_run()
    assert not waiting.done()
    buffer.atomic_end()
    assert waiting.result(60.0)


def test_messages_of_many_threads_all_arrive(loop: asyncio.AbstractEventLoop) -> None:
    arrived = threading.Event()
    count = 0

    async def make() -> MessageBuffer:
        return MessageBuffer(loop, persistent_messages=True, window_duration_sec=0.0)

    async def send() -> None:
        nonlocal count
        async for window in buffer.window_generator(0):
            count += len(window)
            if count == 800:
                arrived.set()

    buffer = asyncio.run_coroutine_threadsafe(make(), loop).result()
    sending = asyncio.run_coroutine_threadsafe(send(), loop)

    def fill(number: int) -> None:
        for k in range(200):
            buffer.push(message(f"/{number}/{k}"))

    threads = [threading.Thread(target=fill, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert arrived.wait(60.0)
    buffer.set_done()
    sending.result(60.0)


def test_the_server_of_the_page_has_such_a_buffer() -> None:
    server = open_server("127.0.0.1", 0)
    try:
        assert isinstance(server._websock_server._broadcast_buffer, MessageBuffer)
    finally:
        server.stop()
