# SPDX-License-Identifier: Apache-2.0
"""The stand-in of the motion capture."""

from __future__ import annotations

from conftest import Processes


def test_optitrack_sim_alone_explains_how_it_is_started(processes: Processes) -> None:
    process = processes.node("hardware_sim.optitrack_node")
    assert process.wait(60.0) == 2
    assert "start wam_sim" in processes.output(process)
