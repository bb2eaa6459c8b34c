# SPDX-License-Identifier: Apache-2.0
"""Images of AprilTags in a MuJoCo scene, through a lens with distortion, with noise.

Needs OpenCV, and OpenGL, which MUJOCO_GL selects before MuJoCo is imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import mujoco
import numpy as np

from wam_power_ros import rotations

CELL = 32  # [px] of a module of a tag in its texture
MARGIN = 1.3  # of the ideal image over the distorted one
ANTIALIAS = 2  # rendered pixels a pixel
FAMILIES = {"16h5": 6, "25h9": 7, "36h10": 8, "36h11": 8}  # modules of the black square


class Lens(NamedTuple):
    """Camera matrix k (3, 3), distortion d (5,) as in CameraInfo, size of the image [px]."""

    k: np.ndarray
    d: np.ndarray
    width: int
    height: int


WEBCAM = Lens(
    k=np.array([[610.0, 0.0, 322.0], [0.0, 610.0, 236.0], [0.0, 0.0, 1.0]]),
    d=np.array([-0.28, 0.09, 0.0006, -0.0004, 0.0]),
    width=640,
    height=480,
)


def add_tags(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    family: str,
    tags: Sequence[int],
    size: float,
    poses: Sequence[float],
) -> None:
    """Glue printed tags on a body; the arguments are those of `TagDetector`."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family}"))
    modules = FAMILIES[family]
    for number, pose in zip(tags, np.reshape(poses, (-1, 7)), strict=True):
        printed = np.full((modules + 2, modules + 2), 255, np.uint8)  # with its white margin
        printed[1:-1, 1:-1] = cv2.aruco.generateImageMarker(dictionary, number, modules)
        texture = np.kron(printed, np.ones((CELL, CELL), np.uint8))
        name, n = f"tag {number}", len(texture)
        spec.add_texture(
            name=name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=n,
            height=n,
            nchannel=3,
            data=np.repeat(texture, 3).tolist(),
        )
        material = spec.add_material(name=name, texuniform=False, specular=0.0, emission=0.3)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        half = 0.5 * size * (modules + 2) / modules
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[half, half, 0.0002],
            pos=pose[:3] - 0.0002 * rotations.matrix(pose[3:])[:, 2],
            quat=pose[[6, 3, 4, 5]],
            material=name,
            contype=0,
            conaffinity=0,
            mass=0.0,
        )


class TagImages:
    """Takes grey images of a scene with a camera that is fixed in the world."""

    def __init__(
        self, spec: mujoco.MjSpec, lens: Lens, position: np.ndarray, rotation: np.ndarray
    ) -> None:
        """Add the camera, whose optical axes are the columns of `rotation` (3, 3), and compile.

        Raises:
            RuntimeError: OpenGL is not available.
        """
        width, height = (round(MARGIN * ANTIALIAS * it) for it in (lens.width, lens.height))
        focal = ANTIALIAS * lens.k[1, 1]
        spec.worldbody.add_camera(
            name="tag camera",
            pos=position,
            quat=rotations.quat_xyzw(rotation @ np.diag([1.0, -1.0, -1.0]))[[3, 0, 1, 2]],
            fovy=2.0 * np.degrees(np.arctan(0.5 * height / focal)),
        )
        spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        try:
            self._renderer = mujoco.Renderer(self.model, height, width)
        except Exception as error:  # each OpenGL library raises other errors
            raise RuntimeError(f"OpenGL is not available: {error}") from error
        pixels = np.stack(np.meshgrid(np.arange(lens.width), np.arange(lens.height)), axis=-1)
        rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2).astype(float), lens.k, lens.d)
        centre = 0.5 * np.array([width - 1, height - 1])
        self._map = (focal * rays.reshape(lens.height, lens.width, 2) + centre).astype(np.float32)

    def image(self, rng: np.random.Generator, noise: float = 3.0) -> np.ndarray:
        """Image (h, w) of the present `data`, with noise of a standard deviation [grey values]."""
        mujoco.mj_forward(self.model, self.data)
        self._renderer.update_scene(self.data, "tag camera")
        ideal = cv2.cvtColor(self._renderer.render(), cv2.COLOR_RGB2GRAY)
        ideal = cv2.GaussianBlur(ideal, (0, 0), 0.5 * ANTIALIAS)  # of the lens
        seen = cv2.remap(ideal, self._map, None, cv2.INTER_LINEAR).astype(float)
        return np.clip(seen + noise * rng.standard_normal(seen.shape), 0, 255).astype(np.uint8)

    def close(self) -> None:
        """Free what belongs to OpenGL."""
        self._renderer.close()
