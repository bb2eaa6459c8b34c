# SPDX-License-Identifier: Apache-2.0
"""Playback of recorded movements: a time slider, a play button and a list of movements."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import viser

from wam_power_ros.view.page import ORANGE, Page
from wam_power_ros.view.recorded import Movement
from wam_power_ros.view.skeleton import Skeleton

SPEEDS = {"1/8": 0.125, "1/4": 0.25, "1/2": 0.5, "1": 1.0}
LIVE, NO_MOVEMENT = "the arm, live", "none"  # entries that are no movement
TIME_STEP = 0.01  # [s] of the slider
PATH_STEP = 5  # states between two points of a drawn path


class Player:
    """Shows one of several movements at the time given by a slider.

    Attributes:
        movement: Shown movement, None if there is none or the arm is live.

    Args:
        read: Reads a movement by its name; the page shows its `ValueError` or `OSError`.
    """

    def __init__(self, page: Page, read: Callable[[str], Movement]) -> None:
        self._page, self._read = page, read
        self.movement: Movement | None = None
        self._chosen = ""  # by a person
        self._playing = False
        gui = page.server.gui
        with gui.add_folder("Playback"):
            self._choice = gui.add_dropdown("movement", [NO_MOVEMENT])
            self._time = gui.add_slider("time [s]", 0.0, 1.0, TIME_STEP, 0.0, disabled=True)
            self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1")
            self._button = gui.add_button("Play", disabled=True)
        self._choice.on_update(self._on_choice)
        self._time.on_update(self._on_time)
        self._button.on_click(self._on_button)

    @property
    def live(self) -> bool:
        """Whether the arm is to be shown as it is now."""
        return self._choice.value == LIVE

    def offer(self, names: Sequence[str]) -> None:
        """Replace the names to choose from; the first is shown until a person has chosen one."""
        if tuple(names) == tuple(self._choice.options):
            return
        before = self._choice.value
        self._choice.options = tuple(names) or (NO_MOVEMENT,)
        now = self._chosen if self._chosen in names else self._choice.options[0]
        self._choice.value = now
        if now != before:
            self._show(now)

    def advance(self, elapsed: float) -> None:
        """Advance playback by an elapsed time [s]; it starts again at the end."""
        if self._playing and self.movement is not None:
            t = self._time.value + elapsed * SPEEDS[self._speed.value]
            self._time.value = t if t < self.movement.duration else 0.0
            self._draw()

    def _show(self, name: str) -> None:
        """Show a movement from its beginning."""
        self.movement, page = None, self._page
        if name not in (LIVE, NO_MOVEMENT):
            try:
                movement = self._read(name)
                skeleton = Skeleton(movement.urdf, movement.joint_names)
            except (ValueError, OSError) as error:
                page.notify(name, str(error), good=False)
            else:
                self.movement = movement
                page.show_arm(skeleton)
                path = skeleton.tool_path(movement.q[::PATH_STEP])
                page.show_path("executed/path", path, ORANGE)
                page.show_path("executed/trail", path[:0], ORANGE)
                page.show_policy(movement.policy, path[0])
                self._time.max = max(round(movement.duration, 2), TIME_STEP)
                self._time.value = 0.0
                self._draw()
        self._time.disabled = self._button.disabled = self.movement is None

    def _draw(self) -> None:
        if self.movement is not None:
            t = float(self._time.value)
            self._page.pose(self.movement.joints_at(t))
            self._page.place_body(self.movement.body_at(t))

    # Callbacks, in the thread of the event loop

    async def _on_choice(self, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._chosen = self._choice.value
            self._show(self._chosen)

    async def _on_time(self, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._chosen = self._choice.value
            self._draw()

    async def _on_button(self, _: viser.GuiEvent) -> None:
        self._chosen, self._playing = self._choice.value, not self._playing
        self._button.label = "Pause playback" if self._playing else "Play"
