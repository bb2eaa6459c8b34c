# SPDX-License-Identifier: Apache-2.0
"""Arm as shapes for drawing: the shapes of its URDF, placed by forward kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wam_power_ros import rotations
from wam_power_ros.control.arm import rebased
from wam_power_ros.control.urdf_checks import parsed


class Skeleton:
    """Frames of an arm, with their shapes and forward kinematics.

    Attributes:
        joint_names: Moving joints, base to tip; others stay at zero.
        shapes: Shapes of the links, each fixed to the frame `parentJoint`. Meshes are left out.

    Args:
        joint_names: Moving joints; all joints that are not fixed if omitted.
        base_frame: Link whose frame all poses are in; the root if empty.

    Raises:
        ValueError: The text is no URDF, or has no such joint or link.
    """

    def __init__(
        self, urdf: str, joint_names: Sequence[str] | None = None, base_frame: str = ""
    ) -> None:
        try:
            tree = parsed(urdf)
            for link in tree.iter("link"):
                for visual in link.findall("visual"):
                    if visual.find("geometry/mesh") is not None:
                        link.remove(visual)
            for joint in tree.iter("joint"):
                if joint.get("type") == "continuous":  # of one number, as its state has
                    joint.set("type", "revolute")
                    if joint.find("limit") is None:
                        ElementTree.SubElement(joint, "limit", effort="0", velocity="0")
            text = ElementTree.tostring(tree, encoding="unicode")
            self._model = model = pin.buildModelFromXML(text)
            self._visual = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL)
        except (ValueError, RuntimeError) as error:
            raise ValueError(f"the robot description is no URDF: {error}") from None
        known = [name for name in model.names if name != "universe"]
        self.joint_names = tuple(known if joint_names is None else joint_names)
        missing = [name for name in self.joint_names if name not in known]
        if missing or not self.joint_names:
            raise ValueError(f"joints {missing} are not in the robot description; known: {known}")
        self._columns = [model.joints[model.getJointId(name)].idx_q for name in self.joint_names]
        if base_frame:
            root = rebased(model, base_frame)
            for shape in self._visual.geometryObjects:
                if shape.parentJoint == 0:
                    shape.placement = root * shape.placement
        self._data = model.createData()
        self._tip = [i for i, f in enumerate(model.frames) if f.type == pin.FrameType.BODY][-1]
        self.shapes = tuple(self._visual.geometryObjects)

    def placements(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (J + 2, 3) [m] and quaternions wxyz (J + 2, 4) at joint angles [rad] (n,).

        These are of the base, of each of the J joints that are not fixed, and of the tool.
        """
        full = pin.neutral(self._model)
        full[self._columns] = q
        pin.framesForwardKinematics(self._model, self._data, full)
        placed = [*self._data.oMi, self._data.oMf[self._tip]]
        quat_xyzw = rotations.quat_xyzw(np.array([place.rotation for place in placed]))
        return np.array([place.translation for place in placed]), np.roll(quat_xyzw, 1, axis=-1)
