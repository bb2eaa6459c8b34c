# SPDX-License-Identifier: Apache-2.0
"""Signals in a process that dispatches callbacks."""

import os
import signal
from collections.abc import Callable, Iterator

import pytest

from wam_power_ros.ros import interrupts


class Executor:
    """Calls a function while it dispatches, and records that it has returned."""

    def __init__(self, work: Callable[[], object]) -> None:
        self.done, self._work = False, work

    def spin_once(self, timeout_sec: float) -> None:  # noqa: D102
        self._work()
        self.done = True


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in interrupts.SIGNALS}
    interrupts.install()
    yield
    interrupts.install()
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", interrupts.SIGNALS)
def test_a_signal_outside_the_middleware_interrupts_at_once(number: int) -> None:
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", interrupts.SIGNALS)
def test_a_signal_while_callbacks_are_dispatched_interrupts_after_them(number: int) -> None:
    executor = Executor(lambda: os.kill(os.getpid(), number))
    with pytest.raises(KeyboardInterrupt):
        interrupts.spin_once(executor, 0.1)
    assert executor.done


def test_an_interrupt_is_not_lost_to_an_error_of_a_callback() -> None:
    def fail() -> None:
        interrupt()
        raise ValueError("a callback failed")

    with pytest.raises(KeyboardInterrupt):
        interrupts.spin_once(Executor(fail), 0.1)


def test_further_signals_disturb_nothing() -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupt()
    interrupt()


@pytest.mark.parametrize("within", [True, False])
def test_what_is_cleaned_up_after_an_interrupt_dispatches_as_before(within: bool) -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupts.spin_once(Executor(interrupt), 0.1) if within else interrupt()
    executor = Executor(lambda: None)
    interrupts.spin_once(executor, 0.1)
    assert executor.done
