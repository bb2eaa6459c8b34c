# SPDX-License-Identifier: Apache-2.0
"""The stand-ins over real DDS: lockstep, real time, the driver's watchdog and services."""

from __future__ import annotations

import json
import signal
import time

import numpy as np
import pytest
from conftest import ROOT, Probe, Processes, diagnosis, lift
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Path
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from hardware_sim.network_link import Link
from wam_power_ros.control.arm import Arm
from wam_power_ros.learning.policy import Policy, to_json
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Code, read

NAMES = [f"wam_j{i}" for i in range(1, 8)]
TICK = 2_000_000  # [ns]
CONFIGS = ("wam_sim.yaml", "optitrack_sim.yaml")


def arm_model() -> Arm:
    return Arm((ROOT / "urdf/wam7.urdf").read_text(), NAMES)


class Bench:
    """The stand-ins in a process, and a controller in another when asked for."""

    def __init__(self, probe: Probe, processes: Processes, pace: str, **parameters: object) -> None:
        self.probe, self.processes, self.pace = probe, processes, pace
        self.messages = probe.listen(JointState, interface.JOINT_STATES, interface.STATE_RECORD)
        self.diagnostics = probe.listen(
            DiagnosticArray, interface.DIAGNOSTICS, interface.DIAGNOSTICS_QOS
        )
        self.paths = probe.listen(Path, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
        self.truths = probe.listen(
            String, interface.body_topic("pancake", "truth"), interface.LATCHED
        )
        overrides = {f"wam_sim:{name}": value for name, value in parameters.items()}
        self.process = processes.node(
            "hardware_sim.main", *CONFIGS, **{"wam_sim:pace": pace, **overrides}
        )
        self._read = interface.JointStateReader(NAMES)
        probe.until(lambda: self.messages, "the first state")

    def state(self, index: int = -1) -> interface.JointReading:
        """One of the states that have come."""
        return self._read(self.messages[index])

    def control(self) -> None:
        """Start the controller and wait until it holds."""
        lockstep = self.pace == "lockstep"
        self.controller = self.processes.node(
            "wam_power_ros.nodes.torque_controller",
            "torque_controller.yaml",
            state_timeout=0.0 if lockstep else 0.006,
            realtime_priority=0 if lockstep else 60,
        )
        self.policies = self.probe.node.create_publisher(
            String, interface.POLICY, interface.LATCHED
        )
        self.probe.until(self._holds, "the controller holds")

    def _holds(self) -> bool:
        label = self.label()
        if label == "fault" and self.pace == "real_time":  # see `insist`
            self.probe.call(Trigger, interface.RESET)
        return label == "hold"

    def label(self) -> str:
        """What the controller does, as the stand-in tells once a second."""
        return diagnosis(self.diagnostics, "wam_sim").get("label", "")

    def insist(self, name: str) -> str:
        """Call a service until it agrees, as latched messages may still be on their way.

        In real time a starved machine makes a fault; an operator would reset it and ask again.
        """
        answers = []

        def agreed() -> bool:
            response = self.probe.call(Trigger, name)
            answers.append(read(response.success, response.message))
            if answers[-1].code is Code.FAULT and self.pace == "real_time":
                self.probe.call(Trigger, interface.RESET)
            self.probe.spin(0.0 if answers[-1].success else 0.05)
            return answers[-1].success

        self.probe.until(agreed, name)
        return answers[-1].values.get("policy", answers[-1].text)

    def rollout(
        self, policy: Policy, pauses: tuple[float, float]
    ) -> tuple[Path, dict[str, object]]:
        """One rollout, with pauses [s of wall time] before and after the reset."""
        self.paths.clear()
        self.truths.clear()
        self.policies.publish(String(data=to_json(policy)))
        self.probe.until(
            lambda: self.insist(interface.MOVE_TO_START) == policy.id, "at the policy's start"
        )
        self.probe.spin(pauses[0])
        self.probe.until(
            lambda: self.insist(interface.body_topic("pancake", "reset")) == policy.id, "the reset"
        )
        self.probe.spin(pauses[1])
        assert self.insist(interface.EXECUTE) == policy.id
        self.probe.until(lambda: self.paths and self.truths, "path and truth", deadline=60.0)
        return self.paths[0], json.loads(self.truths[0].data)


def test_in_lockstep_one_torque_is_one_step_and_none_is_none(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, "lockstep")
    clock = probe.listen(Clock, interface.CLOCK, interface.CLOCK_QOS)
    description = probe.listen(String, interface.ROBOT_DESCRIPTION, interface.LATCHED)
    torques = probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)
    write = interface.TorqueWriter(NAMES, "multiarray")
    before = bench.state()
    probe.until(lambda: len(bench.messages) >= 3, "the state again")
    assert bench.state().stamp_ns == before.stamp_ns  # nothing has moved
    tau = arm_model().gravity(before.q)
    for step in range(1, 20):
        torques.publish(write(before.stamp_ns + (step - 1) * TICK, "hold", tau))
        probe.until(
            lambda step=step: bench.state().stamp_ns == before.stamp_ns + step * TICK, "one step"
        )
    torques.publish(write(before.stamp_ns, "hold", tau))  # an old answer
    probe.spin(0.2)
    assert bench.state().stamp_ns == before.stamp_ns + 19 * TICK
    assert interface.nanoseconds(clock[-1].clock) == bench.state().stamp_ns
    assert bench.messages[-1].name == NAMES
    assert len(bench.messages[-1].effort) == 7
    assert Arm(description[0].data, NAMES).n == 7


