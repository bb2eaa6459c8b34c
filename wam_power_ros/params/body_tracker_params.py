# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tracker node, which `check_driver` uses as well."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, model_validator
from typing_extensions import Self

from wam_power_ros.params.node_params import Params
from wam_power_ros.tracking.tracker import TrackerSettings


class BodyTrackerParams(Params, TrackerSettings):
    """Parameters of the node, settings of its tracker included.

    The values are in config/pancake_tracker.yaml.
    """

    file = "pancake_tracker.yaml"
    settable: ClassVar[set[str]] = {
        "latency_offset",
        "workspace_low",
        "workspace_high",
        "speed_max",
        "noise",
        "silence",
    }

    body: str  # name of the tracked body
    tethered: bool  # by a string, say: its falls do not tell whether the base frame is right
    base_frame: str
    pose_topic: str
    markers_topic: str
    silence: float = Field(
        ge=0.05, le=60.0, description="in s: above the period of 30 Hz, and at most a minute"
    )
    clock_offset_max: float = Field(
        ge=0.001, le=10.0, description="in s: above the jitter; a clock never set is farther off"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.body and bool(self.pose_topic) == bool(self.markers_topic):
            raise ValueError(
                f"set either pose_topic or markers_topic, not {self.pose_topic!r} and "
                f"{self.markers_topic!r}"
            )
        return self
