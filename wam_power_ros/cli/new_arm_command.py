# SPDX-License-Identifier: Apache-2.0
"""`wam-power new-arm`: the first set-up of an arm from its URDF."""

from __future__ import annotations

from pathlib import Path

from wam_power_ros.cli.launcher import UsageError, check, short_path
from wam_power_ros.cli.set_up_checks import mistakes
from wam_power_ros.commissioning.new_arm import proposals, text
from wam_power_ros.params import overlay
from wam_power_ros.params.resources import robot_description


def new_arm(urdf: Path, tool: str, output: str, file: Path | None) -> int:
    """Write a set-up beside the URDF, check it, and print what comes next."""
    file = (file or urdf.with_name(f"{urdf.name.split('.')[0]}.yaml")).resolve()
    if file.exists():
        raise UsageError(
            f"{short_path(file)} exists: nothing is overwritten; choose another --file"
        )
    values = [*proposals(robot_description(str(urdf.resolve())), str(urdf.resolve()), tool, output)]
    file.write_text(text(values), encoding="utf-8")
    print(file.read_text(), end="")
    setup = overlay.setup([str(file)], task="reach")
    check(setup)
    for mistake in mistakes(setup):
        print(f"not yet right: {mistake}")
    words = f"--config {short_path(file)}"
    print(f"Written: {short_path(file)}. Next, in simulation, then with the driver started:")
    print(f"  wam-power learn --task reach --in-process {words} --simulate")
    print(f"  wam-power run check_driver --task reach {words}")
    return 0