def test_a_torque_that_is_not_valid_moves_nothing(probe: Probe, processes: Processes) -> None:
    bench = Bench(probe, processes, "lockstep")
    torques = probe.publisher(Float64MultiArray, interface.EFFORT_COMMANDS, interface.COMMAND)
    before = bench.state().stamp_ns
    for bad in (np.zeros(6), np.full(7, np.nan)):
        torques.publish(interface.TorqueWriter(NAMES, "multiarray")(before, "hold", bad))
        probe.spin(0.1)
    probe.until(
        lambda: diagnosis(bench.diagnostics, "wam_sim").get("torques refused") == "2", "refusals"
    )
    assert bench.state().stamp_ns == before


def test_a_rollout_in_lockstep_is_the_same_whenever_its_services_are_called(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, "lockstep")
    poses = probe.listen(
        PoseStamped, interface.body_topic("pancake", "pose"), interface.STATE_RECORD
    )
    bench.control()
    policy = lift("trial-0001")
    results, frames = [], []
    for pauses in ((0.0, 0.0), (0.13, 0.0), (0.02, 0.11)):
        poses.clear()
        message, truth = bench.rollout(policy, pauses)
        start_ns, path = interface.path(message, EndEffectorPath)
        seen = [interface.pose(pose) for pose in poses]
        at = {reading.stamp_ns - start_ns: reading.position.tolist() for reading in seen}
        frames.append({stamp: place for stamp, place in at.items() if 0 <= stamp < 1_000_000_000})
        results.append((path.t.tolist(), path.position.tolist(), path.quat_xyzw.tolist(), truth))
        probe.until(lambda: bench.label() == "hold", "hold again")
    assert results[0] == results[1]
    assert results[0] == results[2]
    for other in frames[1:]:  # a busy test may miss some of 30 a second of simulated time
        both = frames[0].keys() & other.keys()
        assert len(both) >= 15
        assert {at: frames[0][at] for at in both} == {at: other[at] for at in both}
    assert truth["id"] == policy.id
    assert truth["caught"]
    other = bench.rollout(lift("trial-0002"), (0.0, 0.0))[0]  # another id, another draw of noise
    assert interface.path(other, EndEffectorPath)[1].position.tolist() != results[0][1]


def test_a_reset_is_refused_without_a_policy_and_away_from_its_start(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, "lockstep")
    bench.control()
    refusal = probe.call(Trigger, interface.body_topic("pancake", "reset"))
    assert (refusal.success, "policy" in refusal.message) == (False, True)
    policy = lift("far-away")
    far = Policy(**{**vars(policy), "q_start": policy.q_start + 0.3})
    bench.policies.publish(String(data=to_json(far)))
    probe.until(
        lambda: "rad from" in probe.call(Trigger, interface.body_topic("pancake", "reset")).message,
        "the refusal",
    )


