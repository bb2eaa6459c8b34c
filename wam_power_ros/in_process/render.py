# SPDX-License-Identifier: Apache-2.0
"""Images of the arm, rendered by MuJoCo; needs OpenGL, which MUJOCO_GL selects at import."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from hardware_sim.world import World

BACKGROUND = (246, 247, 249)


def render(
    world: World, poses: Sequence[np.ndarray], size: tuple[int, int] = (480, 480)
) -> list[np.ndarray]:
    """Render images of arm and scene.

    Args:
        world: World to render; its state is not modified.
        poses: Joint positions of arm and bodies, such as those of `World.trace`. Shapes (nq,).
        size: Width and height [pixel].

    Returns:
        RGB images. Shapes (h, w, 3), uint8.

    Raises:
        RuntimeError: OpenGL is missing; the message has the reason.
    """
    model = _lit(world.model, *size)
    try:
        renderer = mujoco.Renderer(model, size[1], size[0])
    except Exception as error:  # each OpenGL library raises other errors
        raise RuntimeError(f"OpenGL is not available: {error}") from error
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (0.42, 0.0, 0.85)
    camera.distance, camera.azimuth, camera.elevation = 2.1, 105.0, -12.0
    data = mujoco.MjData(model)
    frames = []
    with renderer:
        for qpos in poses:
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            frame = renderer.render().copy()
            renderer.enable_segmentation_rendering()
            frame[renderer.render()[:, :, 0] < 0] = BACKGROUND  # no body there
            renderer.disable_segmentation_rendering()
            frames.append(frame)
    return frames


def _lit(model: mujoco.MjModel, width: int, height: int) -> mujoco.MjModel:
    """Copy of a model for rendering, with even light and an infinite floor."""
    model = copy.copy(model)
    visual = model.vis
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.headlight.ambient[:], visual.headlight.diffuse[:] = 0.4, 0.35
    visual.headlight.specular[:] = 0.1
    visual.quality.shadowsize = 4096
    model.light_type[:] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    model.light_diffuse[:] = 0.45
    model.geom_size[model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE, :2] = 0.0
    return model
