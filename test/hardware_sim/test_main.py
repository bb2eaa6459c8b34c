# SPDX-License-Identifier: Apache-2.0
"""The two paces of the stand-ins, over DDS."""

from __future__ import annotations

import signal
import time
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import Probe, Processes, lift
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from stand_ins import NAMES, TICK, Hardware, arm_model
from std_msgs.msg import Float64MultiArray, String

from hardware_sim.arm_node import IDLE_TIME, ArmSim
from hardware_sim.main import Simulation
from wam_power_ros.control.arm import Arm
from wam_power_ros.ros import interface, joint_messages, pose_messages
from wam_power_ros.ros.stamps import nanoseconds


def test_in_lockstep_each_torque_advances_the_world_by_one_step(
    probe: Probe, processes: Processes
) -> None:
    hardware = Hardware(probe, processes, "lockstep")
    clock = probe.listen(Clock, interface.CLOCK, interface.NEWEST)
    description = probe.listen(String, interface.ROBOT_DESCRIPTION, interface.LATCHED)
    torques = probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)
    write = joint_messages.TorqueWriter(NAMES, "multiarray")
    before = hardware.state()
    probe.until(lambda: len(hardware.messages) >= 3, "the state again")
    assert hardware.state().stamp_ns == before.stamp_ns  # nothing has moved
    tau = arm_model().gravity(before.q)
    for step in range(1, 20):
        torques.publish(write(before.stamp_ns + (step - 1) * TICK, "hold", tau))
        probe.until(
            lambda step=step: hardware.state().stamp_ns == before.stamp_ns + step * TICK, "one step"
        )
    times = {nanoseconds(message.clock) for message in clock}
    assert len(times) < 8  # 100 a second: each is read by every node, and recorded
    torques.publish(write(before.stamp_ns, "hold", tau))  # outdated
    probe.spin(0.2)
    assert hardware.state().stamp_ns == before.stamp_ns + 19 * TICK
    assert nanoseconds(clock[-1].clock) == hardware.state().stamp_ns
    assert hardware.messages[-1].name == NAMES
    assert len(hardware.messages[-1].effort) == 7
    assert Arm(description[0].data, NAMES).n == 7


def test_in_real_time_states_come_500_times_a_second_with_the_wall_clock(
    probe: Probe, processes: Processes
) -> None:
    hardware = Hardware(probe, processes, "real_time", realtime_priority=70)
    clouds = probe.listen(PointCloud2, interface.MARKERS, interface.MOCAP_BEST_EFFORT)
    hardware.messages.clear()
    begun = time.time_ns()
    probe.until(lambda: len(hardware.messages) >= 1000, "a thousand states")
    stamps = [hardware.state(i).stamp_ns for i in range(1000)]
    assert set(np.diff(stamps)) == {TICK}  # none lost, none between
    assert abs(stamps[0] - begun) < 500_000_000  # stamps of the system clock
    assert time.time_ns() >= stamps[-1]  # not ahead of it
    probe.until(lambda: len(clouds) >= 50, "camera frames")
    spacing = np.diff([pose_messages.markers(cloud)[0] for cloud in clouds])
    assert np.median(spacing) == pytest.approx(1e9 / 30.0, abs=TICK)
    assert pose_messages.markers(clouds[-1])[2].shape == (4, 3)


@pytest.mark.requirement("S-46")
def test_links_that_lose_and_jitter_are_survived(probe: Probe, processes: Processes) -> None:
    hardware = Hardware(probe, processes, "real_time", module="test/lossy_standins.py")
    hardware.control()
    for _ in range(3):  # a machine that pauses for 20 ms causes a fault
        hardware.holds()
        held = hardware.state().q
        probe.spin(2.0)
        if hardware.label() == "hold":
            break
    assert hardware.label() == "hold"
    np.testing.assert_allclose(hardware.state().q, held, atol=0.02)


@pytest.mark.requirement("S-06")
def test_a_killed_controller_lets_the_arm_come_to_rest_under_its_own_gravity(
    probe: Probe, processes: Processes
) -> None:
    hardware = Hardware(probe, processes, "real_time", realtime_priority=70)
    hardware.control()
    policy = lift("killed")
    hardware.call_until_success("move_to_start", policy)
    probe.ask("execute", policy)
    probe.spin(0.15)
    processes.end(hardware.controller, signal.SIGKILL)
    killed_ns = time.time_ns()  # older states may still arrive
    probe.until(lambda: hardware.state().stamp_ns > killed_ns, "a state of after the kill")
    arm, killed = arm_model(), hardware.state()
    count = len(hardware.messages)
    end_ns = killed.stamp_ns + 2_500_000_000  # on the clock of the arm
    probe.until(lambda: hardware.state().stamp_ns > end_ns, "2.5 s of the arm")
    after = [hardware.state(i) for i in range(count, len(hardware.messages))]
    assert len(after) > 10  # states go on; a busy machine may miss many
    height = [arm.tool_pose(reading.q)[0][2] for reading in after]
    speeds = [arm.speeds(r.q, r.qd).tool_speed for r in after]
    assert arm.tool_pose(killed.q)[0][2] - min(height) < 0.05
    assert max(speeds[len(speeds) // 2 :]) < 0.05


def test_a_torque_waits_only_while_nothing_moves_and_nothing_is_requested() -> None:
    simulation, taken = Simulation.__new__(Simulation), []
    simulation._held, simulation._step = None, taken.append
    simulation.wam = SimpleNamespace(stamp_ns=TICK, counters=Counter(), idle=False)
    for stamp_ns, idle in ((TICK, False), (TICK + 1, False), (TICK, True)):
        simulation.wam.idle = idle
        simulation._answered(SimpleNamespace(stamp_ns=stamp_ns))
    assert [reading.stamp_ns for reading in taken] == [TICK]
    assert simulation.wam.counters["torques out of step"] == 1 and simulation._held is not None

    def idle(ticks: int, busy: bool) -> bool:
        scene = SimpleNamespace(busy=busy)
        params = SimpleNamespace(period=0.002)
        node = SimpleNamespace(_still_ticks=ticks, _scene=scene, params=params)
        return ArmSim.idle.fget(node)

    longest = round(IDLE_TIME / 0.002)
    assert idle(longest + 1, False) and not idle(longest, False) and not idle(longest + 1, True)


def test_a_camera_whose_images_are_drawn_is_refused_in_real_time(processes: Processes) -> None:
    process = processes.node(
        "hardware_sim.main",
        *("wam_sim.yaml", "optitrack_sim.yaml"),
        **{"wam_sim:pace": "real_time", "optitrack_sim:camera": True},
    )
    assert process.wait(60.0) == 2
    assert "camera = True of optitrack_sim needs pace = lockstep" in processes.output(process)
