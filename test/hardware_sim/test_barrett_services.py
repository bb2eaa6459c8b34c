# SPDX-License-Identifier: Apache-2.0
"""Barrett's own services."""

from __future__ import annotations

import numpy as np
from conftest import Probe, Processes, lift
from stand_ins import Hardware
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.ros import interface


def test_barretts_services_hold_idle_and_release_the_arm(
    probe: Probe, processes: Processes
) -> None:
    hardware = Hardware(probe, processes, "real_time", realtime_priority=70)
    assert probe.call(SetBool, interface.WAM_HOLD, SetBool.Request(data=True)).success
    probe.spin(0.3)
    held = hardware.state().q
    probe.spin(0.7)
    np.testing.assert_allclose(hardware.state().q, held, atol=0.01)
    home = probe.begin(Trigger, interface.WAM_MOVE_HOME)
    probe.until(lambda: np.abs(hardware.state().q - held).max() > 0.1, "the arm on its way")
    assert not home.done()
    assert probe.call(Trigger, interface.WAM_IDLE).success
    probe.until(home.done, "the move home is answered")
    assert not home.result().success  # interrupted by idle
    assert probe.call(SetBool, interface.WAM_GRAVITY_COMPENSATE, SetBool.Request(data=True)).success


def test_an_arm_that_waits_frozen_for_a_rollout_moves_home_on_request(
    probe: Probe, processes: Processes
) -> None:
    hardware = Hardware(probe, processes, "lockstep")
    hardware.control()
    policy = lift("never-executed")
    hardware.insist("move_to_start", policy)
    hardware.insist("reset", policy)
    waiting = hardware.state().q
    home = probe.begin(Trigger, interface.WAM_MOVE_HOME)
    probe.until(lambda: np.abs(hardware.state().q - waiting).max() > 0.1, "the arm on its way")
    assert not home.done()
