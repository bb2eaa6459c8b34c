# SPDX-License-Identifier: Apache-2.0
"""What a commissioning has found, as lines of text and as a set-up file."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from typing import Any

import numpy as np
import yaml

from wam_power_ros import __version__, rotations
from wam_power_ros.commissioning.acceptance import notes
from wam_power_ros.commissioning.measurement import Commissioned
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.servo_response import Servo

RELIEF = 0.6  # share of the friction that is taken off: with more an arm let go in motion runs on


def report(arm: Arm, found: Commissioned) -> list[str]:
    """What was found, in lines of text."""
    lines, seen, measured = [], found.cameras, found.arm
    degrees = np.rad2deg
    if seen is None:
        lines.append("cameras    saw no body: frame and zeros were not measured")
    else:
        cameras = seen.frame
        x, y, z = cameras.world_to_base.position
        rejected = ", ".join(str(number + 1) for number in cameras.rejected) or "none"
        lines += [
            f"cameras    residual {cameras.position_rms * 1e3:.1f} mm, "
            f"{degrees(cameras.rotation_rms):.2f} degrees; rests rejected: {rejected}",
            f"           frame moved by {x:.4f}, {y:.4f}, {z:.4f} m; base's z against the cameras' "
            f"{degrees(cameras.upright):.1f} degrees",
            f"           at the rests that were used: {seen.fit_position * 1e3:.1f} mm, "
            f"{degrees(seen.fit_rotation):.2f} degrees",
            f"           at 4 postures that were not used: {seen.check_position * 1e3:.1f} mm, "
            f"{degrees(seen.check_rotation):.2f} degrees",
            f"           in the sweeps: {seen.sweep_position * 1e3:.1f} mm, "
            f"{degrees(seen.sweep_rotation):.2f} degrees",
            f"           stamps late by {seen.latency * 1e3:.1f} ms beyond latency_offset, in the "
            f"last sweep by {seen.latency_change * 1e3:+.1f} ms more",
        ]
        zeros = zip(arm.joint_names, cameras.zeros, cameras.zeros_sd, strict=True)
        shown = ", ".join(
            f"{name} {degrees(zero):+.2f} +-{degrees(sd):.2f}" for name, zero, sd in zeros if sd
        )
        hidden = "the first" if cameras.zeros_sd[-1] else "the first and the last"
        lines.append(f"zeros      {shown} degrees; {hidden} cannot be seen")
    c = measured.corrections
    lines += [
        f"friction   {_joined(c.coulomb_friction, '.2f')} N m, "
        f"of the model {_joined(arm.friction, '.2f')} N m",
        f"motors     torque over commanded {_joined(c.torque_scales, '.3f')} "
        f"+-{float(measured.scales_sd.max()):.3f}",
        f"payload    {c.payload[0]:+.3f} +-{measured.payload_sd:.3f} kg beyond the model, "
        f"by the torques alone {measured.felt_payload:+.3f} +-{measured.felt_sd:.3f} kg; moment "
        f"{_joined(c.payload[1:], '+.4f')} kg m +-{float(measured.moment_sd.max()):.4f}",
        f"base       tilted by {_joined(degrees(c.base_tilt), '+.2f')} degrees",
        f"loop       {measured.loop_delay * 1e3:.0f} ms from a torque to its motion",
        "torque not explained, other movements [N m rms]: "
        + ", ".join(
            f"{name} {getattr(found.before, name):.2f} -> {getattr(found.after, name):.2f}"
            for name in ("rest", "slow", "fast")
        ),
    ]
    return lines


def _joined(values: np.ndarray, spec: str) -> str:
    return " ".join(format(float(value), spec) for value in values)


def setup_text(arm: Arm, tracker: Mapping[str, Any], found: Commissioned) -> str:
    """Set-up file with what was found, by an arm and a tracker of these parameters."""
    c = found.arm.corrections
    controller: dict[str, Any] = {
        "joint_zeros": _rounded(c.zeros, 6),
        "torque_scales": _rounded(c.torque_scales, 4),
        "coulomb_friction": _rounded(c.coulomb_friction, 4),
        "viscous_friction": _rounded(c.viscous_friction, 4),
        "friction_asymmetry": _rounded(c.friction_asymmetry, 3),
        "low_speed_friction": _rounded(c.low_speed_friction, 3),
        "link_masses": _rounded(c.link_masses, 4),
        "payload": _rounded(c.payload, 5),
        "base_tilt": _rounded(c.base_tilt, 5),
        "loop_delay": round(found.arm.loop_delay, 4),
        "teaching_friction": RELIEF,
    }
    nodes: dict[str, Any] = {"torque_controller": controller}
    if (seen := found.cameras) is not None:
        known = tracker["world_to_base"]
        turn, offset = seen.frame.world_to_base.rotation, seen.frame.world_to_base.position
        position = turn @ np.array(known[:3]) + offset
        quat = rotations.quat_xyzw(turn @ rotations.matrix(np.array(known[3:])))
        late = tracker["latency_offset"] + seen.latency
        nodes["pancake_tracker"] = {
            "world_to_base": [*_rounded(position, 5), *_rounded(quat, 7)],
            "latency_offset": round(max(0.0, late), 5),
        }
    header = [
        "# Joints in the order of model_joint_names. Measure again after a change of tool, zeros "
        "or cameras.",
        *(f"# {line}" for line in report(arm, found)),
        *(f"# note: {note}" for note in notes(arm, found)),
    ]
    return _text(f"{arm.name} and its cameras", header, nodes)


def servo_line(found: Servo) -> str:
    """What was found of a servo, for a person."""
    return (
        f"servo      {found.delay * 1e3:.0f} ms of delay and {found.lag * 1e3:.0f} ms of lag; "
        f"{found.error:.4f} rad rms are left of {found.error_without:.4f}"
    )


def servo_text(arm: Arm, found: Servo) -> str:
    """Set-up file of an arm that takes positions, with what was found of its servo."""
    values = {"servo_delay": round(found.delay, 4), "servo_lag": round(found.lag, 4)}
    return _text(arm.name, [f"# {servo_line(found)}"], {"torque_controller": values})


def _text(by: str, header: list[str], nodes: Mapping[str, Any]) -> str:
    sections = {f"/**/{name}": {"ros__parameters": values} for name, values in nodes.items()}
    begin = f"# Measured by {by} on {date.today().isoformat()}, with wam_power_ros {__version__}."
    body = yaml.safe_dump(sections, sort_keys=False, default_flow_style=None, width=1000)
    return "\n".join([begin, *header, body])


def _rounded(values: np.ndarray, digits: int) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]
