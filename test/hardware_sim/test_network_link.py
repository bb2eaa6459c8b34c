# SPDX-License-Identifier: Apache-2.0
"""Latency, jitter and loss of a link."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hardware_sim.main import Link


@given(st.integers(0, 2**32), st.lists(st.integers(0, 5_000_000), min_size=1, max_size=50))
def test_items_on_a_link_keep_their_order_and_depend_on_the_seed_alone(
    seed: int, gaps: list[int]
) -> None:
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
