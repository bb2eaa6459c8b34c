# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tracker node, which `check_driver` uses as well."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from wam_power_ros.params.node_params import Params
from wam_power_ros.tracking.tracker import TrackerSettings

Place = Annotated[float, Field(ge=-50.0, le=50.0)]
Unit = Annotated[float, Field(ge=-1.0, le=1.0)]
Corner = tuple[Place, Place, Place]
WorldToBase = tuple[Place, Place, Place, Unit, Unit, Unit, Unit]


class PancakeTrackerParams(Params):
    """Parameters of the node; the values are in config/pancake_tracker.yaml."""

    file = "pancake_tracker.yaml"

    body: str  # name of the tracked body
    pose_topic: str
    markers_topic: str
    rate: float = Field(ge=10.0, le=1000.0, description="in Hz: below, a flight of 0.4 s is missed")
    up_axis: str
    world_to_base: WorldToBase = Field(description="in m: a room of 50 m; unit quaternion")
    latency_offset: float = Field(
        ge=-1.0, le=1.0, description="in s: more than 1 s is a clock offset, not a delay"
    )
    workspace_low: Corner = Field(description="in m: a room of 50 m")
    workspace_high: Corner = Field(description="in m: a room of 50 m")
    speed_max: float = Field(
        ge=1.0, le=50.0, description="in m/s: a toss has 4; 50 is 0.5 m between frames at 100 Hz"
    )
    noise: float = Field(
        ge=1e-6,
        le=0.05,
        description="in m: above any camera's resolution; more than 0.05 hides any toss",
    )
    silence: float = Field(
        ge=0.05, le=60.0, description="in s: above the period of 30 Hz, and at most a minute"
    )
    clock_offset_max: float = Field(
        ge=0.001, le=10.0, description="in s: above the jitter; a clock never set is farther off"
    )

    def settings(self) -> TrackerSettings:
        """Return the settings of the tracker.

        Raises:
            ValueError: A setting is out of range.
        """
        fields = TrackerSettings.__dataclass_fields__
        return TrackerSettings(**self.model_dump(include=set(fields)))
