# SPDX-License-Identifier: Apache-2.0
"""A Trigger service whose answer comes when the movement it asked for is over.

The events executor of Jazzy awaits no coroutine, and a callback that waits would stop the 500 Hz
loop; so the request's header is kept and answered later, from another callback of the same thread.
"""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_srvs.srv import Trigger


class DeferredTrigger:
    """Calls `begin` on a request; a text it returns is a refusal, answered at once."""

    def __init__(self, node: Node, name: str, begin: Callable[[], str | None]) -> None:
        self._begin = begin
        self._headers: list[object] = []
        self._service = node.create_service(Trigger, name, self._called)
        self._send_response = self._service.send_response
        self._service.send_response = self._send_or_keep

    @property
    def pending(self) -> bool:
        """Whether a request waits for `finish`."""
        return bool(self._headers)

    def finish(self, success: bool, text: str) -> None:
        """Answer every request that waits."""
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
