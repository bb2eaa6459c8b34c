# SPDX-License-Identifier: Apache-2.0
"""Requests that move the arm, one at a time, and the answers when it rests again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from wam_power_ros.control.controller import Controller
from wam_power_ros.control.joint_references import Sampled
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.learning.dmp import TabulatedPolicy
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.nodes.preparation import Preparation
from wam_power_ros.ros.outcomes import NOT_ACTIVE, Answer, Code, Ended

STOPPED = "stopped by a person"
Payload = TabulatedPolicy | Sampled  # a prepared policy or movement


def attempt(core: Controller | None, request: Callable[[Controller], None]) -> Answer:
    """Make a request to the controller; the answer says why it refuses, by a ControllerError."""
    if core is None:
        return NOT_ACTIVE
    try:
        request(core)
    except ControllerError as error:
        return Answer(Code(error.refusal.value), str(error), speed=error.speed)
    return Answer(Code.DONE)


class MotionRequests:
    """Requests for rollouts, moves to the start and replays.

    `last_stop` is the id of the last act by which a person ended a movement or took the arm, its
    time [ns of wall time]; "" before the first.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        active: Callable[[], Controller | None],
        replies: Preparation,
    ) -> None:
        self._joint_names, self._active, self._replies = joint_names, active, replies
        self._id = self._action = ""  # request under way; "" for none
        self._begin_ns = 0  # wall time; what was asked for before is not begun
        self.last_stop = ""
        self._by_person = False  # has ended the request under way

    def begin(self, id: str, action: str, payload: Payload, asked_ns: int, known_stop: str) -> None:
        """Begin to "move_to_start", "execute" a policy or "replay" a movement, or say why not.

        It was asked for at a wall time [ns], by who knows of a last stop, after which a person has
        let it go on; "" if it does not say. A request that does not know of the last stop is not
        begun, so that no stop can be overtaken.
        """

        def start(core: Controller) -> None:
            if action == "replay":
                return core.start_replay(payload)
            core.load_prepared(payload)
            return core.execute() if action == "execute" else core.move_to_start()

        if known_stop and self.last_stop not in ("", known_stop):
            return self._replies.ended(id, self._stopped())
        if asked_ns < self._begin_ns:
            text = "asked for before the last stop, reset or activation"
            stop = self.last_stop if self.last_stop == str(self._begin_ns) else ""
            return self._replies.ended(id, Answer(Code.STOPPED, text, stop))
        if self._id:
            return self.refuse(id, "the previous request is under way")
        answer = attempt(self._active(), start)
        if not answer.success:
            return self._replies.ended(id, answer)
        self._id, self._action, self._by_person = id, action, False
        return self._replies.begun(id)

    def expire(self) -> None:
        """Begin nothing any more that was sent before now, also what is still being read.

        A person who stops the arm, takes it in the hand, resets a fault or activates the controller
        does not expect it to move on an earlier request.
        """
        self._begin_ns = time.time_ns()

    def refuse(self, id: str, reason: str) -> None:
        """Refuse a request for now."""
        self._replies.ended(id, Answer(Code.BUSY, f"refused: {reason}"))

    def is_under_way(self, id: str) -> bool:
        """Whether the request of an id is under way."""
        return bool(id) and id == self._id

    def rollout_ended(self, core: Controller, path: EndEffectorPath, start_ns: int) -> None:
        """Answer the request for a rollout whose path, from a stamp [ns] on, is complete."""
        if self._action != "execute":
            return
        self._note_release(core)
        fault, stop = core.latched, self.last_stop if self._by_person else ""
        end = Ended(path.id, start_ns, fault, core.stopped_in, stop)
        if stop:
            answer = self._stopped(fault.text if fault else STOPPED)
        else:
            answer = Answer(Code.FAULT, fault.text) if fault else Answer(Code.DONE)
        self._end(answer, end)

    def answer(self, core: Controller) -> None:
        """Answer the request under way once the arm rests or the movement was aborted."""
        mode = core.mode
        if not self._id or mode in (Mode.MOVE_TO_START, Mode.REPLAY, Mode.ROLLOUT):
            return
        if mode is Mode.HOLD and not core.at_rest:
            return
        self._note_release(core)
        if self._action == "move_to_start" and core.ready:
            answer = Answer(Code.DONE)
        elif self._action == "replay" and mode is Mode.HOLD:
            answer = Answer(Code.DONE, self._summary(core))
        elif core.latched is None:
            answer = Answer(Code.STOPPED, f"failed: mode is {mode.value}")
        elif self._by_person:
            answer = self._stopped(core.latched.text)
        else:
            answer = Answer(Code.FAULT, f"failed: {core.latched.text}")
        self._end(answer)

    def stop(self, core: Controller | None) -> None:
        """Answer the request under way: a person has stopped the arm, or takes it in the hand."""
        self._note_stop()
        if self._action == "replay":
            self._end(self._stopped(f"{STOPPED}\n{self._summary(core)}".rstrip()))
        elif self._action == "move_to_start":
            self._end(self._stopped())

    def _note_stop(self) -> None:
        self.expire()
        self.last_stop, self._by_person = str(self._begin_ns), True

    def _note_release(self, core: Controller) -> None:
        """Note that a person ended the request under way by releasing the enabling switch."""
        if core.latched is not None and core.latched.kind.of_person and not self._by_person:
            self._note_stop()

    def _stopped(self, text: str = STOPPED) -> Answer:
        return Answer(Code.STOPPED, text, self.last_stop)

    def deactivated(self) -> None:
        """Answer the request under way: the controller is not active any more."""
        self.expire()
        if self._id:
            self._end(NOT_ACTIVE)

    def _end(self, answer: Answer, end: Ended | None = None) -> None:
        id, self._id, self._action = self._id, "", ""
        self._replies.ended(id, answer, end)

    def _summary(self, core: Controller | None) -> str:
        """Tracking error of the last replay, as text."""
        error = None if core is None else core.replay_error
        return "" if error is None or not error.count else error.text(self._joint_names)
