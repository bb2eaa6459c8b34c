# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tag camera."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field, model_validator
from typing_extensions import Self

from wam_power_ros.params.node_params import Params


class TagCameraParams(Params):
    """Parameters of the node; the values are in config/tag_camera.yaml."""

    file = "tag_camera.yaml"

    body: str
    image_topic: str = Field(min_length=1)
    info_topic: str = Field(min_length=1)
    family: Literal["16h5", "25h9", "36h10", "36h11"]
    tags: tuple[int, ...] = Field(min_length=1, max_length=64)
    tag_size: float = Field(ge=0.005, le=2.0, description="in m: a print, up to a poster")
    tag_poses: tuple[float, ...] = Field(max_length=64 * 7)

    @model_validator(mode="after")
    def _one_pose_each(self) -> Self:
        poses = np.array(self.tag_poses)
        if len(poses) != 7 * len(self.tags) or len({*self.tags}) != len(self.tags):
            raise ValueError(
                f"tag_poses must be 7 numbers for each of tags {self.tags}, all unlike"
            )
        if np.abs(np.linalg.norm(poses.reshape(-1, 7)[:, 3:], axis=1) - 1.0).max() > 1e-3:
            raise ValueError(f"quaternions in tag_poses {self.tag_poses} must have length 1")
        return self
