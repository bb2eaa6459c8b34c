# SPDX-License-Identifier: Apache-2.0
"""The torque controller with timed stages; run by `benchmark.latency --stages`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from wam_power_ros.nodes.torque_controller import TorqueController
from wam_power_ros.ros import node_runner

STAGES = ("reading the message", "control step", "filling the message", "publishing")
now = time.monotonic_ns


def timed(marks: list[int], function: Callable) -> Callable:
    """Wrap a function to append its start and end time to `marks`."""

    def run(*arguments: object) -> object:
        marks.append(now())
        result = function(*arguments)
        marks.append(now())
        return result

    return run


class TimedController(TorqueController):
    """The controller with nine clock readings in every period."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file, self._marks, self._rows = file, [], []
        self._read = timed(self._marks, self._read)
        self._write = timed(self._marks, self._write)

    def on_configure(self, state: object) -> object:
        """Configure, and time the control step."""
        result = super().on_configure(state)
        if self._controller is not None:
            self._controller.step = timed(self._marks, self._controller.step)
        return result

    def _send(self, tau: np.ndarray, label: str) -> None:
        super()._send(tau, label)
        self._marks.append(self._watchdog.sent_ns)

    def _on_state(self, message: object, info: object) -> None:
        entered = now()
        self._marks.clear()
        super()._on_state(message, info)
        if len(self._marks) == 7:  # a complete answer
            self._rows.append((entered, *self._marks, now()))

    def close(self) -> None:
        """Save the times [ns, steady clock]. Shape (answers, 9)."""
        super().close()
        np.save(self._file, np.array(self._rows, dtype=np.int64))


def table(controller: np.ndarray, answers: np.ndarray) -> str:
    """Format the latency by stage as text.

    Args:
        controller: Times that `TimedController` saved [ns]. Shape (answers, 9).
        answers: Times of publication, answer of the controller and answer of the echo [ns].
            Shape (states, 3).
    """
    answers = answers[(answers[:, 1:] > 0).all(axis=1)]
    at = np.searchsorted(answers[:, 0], controller[:, 0]) - 1  # the state each answer is for
    near = (at >= 0) & (controller[:, 0] - answers[at, 0] < 2_000_000)
    rows, sent = controller[near], answers[at[near]]
    parts = {
        "middleware, executor: state to callback": rows[:, 0] - sent[:, 0],
        **{name: rows[:, 2 * i + 2] - rows[:, 2 * i + 1] for i, name in enumerate(STAGES[:3])},
        STAGES[3]: rows[:, 7] - rows[:, 6],
        "controller's bookkeeping, before and between": (rows[:, 1] - rows[:, 0])
        + (rows[:, 3] - rows[:, 2])
        + (rows[:, 5] - rows[:, 4]),
        "middleware, executor: torque to callback": sent[:, 1] - rows[:, 7],
        "state to torque, total": sent[:, 1] - sent[:, 0],
        "echo, total": sent[:, 2] - sent[:, 0],
        "controller's bookkeeping, after the torque": rows[:, 8] - rows[:, 7],
    }
    lines = [f"  {'stage':45s}{'p50 [us]':>10s}{'p99 [us]':>10s}"]
    for name, taken in parts.items():
        p50, p99 = np.percentile(taken * 1e-3, [50.0, 99.0])
        lines.append(f"  {name:45s}{p50:10.0f}{p99:10.0f}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(
        node_runner.run(
            lambda: TimedController(Path(sys.argv[1])),
            spin=lambda node, ended: node_runner.spin(node, ended, node.watch, node.patience),
        )
    )
