# SPDX-License-Identifier: Apache-2.0
"""What the torque controller can be doing, and from what it may go to what."""

import enum


class Mode(enum.Enum):
    """What the controller does with the arm."""

    INACTIVE = "inactive"  # nothing is sent: the driver holds the arm by its own means
    GRAVITY_COMPENSATION = "gravity_compensation"  # a person moves the arm: teaching
    HOLD = "hold"
    MOVE_TO_START = "move_to_start"
    ROLLOUT = "rollout"
    REPLAY = "replay"
    FAULT = "fault"  # latched: brings the arm to rest and carries it until `reset`


TRANSITIONS = {
    Mode.INACTIVE: {Mode.GRAVITY_COMPENSATION, Mode.HOLD},
    Mode.GRAVITY_COMPENSATION: {
        Mode.INACTIVE,
        Mode.HOLD,
        Mode.MOVE_TO_START,
        Mode.REPLAY,
        Mode.FAULT,
    },
    Mode.HOLD: {
        Mode.INACTIVE,
        Mode.GRAVITY_COMPENSATION,
        Mode.MOVE_TO_START,
        Mode.ROLLOUT,
        Mode.REPLAY,
        Mode.FAULT,
    },
    Mode.MOVE_TO_START: {Mode.INACTIVE, Mode.HOLD, Mode.FAULT},
    Mode.ROLLOUT: {Mode.INACTIVE, Mode.HOLD, Mode.FAULT},
    Mode.REPLAY: {Mode.INACTIVE, Mode.HOLD, Mode.FAULT},
    Mode.FAULT: {Mode.HOLD},  # by `reset` only
}
REFERENCED = (Mode.HOLD, Mode.MOVE_TO_START, Mode.REPLAY)  # modes that follow a joint reference
PASSIVE = (Mode.INACTIVE, Mode.FAULT)  # modes in which nothing can go wrong any more
MOVING = (Mode.MOVE_TO_START, Mode.ROLLOUT, Mode.REPLAY)  # modes in which the arm moves by itself
HELD = (Mode.GRAVITY_COMPENSATION, Mode.REPLAY, Mode.ROLLOUT)  # modes of `hold_to_run`
BOXED = (Mode.ROLLOUT, Mode.REPLAY)  # modes in which the tool must stay in the workspace
