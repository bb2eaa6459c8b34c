# SPDX-License-Identifier: Apache-2.0
"""Modes of the torque controller, the transitions between them, and refused requests."""

import enum
from collections.abc import Mapping

from wam_power_ros.learning.rollout import Fault


class Mode(enum.Enum):
    """Mode of the controller."""

    INACTIVE = "inactive"  # nothing is sent: the driver holds the arm by its own means
    GRAVITY_COMPENSATION = "gravity_compensation"  # a person moves the arm: teaching
    HOLD = "hold"
    MOVE_TO_START = "move_to_start"
    ROLLOUT = "rollout"
    REPLAY = "replay"
    FAULT = "fault"  # latched: brings the arm to rest and carries it until `reset`


_ENDS = {Mode.INACTIVE, Mode.HOLD, Mode.FAULT}  # whatever is under way may end so
TRANSITIONS = {
    Mode.INACTIVE: {Mode.GRAVITY_COMPENSATION, Mode.HOLD},
    Mode.GRAVITY_COMPENSATION: _ENDS | {Mode.MOVE_TO_START, Mode.REPLAY},
    Mode.HOLD: set(Mode) - {Mode.HOLD},
    Mode.MOVE_TO_START: _ENDS,
    Mode.ROLLOUT: _ENDS,
    Mode.REPLAY: _ENDS,
    Mode.FAULT: {Mode.HOLD},  # by `reset` only
}
REFERENCED = (Mode.HOLD, Mode.MOVE_TO_START, Mode.REPLAY)  # modes that follow a joint reference
PASSIVE = (Mode.INACTIVE, Mode.FAULT)  # modes in which nothing can go wrong any more
MOVING = (Mode.MOVE_TO_START, Mode.ROLLOUT, Mode.REPLAY)  # modes in which the arm moves by itself
HELD = (Mode.GRAVITY_COMPENSATION, Mode.REPLAY, Mode.ROLLOUT)  # modes of `hold_to_run`
BOXED = (Mode.ROLLOUT, Mode.REPLAY)  # modes in which the tool must stay in the workspace


class Refusal(str, enum.Enum):
    """Why a request to the controller was refused; machines decide by this, people read the text.

    The values are those of `ros.answers.Code`.
    """

    FAULT = "fault"  # a fault is latched: reset first
    BUSY = "busy"  # not from this mode, or the arm moves
    NOTHING = "nothing"  # no policy, or no joint state, has come yet
    NOT_AT_START = "not_at_start"  # value `policy`: the arm is not at the start of this policy
    SWITCH = "switch"  # the enabling switch is not held
    TOO_FAST = "too_fast"  # value `speed`: at which the replay would be possible
    REFUSED = "refused"  # anything else, which only a person can mend


class ControllerError(RuntimeError):
    """A request that was refused; nothing has changed.

    Attributes:
        refusal: Why.
        values: What belongs to it, by name; see `Refusal`.
    """

    def __init__(
        self, refusal: Refusal, text: str, values: Mapping[str, str] | None = None
    ) -> None:
        super().__init__(text)
        self.refusal, self.values = refusal, values or {}


def check_transition(mode: Mode, target: Mode, fault: Fault | None, reset: bool = False) -> None:
    """Refuse a transition that is not allowed.

    Args:
        mode: Present mode.
        target: Mode that is asked for.
        fault: Fault that is latched, None without.
        reset: Whether this is the reset of a fault.

    Raises:
        ControllerError: A fault is latched, or there is no way from one mode to the other.
    """
    if mode is Mode.FAULT and not reset:
        text = f"{target.value} refused: fault ({fault.text if fault else ''}); reset first"
        raise ControllerError(Refusal.FAULT, text)
    if target not in TRANSITIONS[mode]:
        possible = sorted(other.value for other in TRANSITIONS[mode])
        text = f"{target.value} is not possible from {mode.value}; from there: {possible}"
        raise ControllerError(Refusal.BUSY, text)
