# SPDX-License-Identifier: Apache-2.0
"""`wam-power view` of a running session during a measurement, with a reader instead of a browser.

A browser without a graphics card would draw on the processor, and be measured instead.
"""

from __future__ import annotations

import fcntl
import sys
import time
from pathlib import Path
from typing import IO

from wam_power_ros.bags import reader
from wam_power_ros.cli.processes import Processes
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.demonstration import from_joint_samples
from wam_power_ros.params.resources import share
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.tasks.flip.task import Flip


def start(processes: Processes, folder: Path, domain: int, joints: list[str]) -> IO[str]:
    """Start the page of a session in `folder` and its reader; return the running session's lock."""
    arm = Arm(share("urdf/wam7.urdf").read_text(), joints)
    bag = min(share("bags").glob("demo_*"))
    samples = reader.read_demonstration(bag, joints)
    policy = Flip.policy_of([from_joint_samples(arm, *samples)], "demonstration-1")
    session = folder / "session"
    Session.begin(session, preset("flip"), 0, [policy]).close()
    (session / "logs").mkdir()
    (session / "logs/ros_domain_id").write_text(f"{domain}\n")
    held = (session / "logs/.lock").open("a")
    fcntl.flock(held, fcntl.LOCK_EX)
    module = [sys.executable, "-m"]
    view = processes.start("view", [*module, "wam_power_ros.cli", "view", str(session)])
    while not view.log.read_text().startswith("http"):
        processes.check()
        time.sleep(0.1)
    url = view.log.read_text().split()[0].replace("http", "ws")
    processes.start("browser", [*module, "benchmark.viewing", url])
    return held


def read_all(url: str) -> None:
    """Receive everything the page sends, indefinitely."""
    import viser
    from websockets.sync.client import connect

    with connect(url, subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as socket:
        for _ in socket:
            pass


if __name__ == "__main__":
    read_all(sys.argv[1])
