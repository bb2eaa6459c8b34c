# SPDX-License-Identifier: Apache-2.0
"""The example over DDS: teach, learn, replay."""

from pathlib import Path

from test_examples import OVER_DDS, output


def test_the_example_teaches_learns_and_replays_over_dds(tmp_path: Path) -> None:
    domain, taught, *trials, replayed, moved = output(OVER_DDS, tmp_path, 300.0)
    assert domain.startswith("Simulation: in its own DDS domain")
    assert taught.startswith("taught demo_") and "rms" in replayed and moved.startswith("moved: ")
    assert [line.split(": ")[0] for line in trials] == [f"trial-{k}" for k in range(4)]
    assert len([*(tmp_path / "arm/bags").iterdir()]) >= 6
