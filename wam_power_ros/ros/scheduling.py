# SPDX-License-Identifier: Apache-2.0
"""Run a node: executor with a self-test, real-time scheduling where allowed, clean end."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from wam_power_ros.ros.node_runner import number_by_process

MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4


@dataclass(frozen=True)
class Granted:
    """What the machine allowed; each text is "granted" or the reason why not."""

    scheduling: str = "not asked for"
    memory: str = "not asked for"

    @property
    def complete(self) -> bool:
        """Whether scheduling and memory are as a 500 Hz loop wants them."""
        return self.scheduling == self.memory == "granted"


def request(priority: int) -> Granted:
    """Ask for SCHED_FIFO in every thread of the process, locked memory and a frozen heap.

    Args:
        priority: real-time priority, 1 to 99; 0 asks for nothing.

    Returns:
        What was granted; nothing is raised when the machine says no.
    """
    if priority == 0:
        return Granted()
    gc.collect()
    gc.freeze()  # what was built at start is never walked again
    return Granted(_schedule(priority), _lock_memory())


def _schedule(priority: int) -> str:
    if not hasattr(os, "sched_setscheduler"):
        return "not Linux"
    try:  # threads made later inherit from the one that makes them
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, ValueError) as error:
        return f"refused: {error}; allow rtprio in /etc/security/limits.d"
    return "granted"


def _lock_memory() -> str:
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "mlockall"):
        return "not Linux"
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0:
        reason = os.strerror(ctypes.get_errno())
        return f"refused: {reason}; allow memlock in /etc/security/limits.d"
    return "granted"


def executor_for(node: Node, patience: float = 1.0) -> Executor:
    """The events executor if it calls a timer of `node` within `patience` [s], else the plain one.

    The events executor needs half the CPU of the plain one; some builds of it dispatch nothing.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor

        executor = EventsExecutor()
    except ImportError:
        return _plain(node, "is not in this rclpy")
    executor.add_node(node)
    called: list[bool] = []
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    timer = node.create_timer(1e-3, lambda: called.append(True), clock=steady)
    start = steady.now()
    while not called and (steady.now() - start).nanoseconds < patience * 1e9:
        executor.spin_once(timeout_sec=0.05)
    node.destroy_timer(timer)
    if called:
        return executor
    executor.remove_node(node)
    return _plain(node, "dispatched nothing in its self-test")


def _plain(node: Node, reason: str) -> Executor:
    node.get_logger().warning(f"events executor {reason}; using the single-threaded one")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    return executor


def spin(
    node: Node,
    ended: Callable[[], bool],
    between: Callable[[], None] | None = None,
    every: float | Callable[[], float] = 0.2,
    failed: Callable[[Exception], None] | None = None,
) -> None:
    """Dispatch the callbacks of `node` until `ended()`.

    Args:
        node: Whose callbacks.
        ended: Asked after every callback and at least `every` [s].
        between: Called as often.
        every: [s], or asked for it every time.
        failed: Told of an exception that a callback did not catch, after which the node goes on;
            without it, it ends.
    """
    executor = executor_for(node)
    while not ended() and rclpy.ok():  # not executor.spin(): it hangs in these builds
        try:
            executor.spin_once(timeout_sec=every() if callable(every) else every)
            if between is not None:
                between()
        except Exception as error:
            if failed is None or isinstance(error, ExternalShutdownException):
                raise
            failed(error)


def run(
    make_node: Callable[[], Node],
    args: Sequence[str] | None = None,
    spin: Callable[[Node, Callable[[], bool]], None] = spin,
) -> int:
    """The body of every node's `main`; SIGINT and SIGTERM end it with the node still able to send.

    Args:
        make_node: Makes the node; a `ValueError` from it is a configuration that is not acceptable.
            A method `close` of the node is called at the end: finish files, send the last command.
        args: Command line, that of the process if None.
        spin: Dispatches callbacks until the function it is given returns True.

    Returns:
        Exit status: 0 after a signal, 2 when the configuration was refused.
    """
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: signals.append(received))
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    node = None
    try:
        with number_by_process():
            node = make_node()
        spin(node, lambda: bool(signals))
    except ValueError as error:
        if node is not None:
            raise
        get_logger("wam_power_ros").fatal(str(error))
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if hasattr(node, "close"):
            node.close()
        rclpy.try_shutdown()
    return 0
