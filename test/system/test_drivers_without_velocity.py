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

SENT = {
    "positions alone": ("empty", "empty"),
    "NaN": ("nan", "nan"),
}


@pytest.mark.parametrize("sent", SENT)
def test_a_driver_that_leaves_values_out_is_taught_with_replayed_and_learnt_from(
    sent: str, tmp_path: Path
) -> None:
    velocity, effort = SENT[sent]
    setup = tmp_path / "driver.yaml"
    values = f"pace: lockstep, velocity: {velocity}, effort: {effort}"  # at any speed
    setup.write_text(f"wam_sim: {{ros__parameters: {{{values}}}}}")
    simulated = ("--config", str(setup), "--simulate")

    def done(*arguments: str) -> str:
        status, output = ended(wam_power(tmp_path, *arguments))
        assert status == 0, output
        return output

    done("teach", "--demonstrations", "1", "--folder", "taught", *simulated)
    (bag,) = (tmp_path / "taught/bags").iterdir()
    for _, _, cdr in Bag(bag).messages([layout.STATES]):
        state = layout.decoded(cdr, layout.JOINT_STATE)
        for found, how in ((state.velocity, velocity), (state.effort, effort)):
            assert len(found) == (0 if how == "empty" else 7)
            assert np.isnan(found).any() == (how == "nan")
    assert "good" in done("bags", "list", "taught")

    done("bags", "trim", str(bag), "0.1", "1.9")
    part = bag.with_name(f"{bag.name}_trimmed")
    stamps, q = reader.read_demonstration(bag, JOINTS)
    t = (stamps - stamps[0]) * 1e-9
    kept = (0.1 <= t) & (t <= 1.9)
    np.testing.assert_array_equal(reader.read_demonstration(part, JOINTS)[1], q[kept])

    assert "tool: rms" in done("replay", str(bag), "--speed", "0.5", "--folder", "r", *simulated)
    learning = wam_power(
        tmp_path, "learn", "--bags", str(bag), "--session", "s", "--seed", "1", *simulated
    )
    wait_for(lambda: lines(tmp_path / "s") or learning.poll() is not None, "a rollout")
    learning.send_signal(signal.SIGINT)
    status, output = ended(learning)
    assert status == 130, output
    record = json.loads(lines(tmp_path / "s")[0])
    assert record["ret"] > 0.0 and not record["fault"], output
