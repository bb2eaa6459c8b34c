# SPDX-License-Identifier: Apache-2.0
"""OptiTrack stand-in: frames of the world in, pose and markers of the pancake out.

It sees the world that `wam_sim` steps, so it lives in that process: see `standins`.
"""

from __future__ import annotations

import sys

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from hardware_sim.sensing import MocapFrame, MocapSettings
from wam_power_ros import interface
from wam_power_ros.params import Params


class OptitrackSimParams(Params):
    """What config/optitrack_sim.yaml says; ranges are those of `MocapSettings`."""

    frame: str
    publish_pose: bool
    publish_markers: bool
    rate: float
    noise: float
    latency: float
    dropout: float

    def mocap(self) -> MocapSettings:
        """The part that concerns the world."""
        names = ("rate", "noise", "latency", "dropout")
        return MocapSettings(**{name: getattr(self, name) for name in names})


class OptitrackSim(Node):
    """Publishes what the cameras see of the pancake."""

    def __init__(self) -> None:
        super().__init__("optitrack_sim", automatically_declare_parameters_from_overrides=True)
        self.params = OptitrackSimParams.of(self)
        self._poses = self.create_publisher(
            PoseStamped, interface.PANCAKE_POSE, interface.MOCAP_OUT
        )
        self._markers = self.create_publisher(PointCloud2, interface.MARKERS, interface.MOCAP_OUT)

    def publish(self, frame: MocapFrame, stamp_offset_ns: int) -> None:
        """One frame; its stamp is that of the exposure. Hidden markers repeat the last pose."""
        stamp_ns, name = frame.stamp_ns + stamp_offset_ns, self.params.frame
        if self.params.publish_pose:
            self._poses.publish(
                interface.pose_message(stamp_ns, name, frame.position, frame.quat_xyzw)
            )
        if self.params.publish_markers and frame.markers is not None:
            self._markers.publish(interface.markers_message(stamp_ns, name, frame.markers))


def main() -> int:
    """Entry point `optitrack_sim`: says where the stand-in runs."""
    sys.stderr.write(
        "optitrack_sim sees the world that wam_sim steps and runs in its process: start wam_sim\n"
        "with config/wam_sim.yaml and config/optitrack_sim.yaml; publish_pose: false silences it.\n"
    )
    return 2


if __name__ == "__main__":
    sys.exit(main())
