# SPDX-License-Identifier: Apache-2.0
"""Cuts the network between a driver and the controller; runs in a network namespace of its own."""

import subprocess
import sys
from pathlib import Path

from benchmark.hidden_arm import StandIn
from benchmark.lab import Driver, Lab


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


def main(folder: Path) -> int:
    """Cut the network for a second while the arm is held; print the modes of the controller."""
    with Lab(folder).open() as lab:
        lab.controller(priority=0)
        driver = Driver(lab, StandIn())
        driver.ready()
        while lab.label != "hold":
            driver.play(0.1)
        ip("link", "set", "lo", "down")
        driver.play(1.0)
        ip("link", "set", "lo", "up")
        ip("route", "add", "224.0.0.0/4", "dev", "lo")
        lab.torques.clear()
        driver.play(30.0, lambda: len(lab.torques) > 100)
        after = {torque.label for _, torque in lab.torques}
        driver.ready()
        driver.play(10.0, lambda: lab.label == "hold")  # the next torque says so
        sys.stdout.write(f"{sorted(after)} {lab.label}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
