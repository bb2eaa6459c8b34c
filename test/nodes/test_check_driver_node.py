# SPDX-License-Identifier: Apache-2.0
"""check_driver over real DDS, against the stand-in and four that are broken."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, Probe, Processes
from std_msgs.msg import String

from hardware_sim.driver_watch import UNNAMED
from wam_power_ros.ros import interface, joint_messages
from wam_power_ros.ros.domain import private_domain

CHECK = "wam_power_ros.nodes.check_driver"
BROKEN = {  # fault -> the one row that fails, and part of its text
    "wrong order": ("gravity", "wrong order of joints: wam_j2, wam_j6"),
    "two publishers": ("state publisher", "on /joint_states: /wam_sim, /wam_sim"),
    "another frame": ("mocap poses", "'camera' is not connected to 'world'"),
    "no watchdog": ("watchdog", "no watchdog"),
}


class Bench:
    """The stand-ins in real time, with a fault that can be chosen."""

    def __init__(self, domain_id: int, folder: Path) -> None:
        self._folder = folder
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
        self, *arguments: str, fault: str = "none", typed: str = "", by_hand: str | None = None
    ) -> dict[str, Any]:
        """Report of check_driver under a fault, with its exit status and output.

        The check is repeated if this machine was too busy to receive camera frames in time.

        Args:
            arguments: Of the command.
            fault: The fault from the start.
            typed: What a person types.
            by_hand: Fault from the question whether joints are led, before anything is typed.
        """
        for _ in range(3):
            table = self._check(arguments, fault, typed, by_hand)
            late = "mocap latency" in failing(table)
            if not late or table["rows"]["mocap jitter"]["verdict"] == "ok":
                break
        return table

    def _check(
        self, arguments: tuple[str, ...], fault: str, typed: str, by_hand: str | None
    ) -> dict[str, Any]:
        self.set(fault)
        file = self._folder / "rows.json"
        file.unlink(missing_ok=True)
        arguments = ("--seconds", "1", "--json", str(file), *arguments)
        if not typed:  # nobody is there
            process = self.processes.start([sys.executable, "-m", CHECK, *arguments])
            status = process.wait(300.0)
            return self._table(file, status, self.processes.output(process))
        command = [sys.executable, "-m", "wam_power_ros.cli", "run", "check_driver", *arguments]
        printed = self._folder / "check.log"
        with printed.open("w") as output:
            process = subprocess.Popen(
                command,
                cwd=ROOT,
                env=self.processes.environment,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                text=True,
            )
        if by_hand is not None:
            self.probe.until(lambda: "Move each" in printed.read_text(), "question about joints")
            self.set(by_hand)
        process.communicate(typed, timeout=300)
        return self._table(file, process.returncode, printed.read_text())

    @staticmethod
    def _table(file: Path, status: int, output: str) -> dict[str, Any]:
        sys.stdout.write(output)
        table = json.loads(file.read_text()) if file.exists() else {"rows": []}
        rows = {row["name"]: row for row in table["rows"]}
        return table | {"rows": rows, "status": status, "output": output}

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
    for _ in range(3):  # a busy machine shows the torque too late
        table = bench.check("--active", typed="y\n" + 7 * "\n")  # y, but no joint is moved
        assert (table["status"], failing(table)) == (0, [])
        if table["rows"]["watchdog"]["verdict"] == "ok":
            break
    assert table["rows"]["wam_j7 by hand"]["found"] == "no joint moved"
    assert "CONFORMS" in table["output"]
    for name in ("joint names", "gravity", "command path", "mocap axes"):
        assert table["rows"][name]["verdict"] == "ok", name
    assert "own torque after" in table["rows"]["watchdog"]["found"]


@pytest.mark.requirement("S-130")
@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_driver_does_not_conform_and_is_named_for_what_it_is(
    bench: Bench, fault: str
) -> None:
    table = bench.check(*(["--active"] if fault == "no watchdog" else []), fault=fault)
    name, text = BROKEN[fault]
    assert (table["status"], failing(table)) == (1, [name])
    assert text in table["rows"][name]["found"] + table["rows"][name]["advice"]
    assert f"DOES NOT CONFORM, do not move the arm: {name}" in " ".join(table["output"].split())


@pytest.mark.long
def test_a_driver_that_falls_silent_while_joints_are_led_does_not_conform(bench: Bench) -> None:
    table = bench.check("--active", typed="y\n" + 7 * "\n", by_hand="silent")
    assert (table["status"], failing(table)) == (1, ["wam_j1 by hand"])
    assert "stopped sending" in table["rows"]["wam_j1 by hand"]["advice"]
    assert "wam_j2 by hand" not in table["rows"]


def test_without_consent_no_torque_is_sent(bench: Bench) -> None:
    torques = bench.probe.listen(
        joint_messages.COMMAND_TYPES["multiarray"], interface.EFFORT_COMMANDS, interface.COMMAND
    )
    table = bench.check(typed="no\n")
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
