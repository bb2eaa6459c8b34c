# SPDX-License-Identifier: Apache-2.0
"""Images of a traced rollout, rendered by a child process if this machine has OpenGL.

MuJoCo selects its OpenGL library when it is first imported: a process that has simulated can no
longer choose. And a missing library may end the process that loads it.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from hardware_sim.scenes import scene_type
from hardware_sim.world import TRACE_RATE, World
from wam_power_ros.in_process.render import render
from wam_power_ros.plotting import INK

RENDER_TIMEOUT = 120.0  # [s]
FRAMES = 8  # of a strip
SIZE = (360, 480)  # [pixel]


def strip(trace: Sequence[Sequence[float]], last: float) -> Figure | str:
    """Fig. 6 of the paper: frames of a rollout side by side, evenly spaced in time from its start.

    Args:
        trace: `World.trace` of the rollout: joint positions of arm and pancake. Shape (n, nq).
        last: Time of the last frame [s].

    Returns:
        The figure, or the reason why nothing could be rendered.

    Raises:
        ValueError: The trace is empty.
    """
    if not len(trace):
        raise ValueError("the trace of a filmstrip is empty")
    wanted = np.linspace(0.0, last, FRAMES) * TRACE_RATE
    chosen = np.unique(np.clip(wanted.round().astype(int), 0, len(trace) - 1))
    try:
        images = _images([trace[k] for k in chosen])
    except RuntimeError as error:
        return str(error)
    high, wide = images[0].shape[:2]
    figure = Figure(figsize=(10.0, 10.0 / len(chosen) * high / wide + 0.25), layout="constrained")
    row = figure.subplots(1, len(chosen), squeeze=False)[0]
    for axes, image, index in zip(row, images, chosen.tolist(), strict=True):
        axes.imshow(image)
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        axes.set_xlabel(f"{index / TRACE_RATE:.2f} s", fontsize=8, color=INK)
    return figure


def _images(poses: Sequence[Sequence[float]]) -> np.ndarray:
    """RGB images of poses. Shape (m, h, w, 3).

    Raises:
        RuntimeError: Rendering failed; the message has the reason.
    """
    poses_npy = io.BytesIO()
    np.save(poses_npy, np.array(poses, dtype=float))
    try:
        completed = subprocess.run(
            [sys.executable, "-m", __name__],
            input=poses_npy.getvalue(),
            capture_output=True,
            env=os.environ | {"MUJOCO_GL": os.environ.get("MUJOCO_GL", "egl")},
            timeout=RENDER_TIMEOUT,
        )
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"nothing was rendered within {RENDER_TIMEOUT:.0f} s") from None
    if completed.returncode != 0:
        message = completed.stderr.decode(errors="replace").strip().splitlines()
        raise RuntimeError(
            message[-1] if message else f"rendering ended with {completed.returncode}"
        )
    return np.load(io.BytesIO(completed.stdout))


def main() -> int:
    """Render poses (.npy on standard input) to images (.npy on standard output)."""
    poses = np.load(io.BytesIO(sys.stdin.buffer.read()))
    try:
        images = render(World(scene_type("flip"), seed=0), list(poses), SIZE)
    except RuntimeError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    np.save(sys.stdout.buffer, np.stack(images))
    return 0


if __name__ == "__main__":
    sys.exit(main())
