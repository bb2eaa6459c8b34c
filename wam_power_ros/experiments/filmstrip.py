# SPDX-License-Identifier: Apache-2.0
"""Pictures of a traced rollout, rendered in a process of its own where this machine has OpenGL.

Which OpenGL library MuJoCo takes is decided when it is first imported, too late for a process that
has simulated already; and a library that is missing may end the process that asks for it.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Sequence

import numpy as np

from wam_power_ros.reporting import figures
from wam_power_ros.reporting.chapter import Figure

TRACE_RATE = 100.0  # [Hz] of World.trace
DEADLINE = 120.0  # [s]
SHOWN = 8  # frames of a strip
SIZE = (360, 480)  # [pixel]


def strip(
    name: str, caption: str, trace: Sequence[Sequence[float]], first: float, last: float
) -> Figure:
    """Fig. 6 of the paper: moments of a rollout side by side, evenly spaced in time.

    Where nothing can be rendered the figure is without a picture, and its caption says why.

    Args:
        name: Of the figure.
        caption: Of the figure.
        trace: `World.trace` of the rollout: joint positions of arm and pancake, 100 a second.
            Shape (n, nq).
        first: Time of the first picture [s].
        last: Time of the last one [s].

    Raises:
        ValueError: Nothing was traced.
    """
    if not len(trace):
        raise ValueError(f"the trace for figure {name!r} is empty")
    wanted = np.linspace(first, last, SHOWN) * TRACE_RATE
    chosen = np.unique(np.clip(wanted.round().astype(int), 0, len(trace) - 1))
    try:
        pictures = _pictures([trace[k] for k in chosen])
    except RuntimeError as error:
        return Figure(name, f"{caption} Not drawn on this machine: {error}.", b"")
    return Figure.of(
        name, caption, figures.filmstrip(list(pictures), SHOWN, (chosen / TRACE_RATE).tolist())
    )


def _pictures(poses: Sequence[Sequence[float]]) -> np.ndarray:
    """RGB images of poses, shape (m, h, w, 3).

    Raises:
        RuntimeError: Nothing to render with, with the reason.
    """
    given = io.BytesIO()
    np.save(given, np.array(poses, dtype=float))
    command = [sys.executable, "-m", __name__]
    environment = os.environ | {"MUJOCO_GL": os.environ.get("MUJOCO_GL", "egl")}
    try:
        ended = subprocess.run(
            command, input=given.getvalue(), capture_output=True, env=environment, timeout=DEADLINE
        )
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"nothing was rendered within {DEADLINE:.0f} s") from None
    if ended.returncode != 0:
        said = ended.stderr.decode(errors="replace").strip().splitlines()
        raise RuntimeError(said[-1] if said else f"rendering ended with {ended.returncode}")
    return np.load(io.BytesIO(ended.stdout))


def main() -> int:
    """Poses as .npy on standard input, pictures as .npy on standard output."""
    from hardware_sim.world import World  # and with it MuJoCo
    from wam_power_ros.experiments.render import render

    poses = np.load(io.BytesIO(sys.stdin.buffer.read()))
    try:
        pictures = render(World(seed=0), list(poses), SIZE)
    except RuntimeError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    np.save(sys.stdout.buffer, np.stack(pictures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
