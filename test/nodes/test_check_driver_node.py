# SPDX-License-Identifier: Apache-2.0
"""check_driver over real DDS, against the stand-in and one that is broken."""

from __future__ import annotations

import io
import json
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import ROOT, Probe, Processes
from std_msgs.msg import String

from hardware_sim.driver_watch import UNNAMED
from wam_power_ros.nodes import check_driver
from wam_power_ros.ros import interface, joint_messages, node_runner
from wam_power_ros.ros.domain import private_domain

CHECK = "wam_power_ros.nodes.check_driver"
BY_HAND = 7 * ["\n"]  # each joint is said to have been led


class Bench:
    """The stand-ins in real time, with a fault that can be chosen."""

    def __init__(self, domain_id: int, folder: Path) -> None:
        self._folder, self.domain_id = folder, domain_id
        self.processes = Processes(domain_id, folder)
        self.probe = Probe(domain_id)
        command = [sys.executable, str(ROOT / "test/broken_standins.py"), "--ros-args"]
        for name in ("wam_sim", "optitrack_sim"):
            command += ["--params-file", str(ROOT / f"config/{name}.yaml")]
        for value in ("pace:=real_time", "realtime_priority:=70", "listeners:=[probe]"):
            command += ["-p", f"wam_sim:{value}"]
        self.process = self.processes.start(command)
        self._faults = self.probe.publisher(String, "/fault", interface.LATCHED)

    def set(self, fault: str) -> None:
        """Change the fault."""
        self._faults.publish(String(data=fault))
        self.probe.spin(0.2)

    def check(
        self, *arguments: str, fault: str = "none", typed: Sequence[str] = (), by_hand: str = ""
    ) -> dict[str, Any]:
        """Report of check_driver in this process, with its exit status and output.

        Args:
            arguments: Of the command.
            fault: The fault from the start.
            typed: What a person types, by question; nobody is there if it is empty.
            by_hand: Fault from the question whether joints are led, before that is answered.
        """
        self.set(fault)
        file, lab = self._folder / "rows.json", self._folder / "lab.yaml"
        file.unlink(missing_ok=True)
        lab.write_text("torque_controller: {ros__parameters: {realtime_priority: 0}}")
        common = ["--config", str(lab), "--seconds", "1", "--json", str(file)]
        output, answers = io.StringIO(), iter(typed)

        def readline() -> str:
            if by_hand and output.getvalue().rstrip().endswith("skips it)"):
                self.set(by_hand)
            return next(answers, "")

        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("ROS_DOMAIN_ID", str(self.domain_id))
            patch.setattr(node_runner, "interrupt_on_signals", lambda: None)
            patch.setattr(sys, "argv", ["check_driver", *common, *arguments])
            patch.setattr(sys, "stdin", SimpleNamespace(readline=readline))
            patch.setattr(sys, "stdout", output)
            status = check_driver.main()
        table = json.loads(file.read_text()) if file.exists() else {"rows": []}
        rows = {row["name"]: row for row in table["rows"]}
        return table | {"rows": rows, "status": status, "output": output.getvalue()}

    def close(self) -> None:
        """End the stand-ins."""
        self.probe.close()
        self.processes.end(self.process, signal.SIGINT)
        self.processes.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with private_domain() as domain_id:
        bench = Bench(domain_id, tmp_path_factory.mktemp("check"))
        yield bench
        bench.close()


def failing(table: dict[str, Any]) -> list[str]:
    return [name for name, row in table["rows"].items() if row["verdict"] == "fail"]


def test_the_stand_in_conforms(bench: Bench) -> None:
    for _ in range(3):  # a busy machine shows the torque or the frames too late
        table = bench.check("--active", typed=["y\n", *BY_HAND])  # y, but no joint is moved
        if not failing(table) and table["rows"]["watchdog"]["verdict"] == "ok":
            break
    assert (table["status"], failing(table)) == (0, [])
    assert table["rows"]["wam_j7 by hand"]["found"] == "no joint moved"
    assert "CONFORMS" in table["output"]
    for name in ("joint names", "gravity", "command path", "mocap axes"):
        assert table["rows"][name]["verdict"] == "ok", name
    assert "own torque after" in table["rows"]["watchdog"]["found"]


@pytest.mark.requirement("S-130")
def test_a_broken_driver_does_not_conform_and_is_named_for_what_it_is(bench: Bench) -> None:
    table = bench.check(fault="two publishers")
    assert (table["status"], failing(table)) == (1, ["state publisher"])
    row = table["rows"]["state publisher"]
    assert "on /joint_states: /wam_sim, /wam_sim" in row["found"] + row["advice"]
    said = " ".join(table["output"].split())
    assert "DOES NOT CONFORM, do not move the arm: state publisher" in said


@pytest.mark.long
def test_a_driver_that_falls_silent_while_joints_are_led_does_not_conform(bench: Bench) -> None:
    table = bench.check("--active", typed=["y\n", *BY_HAND], by_hand="silent")
    assert (table["status"], failing(table)) == (1, ["wam_j1 by hand"])
    assert "stopped sending" in table["rows"]["wam_j1 by hand"]["advice"]
    assert "wam_j2 by hand" not in table["rows"]


def test_without_consent_no_torque_is_sent(bench: Bench) -> None:
    torques = bench.probe.listen(
        joint_messages.COMMAND_TYPES["multiarray"], interface.EFFORT_COMMANDS, interface.COMMAND
    )
    table = bench.check(typed=["no\n"])
    bench.probe.spin(0.5)
    assert (table["rows"]["watchdog"]["verdict"], torques) == ("not checked", [])
    found = table["rows"]["command path"]["found"]
    assert found in {  # discovery can be slow, and more so of names
        f"received by {names}" for names in ("probe, wam_sim", f"{UNNAMED}, wam_sim", "wam_sim")
    }


def test_without_messages_nothing_can_be_checked(processes: Processes) -> None:
    process = processes.start([sys.executable, "-m", CHECK, "--seconds", "0.1"])
    assert process.wait(120) == 2
    assert "no messages on /joint_states" in " ".join(processes.output(process).split())
