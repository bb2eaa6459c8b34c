# SPDX-License-Identifier: Apache-2.0
"""`wam-power doctor`: how far a lab is from its first demonstration, and what comes next.

It reads the machine and the set-up and starts nothing.
"""

from __future__ import annotations

import os
import resource
from pathlib import Path
from typing import NamedTuple

import numpy as np

from wam_power_ros import compiled
from wam_power_ros.cli.launcher import Devices
from wam_power_ros.cli.set_up_checks import mistakes
from wam_power_ros.params import overlay
from wam_power_ros.params.body_tracker_params import BodyTrackerParams, missing_package
from wam_power_ros.params.torque_controller_params import TorqueControllerParams

OK, WARN, NO = "ok", "WARN", "NO"
ELBOW_FLIP = 1.5  # [m/s] of the elbow that a flip needs
MEMLOCK = 512e6  # [B] of locked memory that the controller needs


class Row(NamedTuple):
    """One finding: of what, `OK`, `WARN` or `NO`, text, and the command that comes next if NO."""

    name: str
    verdict: str
    text: str
    then: str = ""


def doctor(devices: Devices, task: str | None = None) -> int:
    """Print the rows and what comes next; returns 0 if nothing is missing, else 1."""
    setup = devices.parameters(task or "")
    wrong = [Row("set-up", NO, text, "config") for text in mistakes(setup)]
    rows = [*machine(), *described(setup), *wrong, *eyes(setup), *measured(setup)]
    for number, row in enumerate(rows, start=1):
        print(f"{number:2d} {row.name:12s} {row.verdict:4s}  {row.text}")
    missing = [row for row in rows if row.verdict == NO]
    if missing:
        names = ", ".join(dict.fromkeys(row.name for row in missing))
        print(f"Missing: {names}. Next, with the same set-ups: wam-power {missing[0].then}")
    else:
        print("Nothing is missing here. What the drivers do is not looked at.")
    print("Once a day, and after each change: ros2 run wam_power_ros check_driver")
    return 1 if missing else 0


def machine() -> list[Row]:
    """Rights and speed of this machine."""
    root = os.geteuid() == 0
    priority = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    locked = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    unlimited = locked == resource.RLIM_INFINITY
    granted = root or (priority >= 60 and (unlimited or locked >= MEMLOCK))
    memory = "any" if root or unlimited else f"{locked / 1e6:.0f} MB"
    text = f"rtprio {'any' if root else priority}, memlock {memory}"
    if not granted:
        text += "; at least 60 and 512 MB are needed: /etc/security/limits.d"
    real_time = Path("/sys/kernel/realtime")
    preemptible = real_time.exists() and real_time.read_text().strip() == "1"
    ordinary = "an ordinary kernel: about 1 of 10 000 torques is late"
    kernel = "PREEMPT_RT" if preemptible else ordinary
    loops = "compiled" if compiled.kernel is not None else "in Python: install gcc, then again"
    return [
        Row("rights", OK if granted else WARN, text),
        Row("machine", OK, f"{os.cpu_count()} cores, {kernel}; inner loops {loops}"),
    ]


def described(setup: overlay.Setup) -> list[Row]:
    """What the set-up says of arm and limits."""
    params, arm = TorqueControllerParams.from_setup(setup), setup.arm()
    name = "from /robot_description" if arm is None else arm.name
    kind = "simulated" if params.simulation else "a real arm"
    sent = "torques"
    if params.output != "torque":
        sent = f"{params.output}: no stiffness, no checks of torques"
    fast = params.guarded_speed_max >= ELBOW_FLIP
    limit = f"elbow {params.guarded_speed_max:g} m/s, tool {params.tool_speed_max:g} m/s"
    need = "" if fast else f"; a flip needs about {ELBOW_FLIP:g} m/s of the elbow (full_speed)"
    held = params.hold_to_run or params.simulation
    switch = f"{'an' if params.hold_to_run else 'no'} enabling switch is required"
    return [
        Row("arm", OK, f"{name}, {len(params.joint_names)} joints, {kind}"),
        Row("output", OK, sent),
        Row("speeds", OK if fast else WARN, f"{limit}{need}"),
        Row("switch", OK if held else WARN, switch),
    ]


def eyes(setup: overlay.Setup) -> list[Row]:
    """Where the tracked body is seen."""
    params = BodyTrackerParams.from_setup(setup)
    if not params.body:
        return []
    text = f"{params.source_type} on {params.topic}, in the frame {params.mocap_frame}"
    missing = missing_package(params.source_type)
    return [Row("cameras", WARN if missing else OK, missing or text)]


def measured(setup: overlay.Setup) -> list[Row]:
    """What was measured on this arm."""
    params, cameras = TorqueControllerParams.from_setup(setup), setup["pancake_tracker"]
    rows = []
    if cameras["body"]:
        known = not np.allclose(cameras["world_to_base"], [0, 0, 0, 0, 0, 0, 1])
        rows.append(_row("frame", known, "of the cameras, in world_to_base"))
    if params.output != "torque":  # the arm carries itself, and nothing is measured by torques
        delay, lag = 1e3 * params.servo_delay, 1e3 * params.servo_lag
        if delay + lag > 0.0:
            return [*rows, Row("servo", OK, f"{delay:.0f} ms late, {lag:.0f} ms of lag")]
        return [*rows, Row("servo", WARN, "never measured: commission")]
    zeros = np.abs(params.joint_zeros)
    loads = not (np.allclose(params.torque_scales, 1.0) and np.allclose(params.payload, 0.0))
    return [
        *rows,
        _row("zeros", bool(zeros.any()), f"largest {np.rad2deg(zeros.max()):.1f} degrees"),
        _row("friction", bool(np.any(np.array(params.coulomb_friction) >= 0.0)), "of the joints"),
        _row("loop delay", params.loop_delay > 0.0, f"{params.loop_delay * 1e3:.0f} ms"),
        _row("motors, tool", loads, "torque constants, payload, tilt"),
    ]


def _row(name: str, done: bool, text: str) -> Row:
    return Row(name, OK, text) if done else Row(name, NO, "never measured", "commission")
