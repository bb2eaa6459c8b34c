# SPDX-License-Identifier: Apache-2.0
"""A held key as the enabling switch."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from std_msgs.msg import Bool

from wam_power_ros.console.enabling_switch import FIRST_REPEAT, NEXT_REPEAT, HeldKey
from wam_power_ros.ros import interface

if TYPE_CHECKING:
    from conftest import Probe


@pytest.mark.requirement("S-30")
def test_a_key_is_held_while_it_repeats_and_released_soon_after() -> None:
    key = HeldKey()
    assert not key.held(0.0)
    key.press(10.0)
    assert key.held(10.0 + 0.99 * FIRST_REPEAT)  # before the first repetition
    assert not key.held(10.0 + FIRST_REPEAT)
    now = 20.0
    key.press(now)
    for _ in range(30):
        now += 0.9 * NEXT_REPEAT
        assert key.held(now)
        key.press(now)
    assert key.held(now + 0.9 * NEXT_REPEAT)
    assert not key.held(now + NEXT_REPEAT)


@pytest.mark.requirement("S-30")
def test_the_terminals_key_is_published_and_its_release_too(probe: Probe, domain_id: int) -> None:
    switch = probe.listen(Bool, interface.ENABLE, interface.NEWEST)
    ours, terminal = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "wam_power_ros.cli", "enable"],
        stdin=terminal,
        stdout=subprocess.DEVNULL,
        env=os.environ | {"ROS_DOMAIN_ID": str(domain_id)},
    )
    try:
        probe.until(lambda: switch and not switch[-1].data, "released at first")
        os.write(ours, b" ")
        probe.until(lambda: switch[-1].data, "held")
        probe.until(lambda: not switch[-1].data, "released")
    finally:
        process.terminate()
        process.wait(20.0)
        os.close(ours)
        os.close(terminal)
