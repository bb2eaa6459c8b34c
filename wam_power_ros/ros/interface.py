# SPDX-License-Identifier: Apache-2.0
"""Names and QoS of all topics and services, and the frames.

What belongs to one arm has a relative name, which follows the namespace of its nodes. What a graph
has once for all arms is absolute, as everywhere in ROS.
"""

from __future__ import annotations

import re

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# Topics
JOINT_STATES = "joint_states"
EFFORT_COMMANDS = "effort_controller/commands"
MARKERS = "pointCloud"
POLICY = "policy"
REPLAY_TRAJECTORY = "replay/trajectory"
ROLLOUT_END_EFFECTOR = "rollout/end_effector"
ROLLOUT_FINISHED = "rollout/finished"  # whose the paths are that begin with the same stamp
LEARNER_MARKERS = "learner/markers"
LEARNER_BAG = "learner/bag"  # path of a demonstration to be given to the learner
ROBOT_DESCRIPTION = "robot_description"
DIAGNOSTICS = "/diagnostics"
CLOCK = "/clock"
ENABLE = "controller/enable"

# Services
EXECUTE = "rollout/execute"
STOP = "controller/stop"
RESET = "controller/reset"
MOVE_TO_START = "controller/move_to_start"
REPLAY = "controller/replay"
GRAVITY_COMPENSATION = "controller/gravity_compensation"
RECORD = "recorder/record"
LEARNER_REWARD = "learner/reward"
LEARNER_PUNISH = "learner/punish"
LEARNER_DEMONSTRATION = "learner/demonstration"
LEARNER_PAUSE = "learner/pause"
WAM_GRAVITY_COMPENSATE = "wam/gravityCompensate"
WAM_HOLD = "wam/holdJointPosition"
WAM_MOVE_HOME = "wam/moveHome"
WAM_IDLE = "wam/idle"
DEMONSTRATE = "demonstrator/demonstrate"  # stand-in only


# Topics and services of a tracked body, which follow its name; its frame is the name itself
BODY_LEAVES = ("pose", "state", "truth", "reset", "drop")  # the last three: stand-in only
SCENE_LEAVES = ("truth", "reset")  # of a task without a body
SCENE = "scene"
_BODY = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_RESERVED = {SCENE, "end_effector", "finished"}


def body_topic(body: str, leaf: str) -> str:
    """Topic or service of a tracked body, such as `pancake/state`.

    Args:
        body: Name of the body; empty for a task without one, which has `scene/truth` and
            `scene/reset`.
        leaf: One of `BODY_LEAVES`.

    Raises:
        ValueError: When there is no such topic, or the name of the body is not acceptable.
    """
    leaves = BODY_LEAVES if body else SCENE_LEAVES
    if leaf not in leaves:
        raise ValueError(f"no topic {leaf!r} of body {body!r}; there are {list(leaves)}")
    return f"{_checked(body) if body else SCENE}/{leaf}"


def rollout_topic(body: str) -> str:
    """Topic of a tracked body's path through a rollout, such as `rollout/pancake`.

    Raises:
        ValueError: When the name of the body is not acceptable.
    """
    return f"rollout/{_checked(body)}"


def _checked(body: str) -> str:
    if not _BODY.fullmatch(body) or body in _RESERVED:
        raise ValueError(
            f"name {body!r} of a tracked body must be letters, digits and underscores, begin with "
            f"a letter, and be none of {sorted(_RESERVED)}"
        )
    return body


# Frames
BASE_FRAME = "wam_base"


def frame(namespace: str, name: str) -> str:
    """Frame of one arm: `left/wam_base` in namespace `/left`, as robot_state_publisher prefixes."""
    return f"{namespace}/{name}".lstrip("/")


def _qos(depth: int, reliability: str = "RELIABLE", durability: str = "VOLATILE") -> QoSProfile:
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy[reliability],
        durability=DurabilityPolicy[durability],
    )


# QoS: publish reliable, subscribe best effort, except what is latched
STATE_OUT = _qos(10)
# Of the stand-in, whose states may come in a row: in lockstep, and when it catches up with its
# clock. A recorder that could not run for seconds is sent again what it has missed.
STATE_OUT_DEEP = _qos(4000)
STATE_IN = _qos(10, "BEST_EFFORT")
STATE_RECORD = _qos(4000, "BEST_AVAILABLE")  # a recorder may fall behind, it may not lose
COMMAND = _qos(1)
MOCAP_OUT = _qos(10)
MOCAP_OUT_BEST_EFFORT = _qos(10, "BEST_EFFORT")  # of some drivers
MOCAP_IN = _qos(500, "BEST_EFFORT")  # every frame counts for a path: a burst pushes none out
LATCHED = _qos(1, durability="TRANSIENT_LOCAL")
DIAGNOSTICS_QOS = _qos(10)
CLOCK_QOS = _qos(1, "BEST_EFFORT")
ENABLE_OUT, ENABLE_IN = _qos(1), _qos(1, "BEST_EFFORT")
# A request to idle that a cut network has kept back would drop an arm that is carried again.
IDLE_QOS = _qos(1)
IDLE_QOS.lifespan = Duration(seconds=0.2)
