# SPDX-License-Identifier: Apache-2.0
"""Action whose goals end in another callback of the same thread, with a reason if refused.

Every goal is accepted, because a goal that is rejected has no result that could say why. No
coroutine is used: the events executor of Jazzy awaits none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from wam_power_ros.ros import outcomes
from wam_power_ros.ros.outcomes import Answer, Code


class Action:
    """Server of one action; `under_way` has its goals that have not ended by id, oldest first.

    Args:
        begin: Called with the id and the goal; returns the answer that ends it, or None if `finish`
            will be called. A ValueError that it raises refuses.
        cancel: Called with the id of a goal that its sender cancels; without it none can be.
        result: Makes the result of an answer and of the fields given to `finish`.
    """

    def __init__(
        self,
        node: Node,
        kind: Any,  # noqa: ANN401 - any action
        name: str,
        begin: Callable[[str, Any], Answer | None],
        cancel: Callable[[str], object] | None = None,
        result: Callable[..., object] | None = None,
    ) -> None:
        self._kind, self._begin, self._cancel, self._log = kind, begin, cancel, node.get_logger()
        self._result = result or self._outcome
        self.under_way: dict[str, ServerGoalHandle] = {}
        self._server = ActionServer(
            node,
            kind,
            name,
            execute_callback=lambda handle: kind.Result(),  # `finish` gives another
            handle_accepted_callback=self._accepted,
            cancel_callback=self._cancelled,
        )

    def _outcome(self, answer: Answer, **more: Any) -> object:  # noqa: ANN401 - of the result
        return self._kind.Result(outcome=outcomes.message(answer), **more)

    def _accepted(self, handle: ServerGoalHandle) -> None:
        id = bytes(handle.goal_id.uuid).hex()
        self.under_way[id] = handle
        try:
            answer = self._begin(id, handle.request)
        except ValueError as error:
            answer = Answer(Code.REFUSED, str(error))
        if answer is not None:
            self.finish(id, answer)

    def _cancelled(self, handle: ServerGoalHandle) -> CancelResponse:
        id = bytes(handle.goal_id.uuid).hex()
        if self._cancel is None or id not in self.under_way:
            return CancelResponse.REJECT
        self._cancel(id)
        return CancelResponse.ACCEPT

    def report(self, id: str, stage: str) -> None:
        """Tell the sender of a goal under way its stage, if its feedback has one."""
        feedback = self._kind.Feedback()
        if id in self.under_way and hasattr(feedback, "stage"):
            feedback.stage = stage
            self.under_way[id].publish_feedback(feedback)

    def finish(self, id: str, answer: Answer, **more: Any) -> bool:  # noqa: ANN401 - of the result
        """End a goal; returns False if none of this id is under way."""
        handle = self.under_way.pop(id, None)
        if handle is None:
            return False
        if answer.code is Code.BUSY:  # its sender tries again
            self._log.info(f"{answer.code.value}: {answer.text}", throttle_duration_sec=1.0)
        elif not answer.success:
            self._log.warning(f"{answer.code.value}: {answer.text}", throttle_duration_sec=1.0)
        result = self._result(answer, **more)

        def end(handle: ServerGoalHandle) -> object:
            if answer.success:
                handle.succeed()
            elif handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
            return result

        handle.execute(end)
        return True
