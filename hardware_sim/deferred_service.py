# SPDX-License-Identifier: Apache-2.0
"""Trigger service that is answered when the requested movement has ended.

The events executor of Jazzy awaits no coroutine, and a callback that waits would block the 500 Hz
loop; so the request's header is kept and answered later, from another callback of the same thread.
"""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_srvs.srv import Trigger


class DeferredTrigger:
    """Calls `begin` at each request; if it returns a text, that refuses the request at once."""

    def __init__(self, node: Node, name: str, begin: Callable[[], str | None]) -> None:
        self._begin = begin
        self._headers: list[object] = []
        self._service = node.create_service(Trigger, name, self._called)
        self._send_response = self._service.send_response
        self._service.send_response = self._send_or_keep

    @property
    def pending(self) -> bool:
        """True while a request waits for `finish`."""
        return bool(self._headers)

    def finish(self, success: bool, text: str) -> None:
        """Answer all pending requests."""
        headers, self._headers = self._headers, []
        for header in headers:
            self._send_response(Trigger.Response(success=success, message=text), header)

    def _called(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response | None:
        refusal = self._begin()
        if refusal is None:
            return None
        response.success, response.message = False, refusal
        return response

    def _send_or_keep(self, response: Trigger.Response | None, header: object) -> None:
        if response is None:
            self._headers.append(header)
        else:
            self._send_response(response, header)