def test_the_hand_demonstrates_while_the_arm_is_free_and_only_then(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, "lockstep")
    bench.control()
    assert not probe.call(Trigger, interface.HAND_DEMONSTRATE).success
    assert probe.call(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=True)).success
    starts = []
    for number in range(2):
        bench.messages.clear()
        response = probe.call(Trigger, interface.HAND_DEMONSTRATE, deadline=60.0)
        assert (response.success, response.message) == (True, f"demonstration-{number}")
        speed = max(np.abs(bench.state(i).qd).max() for i in range(len(bench.messages)))
        assert speed > 2.0  # a toss
        starts.append(speed)
    assert starts[0] != starts[1]  # no two are alike


def test_in_real_time_states_come_500_times_a_second_with_the_wall_clock(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, "real_time", realtime_priority=70)
    clouds = probe.listen(PointCloud2, interface.MARKERS, interface.MOCAP_IN)
    bench.messages.clear()
    begun = time.time_ns()
    probe.until(lambda: len(bench.messages) >= 1000, "a thousand states")
    stamps = [bench.state(i).stamp_ns for i in range(1000)]
    assert set(np.diff(stamps)) == {TICK}  # none lost, none between
    assert abs(stamps[0] - begun) < 500_000_000  # as the system clock says
    assert time.time_ns() >= stamps[-1]  # not faster than that
    probe.until(lambda: len(clouds) >= 50, "camera frames")
    spacing = np.diff([interface.markers(cloud)[0] for cloud in clouds])
    assert np.median(spacing) == pytest.approx(1e9 / 30.0, abs=TICK)
    assert interface.markers(clouds[-1])[2].shape == (4, 3)


