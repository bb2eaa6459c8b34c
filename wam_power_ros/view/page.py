# SPDX-License-Identifier: Apache-2.0
"""Scene and panels in the browser, drawn with viser: arm, paths, attractors, state, curve."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
import viser
from viser import uplot

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.policy_shapes import ellipsoids
from wam_power_ros.practice.session_log import KIND_NAMES
from wam_power_ros.view.skeleton import Shape, Skeleton

PLANNED, EXECUTED, ATTRACTOR = (37, 99, 235), (234, 88, 12), (13, 148, 136)
TRAIL = (250, 176, 120)
BODY_TOP, BODY_UNDER = (250, 204, 110), (146, 84, 32)
BODY_RADIUS, BODY_HEIGHT = 0.09, 0.006  # [m] of each half of the disc that represents a body
PATH_THICKNESS = 0.006  # [m]
KIND_COLOURS = {  # as in the report
    "reproduction": "#5b6570",
    "explore": "#3b6ea5",
    "mean": "#d98324",
    "retest": "#2f855a",
}
BEST_COLOUR = "#9b3fe0"
NO_SAFETY = "Stop is a request over the network, **no safety function**: use the pendant."


def plain(text: str) -> str:
    """Escape untrusted text for Markdown, in which the browser renders HTML."""
    return re.sub(r"([\\`*_\[\]|~])", r"\\\1", escape(" ".join(text.split()), quote=False))


class Page:
    """One page, the same in every browser that opens it.

    Attributes:
        skeleton: Drawn arm, None before the first.
        terms: Text below the learning curve.
    """

    def __init__(self, server: viser.ViserServer, title: str) -> None:
        self.server = server
        scene, gui = server.scene, server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label(f"wam-power view · {title}")
        server.initial_camera.position = (1.35, -1.5, 1.15)
        server.initial_camera.look_at = (0.5, 0.0, 0.55)
        scene.add_grid("/ground", width=4.0, height=4.0, cell_size=0.1, section_size=0.5)
        self.skeleton: Skeleton | None = None
        self._links: list[viser.FrameHandle] = []
        self._body: viser.FrameHandle | None = None
        self._attractors: list[viser.SceneNodeHandle] = []
        self._is_shown: dict[str, bool] = {}
        with gui.add_folder("State"):
            self._state = gui.add_markdown("")

    # Scene

    def show_arm(self, skeleton: Skeleton) -> None:
        """Draw an arm; it replaces the last one."""
        for handle in self._links:
            handle.remove()
        self.skeleton = skeleton
        scene = self.server.scene
        self._links = [scene.add_frame(f"/arm/{link}", show_axes=False) for link in skeleton.links]
        for number, shape in enumerate(skeleton.shapes):
            _add_shape(scene, f"/arm/{shape.link}/shape_{number}", shape)
        scene.add_frame(
            f"/arm/{skeleton.tool}/axes", axes_length=0.08, axes_radius=0.004, origin_radius=0.006
        )

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Draw the arm at joint angles (n,) [rad]; returns the position of the tool (3,) [m]."""
        positions, quats = self.skeleton.placements(q)
        with self.server.atomic():
            for handle, position, quat in zip(self._links, positions, quats, strict=True):
                handle.position, handle.wxyz = position, quat
        return positions[-1]

    def place_body(self, state: tuple[np.ndarray, np.ndarray] | None) -> None:
        """Draw the tracked body at a position [m] and quaternion wxyz; None hides it."""
        if state is None:
            if self._body is not None:
                self._body.visible = False
            return
        if self._body is None:
            self._body = _add_body(self.server.scene)
        with self.server.atomic():
            self._body.position, self._body.wxyz = state
            self._body.visible = self._is_shown.get("body", True)

    def show_path(self, name: str, points: np.ndarray, rgb: tuple[int, int, int]) -> None:
        """Draw a path; it replaces the last one with that name.

        Args:
            name: "planned", "executed" or "trail".
            points: Points of the path [m]; fewer than two draw nothing. Shape (T, 3).
            rgb: Colour.
        """
        if len(points) < 2:
            points = np.zeros((2, 3))
        self.server.scene.add_line_segments(
            f"/{name}",
            np.stack([points[:-1], points[1:]], axis=1).astype(np.float32),
            rgb,
            thickness=PATH_THICKNESS,
            visible=self._is_shown.get("executed" if name == "trail" else name, True),
        )

    def show_attractors(self, policy: Policy | None) -> None:
        """Draw the attractors of a policy as stiffness ellipsoids; None draws none."""
        for handle in self._attractors:
            handle.remove()
        self._attractors = []
        drawn = () if policy is None else zip(*ellipsoids(policy), strict=True)
        for number, (centre, semi_axes, quat) in enumerate(drawn):
            handle = self.server.scene.add_icosphere(
                f"/attractors/{number}",
                radius=1.0,
                color=ATTRACTOR,
                opacity=0.3,
                scale=tuple(map(float, semi_axes)),
                position=centre,
                wxyz=quat,
                cast_shadow=False,
                visible=self._is_shown.get("attractors", True),
            )
            self._attractors.append(handle)

    # Panels

    def state(self, lines: Mapping[str, str]) -> None:
        """Show lines such as {"controller": "hold"}."""
        text = "  \n".join(f"**{plain(name)}** {plain(value)}" for name, value in lines.items())
        if text != self._state.content:
            self._state.content = text

    def add_legend(self, body: str, policies: bool = True) -> None:
        """Add a panel with a checkbox for each kind of drawing, and its colour."""
        executed = lambda: [self._node("/executed"), self._node("/trail")]  # noqa: E731
        kinds = {"executed": ("executed path (orange)", executed)}
        if policies:
            kinds["planned"] = ("planned path (blue)", lambda: [self._node("/planned")])
            kinds["attractors"] = ("stiffness at attractors (green)", lambda: self._attractors)
        if body:
            kinds["body"] = (f"tracked {body}", lambda: [self._body])
        with self.server.gui.add_folder("Show"):
            for name, (label, handles) in kinds.items():
                box = self.server.gui.add_checkbox(label, True)
                self._is_shown[name] = True
                box.on_update(self._toggle(name, box, handles))

    def _toggle(self, name: str, box: Any, handles: Callable[[], list]) -> Callable:  # noqa: ANN401
        def toggle(_: object) -> None:
            self._is_shown[name] = box.value
            for handle in handles():
                if handle is not None:
                    handle.visible = box.value

        return toggle

    def _node(self, name: str) -> Any:  # noqa: ANN401 - of any kind
        return self.server.scene.get_handle_by_name(name)

    def add_buttons(
        self,
        folder: str,
        buttons: Mapping[str, tuple[str, str, Callable[[], object]]],
        note: str = "",
    ) -> dict[str, viser.GuiButtonHandle]:
        """Add a panel of buttons.

        Args:
            folder: Title of the panel.
            buttons: Label -> colour, hint and function to call on a click.
            note: Text below the buttons.

        Returns:
            The buttons by label.
        """
        handles = {}
        with self.server.gui.add_folder(folder):
            for label, (colour, hint, act) in buttons.items():
                button = self.server.gui.add_button(label, color=colour, hint=hint)
                button.on_click(lambda _, act=act: act())
                handles[label] = button
            if note:
                self.server.gui.add_markdown(note)
        return handles

    def notify(self, title: str, text: str, good: bool = True) -> None:
        """Show a notification in every browser."""
        for client in self.server.get_clients().values():
            client.add_notification(
                title, text, auto_close_seconds=6.0, color="green" if good else "red"
            )

    def add_curve(self, names: Sequence[str]) -> viser.GuiUplotHandle:
        """Add a panel with the learning curve.

        Args:
            names: Kinds of rollouts, one series each; the series of the best return is added last.

        Returns:
            Chart, whose `data` are the columns: rollout numbers, returns of each kind, best return.
        """
        points = [
            uplot.Series(
                label=KIND_NAMES[name],
                stroke=KIND_COLOURS[name],
                width=0,
                points={"show": True, "size": 7, "fill": KIND_COLOURS[name]},
            )
            for name in names
        ]
        series = (
            uplot.Series(label="rollout"),
            *points,
            uplot.Series(label="best", stroke=BEST_COLOUR, width=2, points={"show": False}),
        )
        empty = tuple(np.zeros(0) for _ in series)
        with self.server.gui.add_folder("Learning"):
            chart = self.server.gui.add_uplot(
                empty,
                series,
                scales={"x": uplot.Scale(time=False), "y": uplot.Scale(range=(0.0, 1.1))},
                axes=(uplot.Axis(label="rollout"), uplot.Axis(label="return")),
                legend=viser.uplot.Legend(show=True, live=False),
                height=220,
            )
            self.terms = self.server.gui.add_markdown("")
        return chart


def _add_shape(scene: viser.SceneApi, name: str, shape: Shape) -> None:
    common = {"color": shape.rgb, "position": shape.position, "wxyz": shape.quat_wxyz}
    if shape.kind == "cylinder":
        radius, length = shape.size
        scene.add_cylinder(name, radius, length, **common)
    elif shape.kind == "sphere":
        scene.add_icosphere(name, shape.size[0], **common)
    else:
        scene.add_box(name, dimensions=shape.size, **common)


def _add_body(scene: viser.SceneApi) -> viser.FrameHandle:
    """Add a disc with different colours above and below, which shows the body's rotation."""
    frame = scene.add_frame("/body", show_axes=False)
    for name, side, rgb in (("top", 0.5, BODY_TOP), ("under", -0.5, BODY_UNDER)):
        position = (0.0, 0.0, side * BODY_HEIGHT)
        scene.add_cylinder(f"/body/{name}", BODY_RADIUS, BODY_HEIGHT, rgb, position=position)
    return frame
