# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium for the tests of the page."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), "")
FLAGS = (  # WebGL without a graphics card; root has no sandbox
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--no-sandbox",
)
PAGE_TIMEOUT = 60_000.0  # [ms] on a slow, busy machine


@contextmanager
def chromium() -> Iterator[Any]:
    """A running Chromium; the test is skipped if there is none."""
    if not CHROMIUM:
        pytest.skip(f"no browser: none of {', '.join(NAMES)}")
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS, timeout=PAGE_TIMEOUT)
        try:
            yield browser
        finally:
            browser.close()


def opened(browser: Any, url: str) -> Any:  # noqa: ANN401
    """A new page, small because every pixel is drawn by the processor."""
    page = browser.new_page(viewport={"width": 640, "height": 400})
    page.set_default_timeout(PAGE_TIMEOUT)
    page.goto(url)
    page.wait_for_selector("canvas")
    return page


def scene(page: Any) -> np.ndarray:  # noqa: ANN401
    """Pixels of the left part of the scene, which no panel covers. Shape (400, 300, 3)."""
    from PIL import Image

    clip = {"x": 0, "y": 0, "width": 300, "height": 400}
    return np.asarray(Image.open(io.BytesIO(page.screenshot(clip=clip))).convert("RGB"), dtype=int)
