# SPDX-License-Identifier: Apache-2.0
"""From the recorder to the learner, every node a process, with states as many drivers send them."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest
from test_session_over_dds import JOINTS, ended, lines, wait_for, wam_power

from wam_power_ros.bags import layout, reader
from wam_power_ros.bags.bag import Bag

# What is sent instead of values: while teaching, and afterwards while replaying and learning.
SENT = {"taught": ("empty", "nan"), "used": ("nan", "empty")}


@pytest.mark.long
def test_a_driver_that_leaves_values_out_is_taught_with_replayed_and_learnt_from(
    tmp_path: Path,
) -> None:
    simulated = {}
    for name, (velocity, effort) in SENT.items():
        setup = tmp_path / f"{name}.yaml"
        values = f"pace: lockstep, velocity: {velocity}, effort: {effort}"  # at any speed
        setup.write_text(f"wam_sim: {{ros__parameters: {{{values}}}}}")
        simulated[name] = ("--config", str(setup), "--simulate")

    def done(*arguments: str) -> str:
        status, output = ended(wam_power(tmp_path, *arguments))
        assert status == 0, output
        return output

    done("teach", "--demonstrations", "1", "--folder", "taught", *simulated["taught"])
    (bag,) = (tmp_path / "taught/bags").iterdir()
    for _, _, cdr in Bag(bag).messages([layout.STATES]):
        state = layout.decoded(cdr, layout.JOINT_STATE)
        for found, how in zip((state.velocity, state.effort), SENT["taught"], strict=True):
            assert len(found) == (0 if how == "empty" else 7)
            assert np.isnan(found).any() == (how == "nan")
    assert "good" in done("bags", "show", str(bag))

    part = tmp_path / "part"
    done("bags", "import", str(bag), "--part", "0.1", "1.9", "--output", str(part))
    stamps, q = reader.read_demonstration(bag, JOINTS)
    t = (stamps - stamps[0]) * 1e-9
    kept = (0.1 <= t) & (t <= 1.9)
    np.testing.assert_array_equal(reader.read_demonstration(part, JOINTS)[1], q[kept])

    replayed = done("replay", str(bag), "--speed", "0.5", "--folder", "r", *simulated["used"])
    assert "tool: rms" in replayed
    arguments = ("--bags", str(bag), "--session", "s", "--seed", "1", *simulated["used"])
    learning = wam_power(tmp_path, "learn", *arguments)
    wait_for(lambda: lines(tmp_path / "s") or learning.poll() is not None, "a rollout")
    learning.send_signal(signal.SIGINT)
    status, output = ended(learning)
    assert status == 130, output
    record = json.loads(lines(tmp_path / "s")[0])
    assert record["ret"] > 0.0 and not record["fault"], output
