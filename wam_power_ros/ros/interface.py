# SPDX-License-Identifier: Apache-2.0
"""Names and QoS of all topics, actions and services, and the frames.

Names that belong to one arm are relative and follow the namespace of its nodes. Names that all arms
of a graph share are absolute, as usual in ROS.
"""

from __future__ import annotations

import re

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

# Topics
JOINT_STATES = "joint_states"
EFFORT_COMMANDS = "effort_controller/commands"
MARKERS = "pointCloud"
POLICY = "policy"
ROLLOUT_END_EFFECTOR = "rollout/end_effector"
ROLLOUT_END = "rollout/end"
LEARNER_MARKERS = "learner/markers"
IMAGES, CALIBRATION = "camera/image_raw", "camera/camera_info"  # as camera drivers name them
ROBOT_DESCRIPTION = "robot_description"
TF, TF_STATIC = "/tf", "/tf_static"  # subscribed when a frame is a foreign one
DIAGNOSTICS = "/diagnostics"
CLOCK = "/clock"
LOG = "/rosout"
ENABLE = "controller/enable"
REPLAY = "controller/replay"  # a movement to follow, for who wants no answer

# Actions
EXECUTE_POLICY = "controller/execute_policy"
MOVE_TO_START = "controller/move_to_start"
REPLAY_MOVEMENT = "controller/replay_movement"
FOLLOW_TRAJECTORY = "controller/follow_joint_trajectory"  # of control_msgs
RESET_SCENE = "scene/reset"  # this and the next: stand-in only
DEMONSTRATE = "scene/demonstrate"

# Services
STOP = "controller/stop"
RESET = "controller/reset"
GRAVITY_COMPENSATION = "controller/gravity_compensation"
RECORD = "recorder/record"
LEARNER_REWARD = "learner/reward"
LEARNER_PUNISH = "learner/punish"
LEARNER_PAUSE = "learner/pause"
LEARNER_RATE = "learner/rate"
ADD_DEMONSTRATION = "learner/add_demonstration"
WAM_GRAVITY_COMPENSATE = "wam/gravityCompensate"
WAM_IDLE = "wam/idle"

# Topics and services of a tracked body begin with its name; its frame is the name itself
BODY_LEAVES = ("pose", "state", "truth", "drop")  # the last two: stand-in only
SCENE = "scene"  # in the place of a body, for the truth of a task without one
_BODY = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_RESERVED = {SCENE, "end_effector", "end"}


def body_topic(body: str, leaf: str) -> str:
    """Topic or service of a tracked body, such as `ball/state`; without one, `scene/truth` alone.

    A ValueError if the name of the body is not acceptable.
    """
    return f"{SCENE if (body, leaf) == ('', 'truth') else _checked(body)}/{leaf}"


def rollout_topic(body: str) -> str:
    """Topic of a body's path in a rollout, as `rollout/ball`; a ValueError as for `body_topic`."""
    return f"rollout/{_checked(body)}"


def _checked(body: str) -> str:
    if not _BODY.fullmatch(body) or body in _RESERVED:
        raise ValueError(
            f"name {body!r} of a tracked body must be letters, digits and underscores, begin with "
            f"a letter, and be none of {sorted(_RESERVED)}"
        )
    return body


def frame(namespace: str, name: str) -> str:
    """Frame of one arm: `left/wam_base` in namespace `/left`, as robot_state_publisher prefixes."""
    return f"{namespace}/{name}".lstrip("/")


def qos(depth: int, reliability: str = "RELIABLE", durability: str = "VOLATILE") -> QoSProfile:
    """QoS that keeps the last `depth` messages; policies by their names in rclpy."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy[reliability],
        durability=DurabilityPolicy[durability],
    )


# QoS: publish reliable, subscribe best effort, except for latched topics
STATE_OUT = qos(10)  # and diagnostics
STATE_IN = qos(10, "BEST_EFFORT")
COMMAND = qos(1)
NEWEST = qos(1, "BEST_EFFORT")  # of a clock, a switch, images: an old one is worth nothing
# For readers that must lose nothing while they write to a disk: four seconds at 500 Hz.
# Lockstep waits for the controller alone, so states and torques are kept for a recorder.
DEEP = qos(2000)
DEEP_IN = qos(2000, "BEST_EFFORT")
STATE_RECORD = qos(2000, "BEST_AVAILABLE")
MOCAP = qos(500)  # a path needs every frame: two seconds at 240 Hz
MOCAP_BEST_EFFORT = qos(500, "BEST_EFFORT")
LATCHED = qos(1, durability="TRANSIENT_LOCAL")
FIXED = qos(100, durability="TRANSIENT_LOCAL")  # of /tf_static, as tf2 subscribes
LOG_QOS = qos(1000, durability="TRANSIENT_LOCAL")
# A request to idle that is delayed by a cut network would drop an arm that is held again by then.
IDLE_QOS = qos(1)
IDLE_QOS.lifespan = Duration(seconds=0.2)


def publishers(node: Node, topic: str) -> list[str]:
    """Full names of the nodes that publish a topic, sorted; once for each publisher."""
    infos = node.get_publishers_info_by_topic(topic)
    return sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos)


def is_reliable(info: TopicEndpointInfo) -> bool:
    """Return True if an endpoint is reliable."""
    return info.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def is_latched(info: TopicEndpointInfo) -> bool:
    """Return True if an endpoint is transient local."""
    return info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
