# SPDX-License-Identifier: Apache-2.0
"""Policy: everything needed to execute a movement, as data and as JSON text.

The same text is saved on disk and published on `/policy`. Parsing is strict: an unknown or missing
key, a number that is not finite, a wrong shape or a stiffness that is not positive definite raises
a ValueError that names it. Floats survive the round trip bit for bit.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from wam_power_ros import plain_json
from wam_power_ros.arm_identity import JOINTS_MAX, ArmIdentity, identity_of

SCHEMA = "wam_power_ros/policy/2"  # version 1, without the identity of the arm, is still read
PERIOD = 0.002  # control period [s]
SIZE_MAX = 1_000_000  # largest JSON text [byte]
COUNT_MAX = 200  # largest number of spring-dampers
DURATION_MAX = 60.0  # longest movement [s]
STIFFNESS_MAX = 1e5  # largest element of a translational or rotational stiffness [1/s^2]
DAMPING_MAX = 1e3  # damping above 2 / PERIOD is unstable at the control period [1/s]
POSITION_MAX = 10.0  # largest coordinate of an attractor [m]
ANGLE_MAX = 30.0  # largest joint angle or element of a rotation vector [rad]

_ID = re.compile(r"[A-Za-z0-9_.-]{1,64}")


def check_id(policy_id: str) -> None:
    """Check that an id can be a file name and part of a message.

    Raises:
        ValueError: If the id does not match [A-Za-z0-9_.-]{1,64}.
    """
    if not isinstance(policy_id, str) or not _ID.fullmatch(policy_id):
        shown = repr(policy_id)
        shown = shown if len(shown) <= 100 else shown[:100] + "..."
        raise ValueError(f"id {shown} must match {_ID.pattern}")


def read_only(
    name: str,
    value: np.ndarray | Sequence[Any] | float,
    shape: tuple[int, ...],
    limit: float = np.inf,
) -> np.ndarray:
    """Check an array and return a read-only float copy of it.

    Raises:
        ValueError: If an element is not a number, not finite or beyond the limit, or the shape
            differs.
    """
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} is not an array of numbers: {error}") from None
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; it must be {shape}")
    bad = ~np.isfinite(array) | (np.abs(array) > limit)
    if bad.any():
        at = tuple(int(i) for i in np.argwhere(bad)[0])
        rule = "finite" if limit == np.inf else f"finite and at most {limit} in magnitude"
        raise ValueError(f"{name}{list(at) or ''} = {array[at]} must be {rule}")
    array.setflags(write=False)
    return array


def _check_number(name: str, value: float, limit: float) -> float:
    number = float(read_only(name, value, ()))
    if not 0.0 < number <= limit:
        raise ValueError(f"{name} = {number} must be in (0, {limit}]")
    return number


@dataclass(frozen=True)
class Basis:
    """Normalised Gaussians in time, h_i(t) of Eq. 1, with centres spread evenly over [0, duration].

    Raises:
        ValueError: If a value is out of range.
    """

    count: int
    duration: float  # of the movement [s]
    variance: float  # of each Gaussian [s^2]

    def __post_init__(self) -> None:
        if isinstance(self.count, bool) or not isinstance(self.count, int | np.integer):
            raise ValueError(f"count = {self.count!r} must be an integer")
        if not 1 <= self.count <= COUNT_MAX:
            raise ValueError(f"count = {self.count} must be in 1..{COUNT_MAX}")
        object.__setattr__(self, "count", int(self.count))
        duration = _check_number("duration", self.duration, DURATION_MAX)
        object.__setattr__(self, "duration", duration)
        variance = _check_number("variance", self.variance, DURATION_MAX**2)
        if variance < 1e-8:
            raise ValueError(f"variance = {variance} must be at least 1e-8")
        object.__setattr__(self, "variance", variance)

    @property
    def centres(self) -> np.ndarray:
        """Centres of the Gaussians [s]. Shape (count,)."""
        return np.linspace(0.0, self.duration, self.count)


@dataclass(frozen=True, eq=False)
class Policy:
    """Mixture of n spring-dampers (Eq. 1) for the tool's position, with its orientation profile.

    Arrays are copied and read-only.

    Raises:
        ValueError: If a value is out of range; the message names the value and the rule.
    """

    id: str  # of the policy and of its rollout, [A-Za-z0-9_.-]{1,64}
    basis: Basis  # weights h_i(t)
    stiffness: np.ndarray  # K_i [1/s^2], symmetric part positive definite, shape (n, 3, 3)
    attractors: np.ndarray  # mu_i in the base frame [m], shape (n, 3)
    damping: float  # kappa_V [1/s]
    orientation_reference: np.ndarray  # R_ref as a unit quaternion xyzw, shape (4,)
    rotation_attractors: np.ndarray  # r_i in the base frame, R = exp(r) R_ref [rad], shape (n, 3)
    rotation_stiffness: float  # [1/s^2]
    rotation_damping: float  # [1/s]
    q_start: np.ndarray  # joint angles at the start of the demonstration [rad], shape (nj,)
    arm: ArmIdentity | None = None  # that it was learnt on; None if unknown

    def __post_init__(self) -> None:
        check_id(self.id)
        if not isinstance(self.basis, Basis):
            raise ValueError(f"basis = {self.basis!r} must be a Basis")
        n = self.basis.count
        for name, shape, limit in (
            ("stiffness", (n, 3, 3), STIFFNESS_MAX),
            ("attractors", (n, 3), POSITION_MAX),
            ("orientation_reference", (4,), 1.0 + 1e-6),
            ("rotation_attractors", (n, 3), ANGLE_MAX),
            ("q_start", (np.size(self.q_start),), ANGLE_MAX),
        ):
            object.__setattr__(self, name, read_only(name, getattr(self, name), shape, limit))
        for name, limit in (
            ("damping", DAMPING_MAX),
            ("rotation_stiffness", STIFFNESS_MAX),
            ("rotation_damping", DAMPING_MAX),
        ):
            object.__setattr__(self, name, _check_number(name, getattr(self, name), limit))
        if not 1 <= len(self.q_start) <= JOINTS_MAX:
            raise ValueError(f"q_start has {len(self.q_start)} joints; 1..{JOINTS_MAX} allowed")
        if self.arm is not None and len(self.arm.joint_names) != len(self.q_start):
            raise ValueError(f"q_start has {len(self.q_start)} joints, the arm is {self.arm}")
        norm = float(np.linalg.norm(self.orientation_reference))
        if abs(norm - 1.0) > 1e-6:
            raise ValueError(f"orientation_reference has length {norm}; it must be 1")
        smallest = np.linalg.eigvalsh(symmetric_part(self.stiffness))[:, 0]
        if np.any(smallest <= 0.0):
            i = int(np.argmin(smallest))
            raise ValueError(
                f"stiffness[{i}] has eigenvalue {smallest[i]} in its symmetric part; "
                "it must be positive definite"
            )


def symmetric_part(matrices: np.ndarray) -> np.ndarray:
    """Symmetric parts of square matrices (..., m, m). Same shape."""
    return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))


def at_tempo(policy: Policy, tempo: float) -> Policy:
    """Policy that moves along the same path at `tempo` times the speed.

    Eq. 1 in the time t' = tempo t: damping is multiplied by the tempo, stiffness by its square.

    Raises:
        ValueError: If a value of the new policy is out of range.
    """
    return replace(
        policy,
        basis=replace(
            policy.basis,
            duration=policy.basis.duration / tempo,
            variance=policy.basis.variance / tempo**2,
        ),
        stiffness=policy.stiffness * tempo**2,
        damping=policy.damping * tempo,
        rotation_stiffness=policy.rotation_stiffness * tempo**2,
        rotation_damping=policy.rotation_damping * tempo,
    )


def with_id(policy: Policy, policy_id: str) -> Policy:
    """Return the same policy under another id.

    Raises:
        ValueError: If the id is not allowed.
    """
    return replace(policy, id=policy_id)


_Number = Annotated[float, Field(allow_inf_nan=False)]
_Vector = Annotated[list[_Number], Field(min_length=3, max_length=3)]
_Matrix = Annotated[list[_Vector], Field(min_length=3, max_length=3)]


class _Text(BaseModel):
    """Keys of the JSON text."""

    model_config = ConfigDict(strict=True, extra="forbid")

    schema_version: Literal["wam_power_ros/policy/1", "wam_power_ros/policy/2"] = Field(
        alias="schema"
    )
    id: str
    count: int
    duration: _Number
    variance: _Number
    stiffness: Annotated[list[_Matrix], Field(max_length=COUNT_MAX)]
    attractors: Annotated[list[_Vector], Field(max_length=COUNT_MAX)]
    damping: _Number
    orientation_reference_xyzw: Annotated[list[_Number], Field(min_length=4, max_length=4)]
    rotation_attractors: Annotated[list[_Vector], Field(max_length=COUNT_MAX)]
    rotation_stiffness: _Number
    rotation_damping: _Number
    q_start: Annotated[list[_Number], Field(min_length=1, max_length=JOINTS_MAX)]
    arm: dict[str, Any] | None = None


def to_json(policy: Policy) -> str:
    """Return the policy as one line of JSON, the same text for equal policies."""
    return json.dumps(
        {
            "schema": SCHEMA,
            "id": policy.id,
            "count": policy.basis.count,
            "duration": policy.basis.duration,
            "variance": policy.basis.variance,
            "stiffness": policy.stiffness.tolist(),
            "attractors": policy.attractors.tolist(),
            "damping": policy.damping,
            "orientation_reference_xyzw": policy.orientation_reference.tolist(),
            "rotation_attractors": policy.rotation_attractors.tolist(),
            "rotation_stiffness": policy.rotation_stiffness,
            "rotation_damping": policy.rotation_damping,
            "q_start": policy.q_start.tolist(),
            "arm": None if policy.arm is None else policy.arm._asdict(),
        },
        allow_nan=False,
    )


def from_json(text: str) -> Policy:
    """Parse a policy from JSON text of `to_json`, of at most SIZE_MAX bytes.

    Raises:
        ValueError: If the text is not a valid policy; the message names the first defect.
    """
    if not isinstance(text, str):
        raise ValueError(f"a policy is JSON text, not {type(text).__name__}")
    data = plain_json.parse(text, "policy text", SIZE_MAX)
    try:
        parsed = _Text.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "text"
        raise ValueError(f"policy text: {where}: {first['msg']}") from None
    return Policy(
        id=parsed.id,
        basis=Basis(parsed.count, parsed.duration, parsed.variance),
        stiffness=np.array(parsed.stiffness),
        attractors=np.array(parsed.attractors),
        damping=parsed.damping,
        orientation_reference=np.array(parsed.orientation_reference_xyzw),
        rotation_attractors=np.array(parsed.rotation_attractors),
        rotation_stiffness=parsed.rotation_stiffness,
        rotation_damping=parsed.rotation_damping,
        q_start=np.array(parsed.q_start),
        arm=None if parsed.arm is None else identity_of(parsed.arm),
    )
