# SPDX-License-Identifier: Apache-2.0
"""What was measured on one arm and differs from its URDF; see `commissioning`.

The arm's identity stays that of its URDF: the same arm, better known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pinocchio as pin

GRAVITY = 9.81  # [m/s^2]


@dataclass(frozen=True, eq=False)
class Corrections:
    """Corrections of an arm with n joints.

    Attributes:
        zeros: Reported minus true position of each joint [rad]. Shape (n,).
        torque_scales: True torque of each joint over the commanded one. Shape (n,).
        coulomb_friction: [N m]; negative where that of the URDF holds. Shape (n,).
        viscous_friction: [N m s/rad]; negative where that of the URDF holds. Shape (n,).
        friction_asymmetry: Share by which Coulomb friction is larger forwards than on average.
            Shape (n,).
        low_speed_friction: Share of Coulomb friction that is added at low speed, after Stribeck.
            Shape (n,).
        link_masses: Mass of what each joint moves before the next, over that of the URDF, and so
            its moments. Shape (n,).
        payload: Mass at the tool beyond the URDF's [kg], and its first moment in the tool's frame
            [kg m]: a payload of mass m at c has m, m c. Shape (4,).
        base_tilt: Rotation of the base from upright, about its x axis and then its y axis [rad].
            Shape (2,).
    """

    zeros: np.ndarray
    torque_scales: np.ndarray
    coulomb_friction: np.ndarray
    viscous_friction: np.ndarray
    friction_asymmetry: np.ndarray
    low_speed_friction: np.ndarray
    link_masses: np.ndarray
    payload: np.ndarray
    base_tilt: np.ndarray

    @classmethod
    def from_values(cls, n: int, **values: Any) -> Corrections:  # noqa: ANN401 - numbers of any kind
        """Corrections of some quantities of an arm with n joints; one number holds for all joints.

        Raises:
            ValueError: A quantity has neither one number nor as many as it needs.
        """
        neutral = {"torque_scales": 1.0, "link_masses": 1.0}
        neutral |= {"coulomb_friction": -1.0, "viscous_friction": -1.0}
        sizes = {"payload": 4, "base_tilt": 2}
        arrays = {}
        for each in fields(cls):
            size = sizes.get(each.name, n)
            given = np.atleast_1d(np.asarray(values.pop(each.name, neutral.get(each.name, 0.0))))
            if given.shape not in ((1,), (size,)) or not np.isfinite(given).all():
                text = f"{each.name} {given.tolist()} must be {size} finite numbers"
                raise ValueError(f"{text}, or one for all")
            arrays[each.name] = np.broadcast_to(given.astype(float), (size,)).copy()
        if values:
            raise ValueError(f"{sorted(values)} are no corrections of an arm")
        for name in ("torque_scales", "link_masses"):
            if np.any(arrays[name] <= 0.0):
                raise ValueError(f"{name} {arrays[name].tolist()} must be positive")
        return cls(**arrays)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Any]) -> Corrections:
        """Corrections of the parameters of the torque controller, by name.

        Raises:
            ValueError: As for `of`.
        """
        names = [each.name for each in fields(cls)]
        values = {name: parameters["joint_zeros" if name == "zeros" else name] for name in names}
        return cls.from_values(len(parameters["model_joint_names"]), **values)

    @property
    def gravity(self) -> np.ndarray:
        """Acceleration of gravity in the frame of the base [m/s^2]. Shape (3,)."""
        x, y = self.base_tilt.tolist()
        down = np.array([np.cos(x) * np.sin(y), -np.sin(x), -np.cos(x) * np.cos(y)])
        return GRAVITY * down

    @property
    def of_gravity(self) -> bool:
        """Whether they change g(q)."""
        return bool(
            self.zeros.any()
            or self.base_tilt.any()
            or self.payload.any()
            or (self.link_masses != 1.0).any()
        )

    def apply(self, model: pin.Model, tool_frame: int, root: np.ndarray) -> None:
        """Correct a model of the arm in place, all but its torques.

        Args:
            root: Axes of the URDF's root link, which the tilt is of, as columns. Shape (3, 3).

        Raises:
            ValueError: The tool's link would be left without mass.
        """
        # What is not corrected keeps the URDF's numbers bit for bit.
        if self.zeros.any():
            data = model.createData()
            pin.forwardKinematics(model, data, -self.zeros)
            for joint in range(1, model.njoints):  # turned back by its zero, about its own axis
                model.jointPlacements[joint] = data.liMi[joint]
            model.lowerPositionLimit = model.lowerPositionLimit + self.zeros
            model.upperPositionLimit = model.upperPositionLimit + self.zeros
        if self.base_tilt.any():
            model.gravity.linear = root @ self.gravity
        friction, damping = self.coulomb_friction, self.viscous_friction
        model.friction = np.where(friction < 0.0, model.friction, friction)
        model.damping = np.where(damping < 0.0, model.damping, damping)
        for joint, share in enumerate(self.link_masses.tolist(), start=1):
            if share != 1.0:
                link = model.inertias[joint]
                model.inertias[joint] = pin.Inertia(
                    share * link.mass, link.lever, share * link.inertia
                )
        if self.payload.any():
            self._load(model, model.frames[tool_frame])

    def _load(self, model: pin.Model, frame: pin.Frame) -> None:
        """Add the payload to the link of a frame."""
        link, placement = model.inertias[frame.parentJoint], frame.placement
        added, moment = self.payload[0], self.payload[1:]
        mass = link.mass + added
        if not mass > 0.0:
            raise ValueError(f"payload {added:g} kg leaves {mass:g} kg for the link of the tool")
        moment = placement.rotation @ moment + added * placement.translation
        lever = (link.mass * link.lever + moment) / mass
        model.inertias[frame.parentJoint] = pin.Inertia(float(mass), lever, link.inertia)
