# SPDX-License-Identifier: Apache-2.0
"""Whether what was measured may be used: values against what is allowed, and what to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wam_power_ros.commissioning.identification import tool_centre
from wam_power_ros.commissioning.measurement import Commissioned, Seen
from wam_power_ros.control.arm import Arm

# Of the body from its prediction: simulated arms that differ from their model as those of a
# laboratory's first day were at most 1.9 mm and 0.2 degrees away.
POSITION_MAX, ROTATION_MAX = 2.0, 0.5  # [mm], [degrees]
UPRIGHT_MAX = 5.0  # [degrees] between the vertical axes of base and cameras
ZERO_MAX = 5.0  # [degrees] beyond which a joint is to be zeroed anew
TILTED_MAX = 1.0  # [degrees] of a body that is said to lie flat; one taped by hand has 0.3
EARLY_MAX, LATE_MAX = 1.0, 200.0  # [ms] of a stamp before and after the exposure
LATENCY_CHANGE_MAX = 1.0  # [ms] between the two faster movements, half a minute apart
HALVED = 0.5  # share of the unexplained torque that may be left
EXPLAINED = 0.3  # [N m] unexplained torque that is acceptable whatever it was before
SCALE_MIN, SCALE_MAX = 0.85, 1.15  # of the commanded torque
WEIGHT_DEVIATIONS = 3.0  # standard deviations between the mass on a scale and that by the torques
ZERO_NOTED, TILT_NOTED = 2.0, 2.0  # [degrees] from which a zero or a tilt is noted
MASS_NOTED, CENTRE_NOTED = 0.15, 30.0  # [kg], [mm] the same of a tool
_BY_FLAT = (  # to the cameras both are the same, and the torques do not tell them apart either
    "a body tilted about that axis looks the same: before you zero the joint, lay a level into the "
    "tool, or turn the body by half a turn and measure again"
)


@dataclass(frozen=True)
class Finding:
    """A value that is not allowed, or that has to be known."""

    quantity: str  # what was measured
    value: float
    unit: str
    allowed: str  # empty if that cannot be said
    advice: str  # what to do

    def __str__(self) -> str:
        """The finding in one line."""
        value = f"{round(self.value, 2):.3g} {self.unit}".rstrip()
        allowed = self.allowed and f" (allowed: {self.allowed})"
        return f"{self.quantity}: {value}{allowed}; {self.advice}"


def refusals(arm: Arm, found: Commissioned, latency_offset: float) -> list[Finding]:
    """Reasons not to use a result, of an arm as its URDF describes it; none if it may be used.

    The set-up states a delay of the cameras' stamps, `latency_offset` [s].
    """
    of_cameras = [] if found.cameras is None else _of_cameras(arm, found.cameras, latency_offset)
    return of_cameras + _of_torques(arm, found)


def _of_cameras(arm: Arm, found: Seen, latency_offset: float) -> list[Finding]:
    cameras = found.frame
    axis = cameras.world_to_base.rotation[2]  # base z in the cameras' frame
    row = int(np.abs(axis).argmax())
    nearest = ("-" if axis[row] < 0.0 else "") + "xyz"[row]
    advice = f"it is nearest to their {nearest}: set up_axis, or the cameras' ground plane"
    upright = np.rad2deg(cameras.upright)
    rows = _outside("base's z axis to the cameras'", upright, "degrees", 0.0, UPRIGHT_MAX, advice)
    advices = ["zero the joint anew instead of correcting it"] * (arm.n - 1) + [_BY_FLAT]
    for name, zero, advice in zip(arm.joint_names, np.rad2deg(cameras.zeros), advices, strict=True):
        rows += _outside(f"zero of {name}", zero, "degrees", -ZERO_MAX, ZERO_MAX, advice)
    advice = "fasten cameras, body and markers, keep them in view, and measure again"
    for where, position, rotation in (
        ("at the rests that were used", found.fit_position, found.fit_rotation),
        ("at unused postures", found.check_position, found.check_rotation),
        ("in the sweeps", found.sweep_position, found.sweep_rotation),
    ):
        degrees, name = np.rad2deg(rotation), f"body from its prediction {where}"
        rows += _outside(name, 1e3 * position, "mm", 0.0, POSITION_MAX, advice)
        rows += _outside(name, degrees, "degrees", 0.0, ROTATION_MAX, advice)
    if cameras.zeros_sd[-1]:
        tilted = np.rad2deg(np.hypot(*cameras.body_in_tool.rotation[:2, 2]))
        advice = "the body does not lie flat: mend that, or leave out --flat"
        rows += _outside("normals of body and tool", tilted, "degrees", 0.0, TILTED_MAX, advice)
    late, change = 1e3 * (latency_offset + found.latency), 1e3 * found.latency_change
    advice = "synchronise the clocks of arm and cameras"
    rows += _outside("delay of the cameras' stamps", late, "ms", -EARLY_MAX, LATE_MAX, advice)
    limits = -LATENCY_CHANGE_MAX, LATENCY_CHANGE_MAX
    return rows + _outside("change of that delay in half a minute", change, "ms", *limits, advice)


def _of_torques(arm: Arm, found: Commissioned) -> list[Finding]:
    rows, c = [], found.arm.corrections
    advice = "tool, joints or the unit of the torques are other ones than the set-up says"
    for name in ("rest", "slow", "fast"):
        before, after = getattr(found.before, name), getattr(found.after, name)
        most = max(HALVED * before, EXPLAINED)
        rows += _outside(f"unexplained torque ({name})", after, "N m rms", 0.0, most, advice)
    advice = "check torque constants, order of motors, driver_compensates_gravity"
    for name, scale in zip(arm.joint_names, c.torque_scales, strict=True):
        rows += _outside(
            f"torque of {name} over the commanded one", scale, "", SCALE_MIN, SCALE_MAX, advice
        )
    own, room = tool_centre(arm)[0].mass, WEIGHT_DEVIATIONS * found.arm.felt_sd
    low, high = (own + found.arm.felt_payload + each for each in (-room, room))
    advice = "the torques say otherwise: weigh again all that the last joint carries"
    return rows + _outside("mass of the tool", own + c.payload[0], "kg", low, high, advice)


def notes(arm: Arm, found: Commissioned) -> list[Finding]:
    """What may be used but has to be known: what was left out, or is better mended."""
    c, rows = found.arm.corrections, []
    zeros = dict(zip(arm.joint_names, np.rad2deg(c.zeros), strict=True))
    if found.cameras is None:
        rows.append(Finding("rests with the body in view", 0, "", "", "no zeros and no frame"))
    else:
        frame = found.cameras.frame
        left_out = {"rejected": frame.rejected, "without a body": found.cameras.not_visible}
        for how, numbers in left_out.items():
            shown = ", ".join(str(number + 1) for number in numbers)
            advice = f"number {shown}: markers were hidden, or body or cameras moved"
            rows += _outside(f"rests {how}", len(numbers), "", 0.0, 0.0, advice)
        if frame.zeros_sd[-1]:
            name, zero = zeros.popitem()
            rows.append(Finding(f"zero of {name}, by --flat", zero, "degrees", "", _BY_FLAT))
    for name, zero in zeros.items():
        advice = "better zero the arm"
        rows += _outside(f"zero of {name}", zero, "degrees", -ZERO_NOTED, ZERO_NOTED, advice)
    tilt = np.rad2deg(np.hypot(*c.base_tilt))
    rows += _outside("tilt of the base", tilt, "degrees", 0.0, TILT_NOTED, "better level it")
    tool, centre = tool_centre(arm)
    added, moment = c.payload[0], c.payload[1:]
    moved = 1e3 * float(np.linalg.norm((moment - added * centre) / (tool.mass + added)))
    advice = "is the tool the right one? Better weigh it (--tool-mass) and mend the URDF"
    rows += _outside("tool beyond the URDF's", added, "kg", -MASS_NOTED, MASS_NOTED, advice)
    return rows + _outside("tool's centre to the URDF's", moved, "mm", 0.0, CENTRE_NOTED, advice)


def _outside(
    quantity: str, value: float, unit: str, low: float, high: float, advice: str
) -> list[Finding]:
    """The finding that a value is not in its range; none if it is. NaN never is."""
    if low <= value <= high:
        return []
    return [Finding(quantity, float(value), unit, f"{low:.3g} to {high:.3g}", advice)]
