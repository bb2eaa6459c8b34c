# SPDX-License-Identifier: Apache-2.0
"""A viser server that refuses pages of another origin.

A browser lets any page open a websocket to this machine, but no other page may press buttons that
move an arm. Viser has no option for it, so it listens at a loopback address that nobody can guess
(one of 10^11, with its port), and a relay in front of it refuses a request with a foreign host name
(DNS rebinding) or from a page of another origin with 403. Viser's public relay is switched off.
"""

from __future__ import annotations

import asyncio
import errno
import io
import ipaddress
import re
import secrets
import socket
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from email.parser import BytesHeaderParser
from typing import TypeVar

import viser

PORT_MAX = 65535
HEAD_TIMEOUT = 10.0  # [s of wall time] for the head of a request
CHUNK = 65536  # [byte]
ENDED = (OSError, EOFError, asyncio.LimitOverrunError, asyncio.TimeoutError)  # of a connection
T = TypeVar("T")


def refusal(host: str | None, origin: str | None) -> str:
    """Reason to refuse a request with these Host and Origin headers; "" for none."""
    name = re.sub(r":\d+$", "", host or "").strip("[]").lower()
    ours = name in {"localhost", socket.gethostname().lower(), socket.getfqdn().lower()}
    with suppress(ValueError):
        ipaddress.ip_address(name)
        ours = True
    if not ours:
        return f"host {host!r} is not this machine"
    return "" if origin in (None, f"http://{host}") else f"origin {origin!r} is not this page"


class GuardedServer(viser.ViserServer):
    """A server at an address, on the first free port from `port` on.

    Raises:
        ValueError: The address is not one of this machine, or no such port is free.
    """

    def __init__(self, address: str, port: int) -> None:
        listening = _listening(address, port)
        hidden = ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])
        with redirect_stdout(io.StringIO()):  # drops viser's banner
            super().__init__(host=hidden, port=0, label="wam_power_ros", verbose=False)
        self._behind = hidden, super().get_port()
        self._relays: set[asyncio.Task] = set()
        starting = asyncio.start_server(self._relay, sock=listening)
        self._front = asyncio.run_coroutine_threadsafe(starting, self.get_event_loop()).result()

    def get_port(self) -> int:
        """Port of the page."""
        return self._front.sockets[0].getsockname()[1]

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing: the page is never shared through viser's public relay."""

    def draw(self, work: Callable[[], T]) -> T:
        """Do work in the thread of the event loop and return its result.

        Viser's messages to browsers are sent by this thread, and sometimes raise "deque mutated
        during iteration" where another thread adds one.
        """

        async def run() -> T:
            return work()

        return asyncio.run_coroutine_threadsafe(run(), self.get_event_loop()).result()

    def stop(self) -> None:
        """Close the server and all connections."""

        def close() -> None:
            self._front.close()
            for relay in self._relays:
                relay.cancel()

        self.draw(close)
        with redirect_stdout(io.StringIO()):  # drops viser's farewell
            super().stop()

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Check the head of a connection's request, then pass everything on."""
        self._relays.add(task := asyncio.current_task())
        task.add_done_callback(self._relays.discard)
        with suppress(*ENDED, asyncio.CancelledError):
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_TIMEOUT)
            headers = BytesHeaderParser().parsebytes(head.partition(b"\r\n")[2])
            if reason := refusal(headers["Host"], headers["Origin"]):
                text = f"HTTP/1.1 403 Forbidden\r\nConnection: close\r\n\r\n{reason}"
                writer.write(text.encode())
            else:
                answers, requests = await asyncio.open_connection(*self._behind)
                requests.write(head)
                await asyncio.gather(_pass(reader, requests), _pass(answers, writer))
        writer.close()


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(*ENDED):
        while chunk := await reader.read(CHUNK):
            writer.write(chunk)
            await writer.drain()
    writer.close()


def _listening(address: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    for each in range(port, PORT_MAX + 1):
        try:
            return socket.create_server((address, each), family=family)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise ValueError(f"address {address!r} is not one of this machine") from None
    raise ValueError(f"no port from {port} to {PORT_MAX} is free; choose a lower one")
