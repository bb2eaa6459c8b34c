# SPDX-License-Identifier: Apache-2.0
"""Record a series of kinesthetic demonstrations under gravity compensation.

The teacher is a person, who presses Enter, or the demonstrator of the stand-in. Every take is added
to the list of bags in a file at once. In a review after each take, a person may repeat or discard
it, or end the series.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from wam_power_ros.bags import series
from wam_power_ros.client.robot import Robot
from wam_power_ros.console.prompt import choose, confirm, show

KEEP, AGAIN, DISCARD, DONE = "keep", "again", "discard", "done"
KEYS = {"a": AGAIN, "d": DISCARD, "q": DONE}


def record_series(robot: Robot, file: Path, wanted: int, *, person: bool, review: bool) -> None:
    """Record demonstrations, add them to a list of bags and hold the arm.

    A person guides the arm by hand, or else the demonstrator of the stand-in; a `review` asks after
    each take to keep, repeat or discard it.

    Raises:
        ServiceError: A service does not appear, does not answer in time, or refuses.
    """
    bags, number = series.read(file), 1
    wait_for_end = partial(confirm, "press Enter when the movement is over ") if person else None
    with robot.guided():
        if not person:  # who is slower than the start of any node
            robot.await_recorder()
        while number <= wanted:
            if person:
                confirm(f"demonstration {number}: press Enter, then guide the arm by hand ")
            bag = robot.take(wait_for_end)
            bags.append(bag)
            series.write(file, bags)  # at once: kept even if interrupted
            show(f"  {number} of {wanted}: {bag}")
            choice = choose(KEEP, KEYS) if review else KEEP
            if choice in (AGAIN, DISCARD):
                bags.pop()
                show(f"  discarded; moved to {series.discard(bag)}")
            wanted = {DONE: number, DISCARD: wanted - 1}.get(choice, wanted)
            number += choice in (KEEP, DONE)
