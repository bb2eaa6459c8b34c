# SPDX-License-Identifier: Apache-2.0
"""Modes of the torque controller, their transitions, and refusals of requests."""

import enum
import math

from wam_power_ros.faults import Fault


class Mode(enum.Enum):
    """Mode of the controller."""

    INACTIVE = "inactive"  # no torque is sent: the driver holds the arm
    GRAVITY_COMPENSATION = "gravity_compensation"  # a person guides the arm: teaching
    HOLD = "hold"
    MOVE_TO_START = "move_to_start"
    ROLLOUT = "rollout"
    REPLAY = "replay"
    FAULT = "fault"  # latched: the arm is braked and held against gravity until `reset`


_ABORTED = {Mode.INACTIVE, Mode.HOLD, Mode.FAULT}  # modes that any motion can be aborted to
TRANSITIONS = {
    Mode.INACTIVE: {Mode.GRAVITY_COMPENSATION, Mode.HOLD},
    Mode.GRAVITY_COMPENSATION: _ABORTED | {Mode.MOVE_TO_START, Mode.REPLAY},
    Mode.HOLD: set(Mode) - {Mode.HOLD},
    Mode.MOVE_TO_START: _ABORTED,
    Mode.ROLLOUT: _ABORTED,
    Mode.REPLAY: _ABORTED,
    Mode.FAULT: {Mode.HOLD},  # by `reset` only
}
REFERENCE_MODES = (Mode.HOLD, Mode.MOVE_TO_START, Mode.REPLAY)  # follow a joint reference
PASSIVE_MODES = (Mode.INACTIVE, Mode.FAULT)  # no motion to abort, no motion limits
MOVING_MODES = (Mode.MOVE_TO_START, Mode.ROLLOUT, Mode.REPLAY)  # the arm moves by itself
SWITCH_MODES = (Mode.GRAVITY_COMPENSATION, Mode.REPLAY, Mode.ROLLOUT)  # need the enabling switch
WORKSPACE_MODES = (Mode.ROLLOUT, Mode.REPLAY)  # the tool must stay in the workspace box


class Refusal(str, enum.Enum):
    """Reason code of a refused request: programs decide by it, the text is for people.

    The values are those of `ros.outcomes.Code`.
    """

    FAULT = "fault"  # a fault is latched: reset first
    BUSY = "busy"  # not possible in this mode, or the arm moves
    NOTHING = "nothing"  # there is no policy, no joint state, or no fault to reset
    NOT_AT_START = "not_at_start"  # the arm is not at the start of the policy
    SWITCH = "switch"  # the enabling switch is not held
    TOO_FAST = "too_fast"  # for the limits of the arm; attribute `speed`
    REFUSED = "refused"  # any other reason, which a person must resolve


class ControllerError(RuntimeError):
    """A refused request; the controller is unchanged.

    Attributes:
        speed: Largest speed, relative to the one asked for, at which it is possible if too fast.
    """

    def __init__(self, refusal: Refusal, text: str, speed: float = math.nan) -> None:
        super().__init__(text)
        self.refusal, self.speed = refusal, speed


def check_transition(mode: Mode, target: Mode, fault: Fault | None, reset: bool = False) -> None:
    """Refuse a transition that is not allowed.

    Raises:
        ControllerError: A fault is latched, or `TRANSITIONS` does not list the transition.
    """
    if mode is Mode.FAULT and not reset:
        text = f"{target.value} refused: fault ({fault.text if fault else ''}); reset first"
        raise ControllerError(Refusal.FAULT, text)
    if target not in TRANSITIONS[mode]:
        possible = sorted(other.value for other in TRANSITIONS[mode])
        text = f"{target.value} is not possible from {mode.value}; possible are {possible}"
        raise ControllerError(Refusal.BUSY, text)
