# SPDX-License-Identifier: Apache-2.0
"""Signals of a script."""

import os
import signal
from collections.abc import Iterator

import pytest

from wam_power_ros.ros import interrupts


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in interrupts.SIGNALS}
    interrupts.install()
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", interrupts.SIGNALS)
def test_the_first_signal_interrupts_at_once_and_further_ones_disturb_nothing(number: int) -> None:
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), number)
    for each in interrupts.SIGNALS:
        os.kill(os.getpid(), each)