@pytest.mark.requirement("S-06")
@pytest.mark.parametrize("during", ["hold", "rollout"])
def test_a_killed_controller_lets_the_arm_come_to_rest_under_its_own_gravity(
    probe: Probe, processes: Processes, during: str
) -> None:
    bench = Bench(probe, processes, "real_time", realtime_priority=70)
    bench.control()
    if during == "rollout":
        policy = lift("killed")
        bench.policies.publish(String(data=to_json(policy)))
        probe.until(lambda: bench.insist(interface.MOVE_TO_START) == policy.id, "at the start")
        bench.insist(interface.EXECUTE)
        probe.spin(0.15)
    processes.end(bench.controller, signal.SIGKILL)
    killed_ns = time.time_ns()  # states of before may still be on their way to a busy test
    probe.until(lambda: bench.state().stamp_ns > killed_ns, "a state of after the kill")
    arm, killed = arm_model(), bench.state()
    count = len(bench.messages)
    end_ns = killed.stamp_ns + 2_500_000_000  # by the arm's clock, whatever ours says
    probe.until(lambda: bench.state().stamp_ns > end_ns, "2.5 s of the arm")
    after = [bench.state(i) for i in range(count, len(bench.messages))]
    height = [arm.tool_pose(reading.q)[0][2] for reading in after[::10]]
    speeds = [arm.reference_point_speeds(r.q, r.qd)[2] for r in after[::10]]
    assert len(after) > 50  # the states go on, however few of them a busy machine lets us hear
    assert arm.tool_pose(killed.q)[0][2] - min(height) < 0.05
    assert max(speeds[len(speeds) // 2 :]) < 0.05
    if during == "hold":
        assert max(speeds) < 0.3


def test_barretts_services_hold_idle_and_give_the_arm_back(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, "real_time", realtime_priority=70)
    assert probe.call(SetBool, interface.WAM_HOLD, SetBool.Request(data=True)).success
    probe.spin(0.3)
    held = bench.state().q
    probe.spin(0.7)
    np.testing.assert_allclose(bench.state().q, held, atol=0.01)
    home = probe.begin(Trigger, interface.WAM_MOVE_HOME)
    probe.until(lambda: np.abs(bench.state().q - held).max() > 0.1, "the arm on its way")
    assert not home.done()
    assert probe.call(Trigger, interface.WAM_IDLE).success
    probe.until(home.done, "the move home is answered")
    assert not home.result().success  # idle came between
    assert probe.call(SetBool, interface.WAM_GRAVITY_COMPENSATE, SetBool.Request(data=True)).success


def test_an_arm_that_waits_frozen_for_a_rollout_moves_home_when_told_to(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, "lockstep")
    bench.control()
    policy = lift("never-executed")
    bench.policies.publish(String(data=to_json(policy)))
    probe.until(lambda: bench.insist(interface.MOVE_TO_START) == policy.id, "at the start")
    probe.until(
        lambda: bench.insist(interface.body_topic("pancake", "reset")) == policy.id, "the reset"
    )
    waiting = bench.state().q
    home = probe.begin(Trigger, interface.WAM_MOVE_HOME)
    probe.until(lambda: np.abs(bench.state().q - waiting).max() > 0.1, "the arm on its way")
    assert not home.done()


def test_in_real_time_states_go_on_while_the_pancake_is_put_back(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, "real_time", realtime_priority=70)
    bench.control()
    policy = lift("put-back")
    bench.policies.publish(String(data=to_json(policy)))
    probe.until(lambda: bench.insist(interface.MOVE_TO_START) == policy.id, "at the start")
    count = len(bench.messages)
    probe.until(
        lambda: bench.insist(interface.body_topic("pancake", "reset")) == policy.id, "the reset"
    )
    stamps = [bench.state(i).stamp_ns for i in range(count, len(bench.messages))]
    assert len(stamps) > 20  # of the 50 the reset waits at least; the first may come late
    assert set(np.diff(stamps)) == {TICK}
    bench.diagnostics.clear()
    assert probe.until(bench.label, "its mode") == "hold"  # it has not lost sight of the arm


def test_a_recorded_movement_is_replayed_by_the_arm(probe: Probe, processes: Processes) -> None:
    bench = Bench(probe, processes, "lockstep")
    bench.control()
    movements = probe.publisher(JointTrajectory, interface.REPLAY_TRAJECTORY, interface.LATCHED)
    t = np.linspace(0.0, 2.0, 41)
    swing = 0.2 * np.sin(np.pi * t / 2.0) ** 2  # out and back, at rest at both ends
    q = bench.state().q + swing[:, None] * np.eye(7)[3]
    movements.publish(interface.joint_movement_message(NAMES, interface.JointMovement(t, q)))
    start = bench.state().q[3]
    bench.messages.clear()
    message = bench.insist(interface.REPLAY)
    moved = max(bench.state(i).q[3] for i in range(len(bench.messages))) - start
    assert moved == pytest.approx(0.2, abs=0.03)
    assert "rms error 0.0" in message


def test_a_driver_without_velocities_is_stood_in_for_too(
    probe: Probe, processes: Processes
) -> None:
    bench = Bench(probe, processes, "lockstep", velocity="empty")
    assert bench.state().qd is None
    bench.control()
    message, truth = bench.rollout(lift("no-velocity"), (0.0, 0.0))
    assert interface.path(message, EndEffectorPath)[1].t[-1] == pytest.approx(1.4)
    assert truth["caught"]


@pytest.mark.requirement("S-46")
def test_links_that_lose_and_jitter_are_survived(probe: Probe, processes: Processes) -> None:
    bench = Bench(
        probe,
        processes,
        "real_time",
        realtime_priority=70,
        state_latency=0.001,
        state_jitter=0.0003,
        state_loss=0.02,
        command_latency=0.001,
        command_jitter=0.0003,
        command_loss=0.02,
    )
    bench.control()
    held = bench.state().q
    probe.spin(2.0)
    assert bench.label() == "hold"
    np.testing.assert_allclose(bench.state().q, held, atol=0.02)


@given(st.integers(0, 2**32), st.lists(st.integers(0, 5_000_000), min_size=1, max_size=50))
def test_nothing_overtakes_on_a_link_and_the_seed_decides(seed: int, gaps: list[int]) -> None:
    def arrivals() -> list[tuple[int, int]]:
        link = Link(0.004, 0.003, 0.2, np.random.default_rng(seed))
        now, arrived = 0, []
        for number, gap in enumerate(gaps):
            now += gap
            link.put(now, number)
            arrived += [(now, item) for item in link.take(now)]
        return arrived + [(10**12, item) for item in link.take(10**12)]

    first = arrivals()
    assert first == arrivals()
    items = [item for _, item in first]
    assert items == sorted(items)
    assert set(items) <= set(range(len(gaps)))


def test_a_link_without_faults_delivers_at_once() -> None:
    link = Link(0.0, 0.0, 0.0, np.random.default_rng(0))
    link.put(5, "a")
    assert link.take(4) == []
    assert link.take(5) == ["a"]


def test_optitrack_sim_alone_says_where_it_runs(processes: Processes) -> None:
    process = processes.node("hardware_sim.optitrack_node")
    assert process.wait(60.0) == 2
    assert "start wam_sim" in processes.output(process)
