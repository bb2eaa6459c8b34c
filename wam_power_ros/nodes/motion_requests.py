# SPDX-License-Identifier: Apache-2.0
"""Requests that move the arm, one at a time, and the answers when it rests again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from std_srvs.srv import Trigger

from wam_power_ros.control.controller import Controller
from wam_power_ros.control.joint_references import Sampled
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.learning.dmp import TabulatedPolicy
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.ros.answers import NOT_ACTIVE, Answer, Code
from wam_power_ros.ros.requests import RolloutEnd

KEPT = 16  # last answers, for a request that comes again after the preparation process has ended
STOPPED = "stopped by a person"


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
    return Answer(Code.DONE, values={"policy": core.policy_id} if core.policy_id else {})


def fill(response: Trigger.Response, answer: Answer) -> Trigger.Response:
    """Write an answer into a response."""
    response.success, response.message = answer.success, str(answer)
    return response


class MotionRequests:
    """Requests for rollouts, moves to the start and replays.

    Attributes:
        last_stop: Id of the last act by which a person ended a movement or took the arm, its time
            [ns of wall time]; "" before the first.

    Args:
        joint_names: Names of the joints, for the summary of a replay.
        active: Returns the controller, None when it is not active.
        give: Sends the answer to the request of an id.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        active: Callable[[], Controller | None],
        give: Callable[[str, Answer], None],
    ) -> None:
        self._joint_names, self._active, self._send = joint_names, active, give
        self._given: dict[str, Answer] = {}  # last answers by id
        self._id = self._do = ""  # request under way; "" for none
        self._begin_ns = 0  # wall time; what was sent before is not begun
        self.last_stop = ""
        self._by_person = False  # has ended the request under way

    def begin(
        self,
        id: str,
        do: str,
        about: TabulatedPolicy | Sampled,
        sent_ns: int,
        known_stop: str | None = None,
    ) -> None:
        """Begin a movement and answer that it has begun, or why not.

        A request that comes again is answered as before: nothing is done twice.

        Args:
            id: Id of the request.
            do: "move_to_start" or "execute" a policy, or "replay" a movement.
            about: The policy or the movement.
            sent_ns: Time at which the request was sent, by the clock of its sender [ns].
            known_stop: Last stop that its sender knows, after which a person has let it go on; None
                for a sender who is a person. A request that does not know of the last stop is not
                begun, so that no stop can be overtaken.
        """
        if id in self._given:
            return self._send(id, self._given[id])

        def start(core: Controller) -> None:
            if do == "replay":
                return core.start_replay(about)
            core.load_prepared(about)
            return core.execute() if do == "execute" else core.move_to_start()

        if known_stop is not None and self.last_stop not in ("", known_stop):
            return self._give(id, self._stopped())
        if sent_ns < self._begin_ns:
            text = "sent before the last stop, reset or activation, by the clock of its sender"
            stop = self.last_stop if self.last_stop == str(self._begin_ns) else ""
            return self._give(id, Answer(Code.STOPPED, text, {"stop": stop}))
        if self._id:
            return self.refuse(id, "the previous request is under way")
        answer = attempt(self._active(), start)
        if answer.success:
            self._id, self._do, self._by_person = id, do, False
            answer = replace(answer, code=Code.BEGUN)
        return self._give(id, answer)

    def expire(self) -> None:
        """Begin nothing any more that was sent before now, also what is still being read.

        A person who stops the arm, takes it in the hand, resets a fault or activates the controller
        does not expect it to move on an earlier request.
        """
        self._begin_ns = time.time_ns()

    def refuse(self, id: str, reason: str) -> None:
        """Refuse a request for now."""
        self._give(id, Answer(Code.BUSY, f"refused: {reason}"))

    def rollout_ended(self, core: Controller, path: EndEffectorPath, start_ns: int) -> None:
        """Answer the request for a rollout whose path, from a stamp [ns] on, is complete."""
        if self._do != "execute":
            return
        self._note_release(core)
        stop = self.last_stop if self._by_person else ""
        answer = RolloutEnd(path.id, start_ns, core.latched, core.stopped_in, stop).answer()
        self._end(replace(answer, text=answer.text or STOPPED) if stop else answer)

    def answer(self, core: Controller) -> None:
        """Answer the request under way once the arm rests or the movement was aborted."""
        mode = core.mode
        if not self._id or mode in (Mode.MOVE_TO_START, Mode.REPLAY, Mode.ROLLOUT):
            return
        if mode is Mode.HOLD and not core.at_rest:
            return
        self._note_release(core)
        if core.latched is not None and self._by_person:
            answer = self._stopped(core.latched.text)
        elif core.latched is not None:
            answer = Answer(Code.FAULT, f"failed: {core.latched.text}")
        else:
            answer = Answer(Code.STOPPED, f"failed: mode is {mode.value}")
        if self._do == "move_to_start" and core.ready:
            answer = Answer(Code.DONE, values={"policy": core.policy_id})
        elif self._do == "replay" and mode is Mode.HOLD:
            answer = Answer(Code.DONE, self._summary(core))
        self._end(answer)

    def stop(self, core: Controller | None) -> None:
        """Answer the request under way: a person has stopped the arm, or takes it in the hand."""
        self._note_stop()
        if self._do == "replay":
            self._end(self._stopped(f"{STOPPED}\n{self._summary(core)}".rstrip()))
        elif self._do == "move_to_start":
            self._end(self._stopped())

    def _note_stop(self) -> None:
        self.expire()
        self.last_stop, self._by_person = str(self._begin_ns), True

    def _note_release(self, core: Controller) -> None:
        """Note that a person ended the request under way by releasing the enabling switch."""
        if core.latched is not None and core.latched.kind.of_person and not self._by_person:
            self._note_stop()

    def _stopped(self, text: str = STOPPED) -> Answer:
        return Answer(Code.STOPPED, text, {"stop": self.last_stop})

    def deactivated(self) -> None:
        """Answer the request under way: the controller is not active any more."""
        self.expire()
        if self._id:
            self._end(NOT_ACTIVE)

    def _end(self, answer: Answer) -> None:
        id, self._id, self._do = self._id, "", ""
        self._give(id, answer)

    def _give(self, id: str, answer: Answer) -> None:
        self._given.pop(id, None)
        self._given[id] = answer
        if len(self._given) > KEPT:
            del self._given[next(iter(self._given))]
        self._send(id, answer)

    def _summary(self, core: Controller | None) -> str:
        """Tracking error of the last replay, as text."""
        error = None if core is None else core.replay_error
        return "" if error is None or not error.count else error.text(self._joint_names)
