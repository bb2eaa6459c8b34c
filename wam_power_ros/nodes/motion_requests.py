# SPDX-License-Identifier: Apache-2.0
"""Services that move the arm: carried out after earlier messages are read, answered at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from rclpy.node import Node
from std_srvs.srv import Trigger

from wam_power_ros.control.controller import Controller
from wam_power_ros.control.joint_references import Sampled
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code
from wam_power_ros.ros.deferred_service import DeferredTrigger

NOT_ACTIVE = Answer(Code.NOT_ACTIVE, "refused: the controller is not active")


def attempt(core: Controller | None, request: Callable[[Controller], None]) -> Answer:
    """Make a request; the answer has the id of the loaded policy, or the reason for a refusal.

    Args:
        core: Controller, None when it is not active.
        request: Makes the request; raises ControllerError when it is refused.
    """
    if core is None:
        return NOT_ACTIVE
    try:
        request(core)
    except ControllerError as error:
        return Answer(Code(error.refusal.value), str(error), error.values)
    return done(core.policy_id)


def done(policy_id: str | None) -> Answer:
    """Answer to a request that was done, with the id of the loaded policy."""
    return Answer(Code.DONE, values={"policy": policy_id} if policy_id else {})


def fill(response: Trigger.Response, answer: Answer) -> Trigger.Response:
    """Write an answer into a response."""
    response.success, response.message = answer.success, str(answer)
    return response


class MotionRequests:
    """Requests for rollouts, moves to the start and replays, and their answers.

    Attributes:
        movement: Movement to replay, or why it cannot be replayed; None when none has come.
        digest: Digest of the loaded policy, see `policy.digest`; empty before the first.
        executed: Digest of the policy that was executed last.

    Args:
        node: Node that offers the services.
        joint_names: Names of the joints, for the summary of a replay.
        active: Returns the controller, None when it is not active.
        when_read: Calls a function once all messages published before have been read, see
            `Preparation.when_read`.
    """

    def __init__(
        self,
        node: Node,
        joint_names: Sequence[str],
        active: Callable[[], Controller | None],
        when_read: Callable[[Callable[[str | None], None]], None],
    ) -> None:
        self._node, self._joint_names = node, joint_names
        self._active, self._when_read = active, when_read
        self.movement: Sampled | ControllerError | None = None
        self.digest = self.executed = ""
        self._move_done = done(None)  # names the policy to whose start the arm was last sent
        self._moving: list[DeferredTrigger] = []  # services whose movement has begun
        self._execute = self._serve_in_order(interface.EXECUTE, self._begin_rollout)
        self._move = self._serve_in_order(interface.MOVE_TO_START, self._begin_move)
        self._replay = self._serve_in_order(interface.REPLAY, self._begin_replay)

    def answer(self, core: Controller) -> None:
        """Answer the requests for a movement once the arm rests or the movement was aborted."""
        if not self._moving:
            return
        mode = core.mode
        if mode in (Mode.MOVE_TO_START, Mode.REPLAY) or (mode is Mode.HOLD and not core.at_rest):
            return
        if core.latched is not None:
            failed = Answer(Code.FAULT, f"failed: {core.latched.text}")
        else:
            failed = Answer(Code.STOPPED, f"failed: mode is {mode.value}")
        # The move's policy: another one, with a start nearby, may have come since.
        if self._move in self._moving:
            answer = self._move_done if core.ready else failed
            self._move.finish(answer.success, str(answer))
        if self._replay in self._moving:
            answer = Answer(Code.DONE, self._summary(core)) if mode is Mode.HOLD else failed
            self._replay.finish(answer.success, str(answer))
        self._moving.clear()

    def stop(self, core: Controller | None) -> None:
        """Answer all pending requests: a person has stopped the arm."""
        summary = self._summary(core) if self._replay in self._moving else ""
        self._replay.finish(False, str(Answer(Code.STOPPED, f"stopped\n{summary}".rstrip())))
        for service in (self._execute, self._move):
            service.finish(False, str(Answer(Code.STOPPED, "stopped")))
        self._moving.clear()

    def refuse(self) -> None:
        """Answer all pending requests: the controller is not active any more."""
        for service in (self._execute, self._move, self._replay):
            service.finish(False, str(NOT_ACTIVE))

    def _serve_in_order(self, name: str, begin: Callable[[], Answer | None]) -> DeferredTrigger:
        """Service whose request is made once earlier policies and movements have been read.

        Args:
            name: Name of the service.
            begin: Makes the request; returns the answer, or None when `answer` will give it.
        """

        def called() -> str | None:
            if self._active() is None:
                return str(NOT_ACTIVE)
            if service.pending:
                return str(Answer(Code.BUSY, "refused: the previous request is under way"))
            self._when_read(ready)
            return None

        def ready(problem: str | None) -> None:
            answer = begin() if problem is None else Answer(Code.BUSY, f"refused: {problem}")
            if answer is None:
                self._moving.append(service)
            else:
                service.finish(answer.success, str(answer))

        service = DeferredTrigger(self._node, name, called)
        return service

    def _begin_rollout(self) -> Answer:
        answer = attempt(self._active(), Controller.execute)
        if answer.success:
            self.executed = self.digest
        return self._with_digest(answer)

    def _begin_move(self) -> Answer | None:
        answer = attempt(self._active(), Controller.move_to_start)
        self._move_done = self._with_digest(answer)
        return None if answer.success else answer

    def _with_digest(self, answer: Answer) -> Answer:
        """Add the digest of the loaded policy to an answer that has its id."""
        known = answer.success and "policy" in answer.values and self.digest
        return replace(answer, values={**answer.values, "digest": self.digest}) if known else answer

    def _begin_replay(self) -> Answer | None:
        movement = self.movement
        if movement is None:
            text = f"refused: no valid trajectory has come on {interface.REPLAY_TRAJECTORY}"
            return Answer(Code.NOTHING, text)

        def start(core: Controller) -> None:
            if isinstance(movement, ControllerError):
                raise movement
            core.start_replay(movement)

        answer = attempt(self._active(), start)
        return None if answer.success else answer

    def _summary(self, core: Controller | None) -> str:
        """Tracking error of the last replay, as text."""
        error = None if core is None else core.replay_error
        return "" if error is None or not error.count else error.text(self._joint_names)
