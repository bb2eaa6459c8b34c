# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="no viser")

from browser import chromium, opened, scene

BAG = Path(__file__).resolve().parents[2] / "bags/demo_20261121_121737"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    """Address of a page that shows a bag, served by the command line."""
    command = [sys.executable, "-m", "wam_power_ros.cli", "view", str(BAG), "--port", "0"]
    viewing = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield viewing.stdout.readline().split()[0]
    finally:
        viewing.send_signal(signal.SIGINT)
        assert viewing.wait(60) == 0


def until_drawn_otherwise(page: Any, before: np.ndarray) -> np.ndarray:  # noqa: ANN401
    for _ in range(100):
        after = scene(page)
        if np.abs(after - before).max() > 30:
            return after
        page.wait_for_timeout(100)
    raise AssertionError("the picture did not change")


def test_a_bag_is_drawn_and_played(browser: Any, url: str) -> None:  # noqa: ANN401
    page = opened(browser, url)
    page.get_by_role("button", name="Play").wait_for()
    arm = until_drawn_otherwise(page, np.full((400, 300, 3), 255))
    slider = page.get_by_role("slider")
    page.get_by_role("button", name="Play").click()
    page.wait_for_function("Number(document.querySelector('[role=slider]').ariaValueNow) > 0.3")
    until_drawn_otherwise(page, arm)
    page.get_by_role("button", name="Pause playback").click()
    assert float(slider.get_attribute("aria-valuenow")) > 0.3
    page.close()
