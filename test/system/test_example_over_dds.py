# SPDX-License-Identifier: Apache-2.0
"""The example over DDS: teach, learn, replay."""

from pathlib import Path

from test_examples import OVER_DDS, output


def test_the_example_teaches_learns_and_replays_over_dds(tmp_path: Path) -> None:
    domain, taught, *others, moved = output(OVER_DDS, tmp_path)
    assert domain.startswith("Simulation: in its own DDS domain")
    assert taught.startswith("taught demo_") and moved.startswith("moved: ")
    assert [line.split(": ")[0] for line in others[:4]] == [f"trial-{k}" for k in range(4)]
    assert "rms" in "".join(others[4:])
    assert len([*(tmp_path / "arm/bags").iterdir()]) == 5  # a demonstration, four rollouts
