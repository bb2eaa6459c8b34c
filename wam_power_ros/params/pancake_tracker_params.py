# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tracker node, which `check_driver` reads as well."""

from __future__ import annotations

from wam_power_ros.params.node_params import Params
from wam_power_ros.tracking.tracker import TrackerSettings


class PancakeTrackerParams(Params):
    """Parameters of the node; the values are in config/pancake_tracker.yaml."""

    body: str  # name of the tracked body
    pose_topic: str
    markers_topic: str
    rate: float
    up_axis: str
    world_to_base: tuple[float, ...]
    latency_offset: float
    workspace_low: tuple[float, ...]
    workspace_high: tuple[float, ...]
    speed_max: float
    noise: float
    silence: float
    clock_offset_max: float

    def settings(self) -> TrackerSettings:
        """Return the settings of the tracker.

        Raises:
            ValueError: When one is out of range.
        """
        fields = TrackerSettings.__dataclass_fields__
        return TrackerSettings(**self.model_dump(include=set(fields)))
