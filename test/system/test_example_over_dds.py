# SPDX-License-Identifier: Apache-2.0
"""The examples over DDS: teach, learn, replay; a driver beside the real controller."""

import sys
from pathlib import Path

import pytest
from conftest import Probe, Processes, diagnosis, lift
from nav_msgs.msg import Path as PathMessage
from played_arm import MODULE, SIMULATED
from std_srvs.srv import SetBool, Trigger
from test_examples import DRIVER, EXAMPLES, OVER_DDS, output

from wam_power_ros.ros import interface, pose_messages


@pytest.mark.long
def test_the_example_teaches_learns_and_replays_over_dds(tmp_path: Path) -> None:
    domain, taught, *others, moved = output(OVER_DDS, tmp_path)
    assert domain.startswith("The simulation uses ROS_DOMAIN_ID")
    assert taught.startswith("taught demo_") and moved.startswith("moved: ")
    assert [line.split(": ")[0] for line in others[:4]] == [f"trial-{k}" for k in range(4)]
    assert "rms" in "".join(others[4:])
    assert len([*(tmp_path / "arm/bags").iterdir()]) == 5  # a demonstration, four rollouts


@pytest.mark.long  # its driver is to be late with no state
def test_the_real_controller_teaches_holds_moves_and_executes_with_the_driver_of_the_examples(
    probe: Probe, processes: Processes
) -> None:
    # Named as a stand-in, which a simulated controller answers: that of a robot has 20 ms for a
    # state. Ten states may be lost on a busy machine: then the arm is reset and begins again.
    driver = [sys.executable, str(EXAMPLES / f"{DRIVER}.py"), "--ros-args"]
    processes.start([*driver, "-r", "__node:=wam_sim"])
    processes.node(MODULE, *SIMULATED, state_timeout=0.0, realtime_priority=0)
    reports = probe.diagnostics()
    paths = probe.listen(PathMessage, interface.ROLLOUT_END_EFFECTOR, interface.LATCHED)
    policy = lift("lift")

    def reached(name: str) -> bool:
        """Whether the controller reports a mode; a fault is reset instead."""
        reports.clear()
        newest = lambda: diagnosis(reports, "torque_controller").get("mode")  # noqa: E731
        found = probe.until(newest, "a report")
        if found == "fault":
            probe.call(Trigger, interface.RESET)
        return found == name

    def answered(do: str) -> bool:
        return probe.answer(probe.ask(do, policy)).success

    def executed() -> bool:
        # An attempt before may have seen a report from before its request.
        probe.call(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=False))
        probe.until(lambda: reached("hold"), "hold")
        for taught, name in ((True, "gravity_compensation"), (False, "hold")):
            probe.call(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=taught))
            if not reached(name):
                return False
        paths.clear()
        if not (answered("move_to_start") and answered("execute")):
            return False
        path = pose_messages.path(probe.until(lambda: paths and paths[-1], "the path"))
        if path.t[-1] < 1.3:  # it ended in a fault
            return False
        height = path.position[:, 2]
        assert 0.01 < height.max() - height[0] < 0.06
        return True

    probe.until(executed, "a whole rollout", 300.0)
