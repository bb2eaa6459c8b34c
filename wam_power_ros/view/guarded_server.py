# SPDX-License-Identifier: Apache-2.0
"""A viser server that refuses pages of another origin.

A browser lets any page open a websocket to this machine, but no other page may press buttons that
move an arm. A request with a foreign host name (DNS rebinding) or from a page of another origin is
refused with 403. Sharing through viser's public relay is switched off. A client that is no page is
told what becomes of its messages.
"""

from __future__ import annotations

import http
import io
import ipaddress
import logging
import re
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any

import viser
from viser import _messages
from viser.infra import _infra
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from wam_power_ros.view.message_buffer import MessageBuffer

PORT_MAX = 65535
_LOG = logging.getLogger(__name__)


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
    _answer_strangers(server)
    return server


def _answer_strangers(server: viser.ViserServer) -> None:
    """Tell clients that are not viser's page what becomes of their messages.

    Viser drops the presses of a client that has not sent its camera, and prints a traceback for
    each message that it cannot read, after which it drops the client.
    """
    websocket = server._websock_server

    def unheard(client_id: Any, message: _messages.GuiUpdateMessage) -> None:  # noqa: ANN401
        client = websocket._client_state_from_id.get(client_id)
        if client is None or client_id in server._connected_clients:
            return
        text = "not done: a client must send its camera first, as the page in a browser does"
        props = _messages.NotificationProps("wam-power", text, False, True, None, "red")
        client.message_buffer.push(_messages.NotificationShowMessage(message.uuid, props))

    def failed(_: object, context: Mapping[str, Any]) -> None:
        cause = context.get("exception") or context.get("message")
        _LOG.warning("message of a client ignored: %r", cause)

    websocket.register_handler(_messages.GuiUpdateMessage, unheard)
    loop = websocket._background_event_loop
    loop.call_soon_threadsafe(loop.set_exception_handler, failed)
    logging.getLogger("websockets.server").addFilter(_in_one_line)


def _in_one_line(record: logging.LogRecord) -> bool:
    """Replace the traceback of a failed connection by its error."""
    if record.exc_info:
        record.msg, record.args = "%s: %r", (record.getMessage(), record.exc_info[1])
        record.exc_info = record.exc_text = None
    return True


def close(server: viser.ViserServer) -> None:
    """Close a server."""
    with redirect_stdout(io.StringIO()):  # drops viser's farewell
        server.stop()


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
