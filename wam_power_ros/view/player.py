# SPDX-License-Identifier: Apache-2.0
"""Playback of recorded movements: a time slider, a play button and a list of movements."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from wam_power_ros.learning.policy_shapes import plan
from wam_power_ros.view.page import EXECUTED, PLANNED, Page
from wam_power_ros.view.recorded import Movement
from wam_power_ros.view.skeleton import Skeleton

SPEEDS = {"1/8": 0.125, "1/4": 0.25, "1/2": 0.5, "1": 1.0}
NO_MOVEMENT = "none"  # entry of an empty list of movements
TIME_STEP = 0.01  # [s] of the slider
PATH_STEP = 5  # states between two points of a drawn path


class Player:
    """Shows one of several movements at the time given by a slider.

    Attributes:
        movement: Shown movement, None before the first.
        stale: True before the first movement, and if something else was drawn over it.
        on_choice: Called when a person chooses or plays a movement; until then the newest one, the
            first of the list, is chosen.

    Args:
        page: Page to draw on.
        names: Names of the movements to choose from.
        read: Reads a movement by its name; the page shows its `ValueError` or `OSError`.
    """

    def __init__(self, page: Page, names: Sequence[str], read: Callable[[str], Movement]) -> None:
        self._page, self._read = page, read
        self.movement: Movement | None = None
        self.stale = True
        self._lock = threading.Lock()  # viser runs callbacks in other threads
        gui = page.server.gui
        with gui.add_folder("Playback"):
            self._choice = gui.add_dropdown("movement", [*names] or [NO_MOVEMENT])
            self._time = gui.add_slider("time [s]", 0.0, 1.0, TIME_STEP, 0.0)
            self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1")
            self._button = gui.add_button("Play")
        self.playing = self._chosen = False
        self.on_choice: Callable[[], object] = lambda: None
        self._button.on_click(lambda _: self._toggle())
        self._choice.on_update(lambda event: self._on_movement(event.client is not None))
        self._time.on_update(lambda event: self._on_time(event.client is not None))

    def offer(self, names: Sequence[str]) -> None:
        """Replace the names of the movements to choose from, newest first."""
        if tuple(names) == tuple(self._choice.options):
            return
        chosen = self._choice.value
        self._choice.options = tuple(names) or (NO_MOVEMENT,)
        if not self._chosen or chosen not in names:
            self._choice.value, self.stale = self._choice.options[0], True
        elif self._choice.value != chosen:
            self._choice.value = chosen

    def show(self, name: str) -> None:
        """Show a movement from its beginning."""
        try:
            movement = self._read(name)
            skeleton = Skeleton(movement.urdf, movement.joint_names)
        except (ValueError, OSError) as error:
            self.movement, self.stale = None, False
            self._page.notify(name, str(error), good=False)
            return
        with self._lock:
            self.movement, self.stale, page = movement, False, self._page
            if self._choice.value != name:
                self._choice.value = name
            page.show_arm(skeleton)
            path = skeleton.tool_path(movement.q[::PATH_STEP])
            page.show_path("executed", path, EXECUTED)
            page.show_path("trail", path[:0], EXECUTED)
            planned = path[:0] if movement.policy is None else plan(movement.policy, path[0])
            page.show_path("planned", planned, PLANNED)
            page.show_attractors(movement.policy)
            self._time.max = max(round(movement.duration, 2), TIME_STEP)
            self._time.value = 0.0
        self._draw()

    def redraw(self) -> None:
        """Show the chosen movement again if something else has been drawn since."""
        if self.stale and self._choice.value != NO_MOVEMENT:
            self.show(self._choice.value)

    def advance(self, elapsed: float) -> None:
        """Advance playback by an elapsed time [s]; it starts again at the end."""
        if self.playing and self.movement is not None:
            t = self._time.value + elapsed * SPEEDS[self._speed.value]
            self._time.value = t if t < self.movement.duration else 0.0

    def _choose(self) -> None:
        self._chosen = True
        self.on_choice()

    def _on_movement(self, by_person: bool) -> None:
        if by_person:
            self._choose()
            self.show(self._choice.value)

    def _on_time(self, by_person: bool) -> None:
        if by_person:
            self._choose()
        self._draw()

    def _toggle(self) -> None:
        self._choose()
        self.playing = not self.playing
        self._button.label = "Pause playback" if self.playing else "Play"

    def _draw(self) -> None:
        with self._lock:
            if self.movement is not None and not self.stale:
                t = float(self._time.value)
                self._page.pose(self.movement.joints_at(t))
                self._page.place_body(self.movement.body_at(t))
