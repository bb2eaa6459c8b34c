# SPDX-License-Identifier: Apache-2.0
"""Scene and panels in the browser, drawn with viser: arm, paths, attractors, state, curve."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape

import coal
import numpy as np
import pinocchio as pin
import viser
from viser import uplot

from wam_power_ros.learning.policy import Policy
from wam_power_ros.learning.policy_shapes import ellipsoids, plan
from wam_power_ros.practice.session_log import KIND_NAMES
from wam_power_ros.reporting.figures import POINTS
from wam_power_ros.view.guarded_server import GuardedServer
from wam_power_ros.view.skeleton import Skeleton

BLUE, ORANGE, GREEN = (37, 99, 235), (234, 88, 12), (13, 148, 136)
LIGHT_ORANGE, GREY = (250, 176, 120), (190, 190, 185)
SHOWN = {
    "executed": "executed path (orange)",
    "planned": "planned path (blue)",
    "attractors": "stiffness at attractors (green)",
}
BODY_TOP, BODY_UNDER = (250, 204, 110), (146, 84, 32)
BODY_RADIUS, BODY_HEIGHT = 0.09, 0.006  # [m] of each half of the disc that represents a body
BALL_RADIUS = 0.02  # [m] of one without an orientation, as of one marker
NOT_TURNED = (1.0, 0.0, 0.0, 0.0)
PATH_THICKNESS, STICK_THICKNESS = 0.006, 0.06  # [m]
CAMERA, TARGET = (1.35, -1.5, 1.15), (0.5, 0.0, 0.55)  # [m]
BEST_COLOUR = "#9b3fe0"
NO_SAFETY = "Stop is a request over the network, **no safety function**: use the pendant."


def plain(text: str) -> str:
    """Escape untrusted text for Markdown, in which the browser renders HTML."""
    return re.sub(r"([\\`*_\[\]|~])", r"\\\1", escape(" ".join(text.split()), quote=False))


class Page:
    """One page, the same in every browser that opens it, drawn by `GuardedServer.draw` alone."""

    def __init__(self, server: GuardedServer, title: str) -> None:
        self.server = server
        scene, gui = server.scene, server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label(f"wam-power view · {title}")
        server.initial_camera.position, server.initial_camera.look_at = CAMERA, TARGET
        scene.add_grid("/ground", width=4.0, height=4.0, cell_size=0.1, section_size=0.5)
        self.skeleton: Skeleton | None = None
        self._frames: list[viser.FrameHandle] = []
        groups = (*SHOWN, "body", "arm", "attractors/shown")
        self._groups = {name: scene.add_frame(f"/{name}", show_axes=False) for name in groups}
        self._body = scene.add_frame("/body/at", show_axes=False, visible=False)
        self._turns = False  # whether the body has had an orientation
        self._disc = scene.add_frame("/body/at/disc", show_axes=False)
        self._ball = scene.add_icosphere("/body/at/ball", BALL_RADIUS, BODY_TOP, visible=False)
        for name, side, rgb in (("top", 0.5, BODY_TOP), ("under", -0.5, BODY_UNDER)):
            place = (0.0, 0.0, side * BODY_HEIGHT)  # other colours tell how it has turned
            scene.add_cylinder(
                f"/body/at/disc/{name}", BODY_RADIUS, BODY_HEIGHT, rgb, position=place
            )
        with gui.add_folder("State"):
            self._state = gui.add_markdown("")

    # Scene

    def _emptied(self, name: str) -> None:
        """Remove what a group contains."""
        self._groups[name].remove()
        self._groups[name] = self.server.scene.add_frame(f"/{name}", show_axes=False)

    def show_arm(self, skeleton: Skeleton) -> None:
        """Draw an arm; it replaces the last one."""
        self._emptied("arm")
        self.skeleton, scene = skeleton, self.server.scene
        count = len(skeleton.placements(np.zeros(len(skeleton.joint_names)))[0])
        self._frames = [scene.add_frame(f"/arm/{i}", show_axes=False) for i in range(count)]
        for number, shape in enumerate(skeleton.shapes):
            _add_shape(scene, f"/arm/{shape.parentJoint}/shape_{number}", shape)
        scene.add_frame(
            f"/arm/{count - 1}/axes", axes_length=0.08, axes_radius=0.004, origin_radius=0.006
        )

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Draw the arm at joint angles (n,) [rad]; returns the position of the tool (3,) [m]."""
        positions, quats = self.skeleton.placements(q)
        with self.server.atomic():
            for handle, position, quat in zip(self._frames, positions, quats, strict=True):
                handle.position, handle.wxyz = position, quat
            if not self.skeleton.shapes:
                self.show_path("arm/sticks", positions, GREY, STICK_THICKNESS)
        return positions[-1]

    def place_body(self, state: tuple[np.ndarray, np.ndarray] | None) -> None:
        """Draw the tracked body at a position [m] and quaternion wxyz; None hides it.

        It is a ball until it has an orientation, from then on a disc.
        """
        with self.server.atomic():
            if state is not None:
                self._body.position, self._body.wxyz = state
                turns = self._turns = self._turns or tuple(state[1]) != NOT_TURNED
                self._disc.visible, self._ball.visible = turns, not turns
            self._body.visible = state is not None

    def show_path(
        self,
        name: str,
        points: np.ndarray,
        rgb: tuple[int, int, int],
        thickness: float = PATH_THICKNESS,
    ) -> None:
        """Draw a path of points (T, 3) [m], fewer than two draw nothing, with a thickness [m].

        It replaces the last one with that name: group and name, such as "executed/trail".
        """
        if len(points) < 2:
            points = np.zeros((2, 3))
        segments = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        self.server.scene.add_line_segments(f"/{name}", segments, rgb, thickness=thickness)

    def show_policy(self, policy: Policy, start: np.ndarray) -> None:
        """Draw a policy: its path from `start` (3,) [m], its attractors as stiffness ellipsoids."""
        self.show_path("planned/path", plan(policy, start), BLUE)
        self._emptied("attractors/shown")
        for number, shape in enumerate(zip(*ellipsoids(policy), strict=True)):
            centre, semi_axes, quat = shape
            self.server.scene.add_icosphere(
                f"/attractors/shown/{number}",
                radius=1.0,
                color=GREEN,
                opacity=0.3,
                scale=tuple(map(float, semi_axes)),
                position=centre,
                wxyz=quat,
                cast_shadow=False,
            )

    # Panels

    def state(self, lines: Mapping[str, str]) -> None:
        """Show lines such as {"controller": "hold"}."""
        text = "  \n".join(f"**{plain(name)}** {plain(value)}" for name, value in lines.items())
        if text != self._state.content:
            self._state.content = text

    def add_legend(self, body: str) -> None:
        """Add a panel with a checkbox for each kind of drawing, and its colour."""
        shown = SHOWN | ({"body": f"tracked {body}"} if body else {})
        with self.server.gui.add_folder("Show"):
            for name, label in shown.items():
                self.server.gui.add_checkbox(label, True).on_update(partial(self._toggle, name))

    async def _toggle(self, name: str, event: viser.GuiEvent) -> None:
        self._groups[name].visible = event.target.value

    def add_buttons(
        self, buttons: Mapping[str, tuple[str, str, Callable[[], object]]]
    ) -> dict[str, viser.GuiButtonHandle]:
        """Add the panel of buttons; returns them by label.

        A button has a colour, a hint and a function that a thread calls on a click.
        """
        handles = {}
        with self.server.gui.add_folder("Practice"):
            for label, (colour, hint, act) in buttons.items():
                handles[label] = self.server.gui.add_button(label, color=colour, hint=hint)
                handles[label].on_click(lambda _, act=act: act())
            self.server.gui.add_markdown(NO_SAFETY)
        return handles

    def notify(self, title: str, text: str, good: bool = True) -> None:
        """Show a notification in every browser."""
        for client in self.server.get_clients().values():
            client.add_notification(
                title, text, auto_close_seconds=6.0, color="green" if good else "red"
            )

    def add_curve(self, kinds: Sequence[str]) -> viser.GuiUplotHandle:
        """Add a panel with the learning curve, with a series for each kind of rollout.

        The `data` of the chart are columns: rollout numbers, returns of each kind, best return.
        """
        series = [uplot.Series(label="rollout")]
        for kind in kinds:
            (_, _, colour), name = POINTS[kind], KIND_NAMES[kind]
            points = {"show": True, "size": 7, "fill": colour}
            series.append(uplot.Series(label=name, stroke=colour, width=0, points=points))
        best = {"stroke": BEST_COLOUR, "width": 2, "points": {"show": False}}
        series.append(uplot.Series(label="best", **best))
        with self.server.gui.add_folder("Learning"):
            chart = self.server.gui.add_uplot(
                tuple(np.zeros(0) for _ in series),
                tuple(series),
                scales={"x": uplot.Scale(time=False), "y": uplot.Scale(range=(0.0, 1.1))},
                axes=(uplot.Axis(label="rollout"), uplot.Axis(label="return")),
                legend=uplot.Legend(show=True, live=False),
                height=220,
            )
            self.terms = self.server.gui.add_markdown("")  # below the learning curve
        return chart


def _add_shape(scene: viser.SceneApi, name: str, shape: pin.GeometryObject) -> None:
    solid, place = shape.geometry, shape.placement
    placed = {"position": place.translation, "wxyz": np.roll(pin.SE3ToXYZQUAT(place)[3:], 1)}
    placed["color"] = tuple(round(255 * float(part)) for part in shape.meshColor[:3])
    if isinstance(solid, coal.Cylinder):
        scene.add_cylinder(name, solid.radius, 2.0 * solid.halfLength, **placed)
    elif isinstance(solid, coal.Sphere):
        scene.add_icosphere(name, solid.radius, **placed)
    elif isinstance(solid, coal.Box):
        scene.add_box(name, dimensions=tuple(2.0 * solid.halfSide), **placed)
