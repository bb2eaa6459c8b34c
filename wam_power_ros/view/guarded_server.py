# SPDX-License-Identifier: Apache-2.0
"""A viser server that refuses pages of another origin.

A browser lets any page open a websocket to this machine, but no other page may press buttons that
move an arm. A request with a foreign host name (DNS rebinding) or from a page of another origin is
refused with 403. Sharing through viser's public relay is switched off.
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

PORT_MAX = 65535


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


def open_server(address: str, port: int) -> viser.ViserServer:
    """Open a server at an address, on the first free port from `port` on.

    Raises:
        ValueError: The address is not one of this machine, or no such port is free.
    """
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    if not _free(family, address, 0):
        raise ValueError(f"address {address!r} is not an address of this machine")
    ports = range(port, PORT_MAX + 1)
    free = next((each for each in ports if _free(family, address, each)), None)
    if free is None:  # viser would wait for ever
        raise ValueError(f"no port from {port} to {PORT_MAX} is free; choose a lower one")
    _infra.AsyncMessageBuffer = MessageBuffer  # for all browsers, and later for each one
    with _refusing(), redirect_stdout(io.StringIO()):  # drops viser's banner
        server = viser.ViserServer(host=address, port=free, label="wam_power_ros", verbose=False)
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server._incoming_handlers.pop(message, None)
    return server


def _free(family: socket.AddressFamily, address: str, port: int) -> bool:
    """Whether a port (0: any port) can be bound at an address."""
    with socket.socket(family) as probe, suppress(OSError):
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # also if just closed
        probe.bind((address, port))
        return True
    return False


@contextmanager
def _refusing() -> Iterator[None]:
    """Make viser's web server check every request; viser has no option for it."""
    web = _infra.websockets.asyncio.server
    serve = web.serve

    def guarded(*args: Any, process_request: Callable, **options: Any) -> Any:  # noqa: ANN401
        def check(connection: Any, request: Request) -> Response | None:  # noqa: ANN401
            reason = refusal(request.headers.get("Host"), request.headers.get("Origin"))
            if reason:
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", Headers(), reason.encode())
            return process_request(connection, request)

        return serve(*args, process_request=check, **options)

    web.serve = guarded
    try:
        yield
    finally:
        web.serve = serve
