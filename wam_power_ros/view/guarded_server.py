# SPDX-License-Identifier: Apache-2.0
"""A viser server that a page of another origin cannot use.

A browser lets any page open a websocket to this machine; buttons that move an arm must not be in
its reach. What names the server by another host name than ours (DNS rebinding) or comes from a page
of another origin is refused with 403. Sharing through viser's public relay is switched off.
"""

from __future__ import annotations

import http
import io
import ipaddress
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any

import viser
from viser import _messages
from viser.infra import _infra
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from wam_power_ros.view.message_buffer import MessageBuffer

PORTS = 65536


def refusal(host: str | None, origin: str | None) -> str:
    """Reason to refuse a request by its Host and Origin headers; empty for none."""
    name = re.sub(r":\d+$", "", host or "").strip("[]").lower()
    ours = name in {"localhost", socket.gethostname().lower(), socket.getfqdn().lower()}
    with suppress(ValueError):
        ipaddress.ip_address(name)
        ours = True
    if not ours:
        return f"host {host!r} is not this machine"
    return "" if origin in (None, f"http://{host}") else f"origin {origin!r} is not this page"


def open_server(address: str, port: int) -> viser.ViserServer:
    """A server at an address; the port is the first free one from `port` on.

    Raises:
        ValueError: The address is none of this machine, or there is no such port free.
    """
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    if not _free(family, address, 0):
        raise ValueError(f"address {address!r} is none of this machine")
    free = next((each for each in range(port, PORTS) if _free(family, address, each)), None)
    if free is None:  # viser would wait for ever
        raise ValueError(f"port {port}: there is no free one from there to {PORTS - 1}")
    _infra.AsyncMessageBuffer = MessageBuffer  # of all browsers, and later of each one
    with _refusing(), redirect_stdout(io.StringIO()):  # its banner names no address but its own
        server = viser.ViserServer(host=address, port=free, label="wam_power_ros", verbose=False)
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server._incoming_handlers.pop(message, None)
    return server


def _free(family: socket.AddressFamily, address: str, port: int) -> bool:
    """Whether a port, any if 0, can be bound at an address."""
    with socket.socket(family) as probe, suppress(OSError):
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # one that was just closed
        probe.bind((address, port))
        return True
    return False


@contextmanager
def _refusing() -> Iterator[None]:
    """Give viser's web server, which has no option for it, the check of every request."""
    web = _infra.websockets.asyncio.server
    serve = web.serve

    def guarded(*args: Any, process_request: Callable, **options: Any) -> Any:  # noqa: ANN401
        def check(connection: Any, request: Request) -> Response | None:  # noqa: ANN401
            why = refusal(request.headers.get("Host"), request.headers.get("Origin"))
            if why:
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", Headers(), why.encode())
            return process_request(connection, request)

        return serve(*args, process_request=check, **options)

    web.serve = guarded
    try:
        yield
    finally:
        web.serve = serve
