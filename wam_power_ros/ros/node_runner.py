# SPDX-License-Identifier: Apache-2.0
"""Bodies of every `main` that has a node: `run` for nodes, `run_script` for console scripts.

Both restrict the process to the loopback interface unless the environment asks for more
(`network`).
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TypeVar

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from wam_power_ros.durable_files import explained
from wam_power_ros.entry import INTERRUPTED, REFUSED, SIGNALS
from wam_power_ros.params import parameter_file
from wam_power_ros.ros import network
from wam_power_ros.ros.domain import exported
from wam_power_ros.ros.outcomes import ServiceError

N = TypeVar("N", bound=Node)
RCLError = rclpy_implementation.RCLError  # error of the middleware, such as invalid keys


def init(context: Context | None = None, domain: int | None = None) -> None:
    """Initialise rclpy, on the loopback interface only unless the environment asks for more.

    Context and domain are those of the process and of ROS_DOMAIN_ID by default. A ValueError names
    a variable of the environment or a parameter file that cannot be used.
    """
    network.check(os.environ)
    for file in parameter_file.given(sys.argv):
        parameter_file.read(file, parameter_file.PlainLoader)
    domain = exported(os.environ) if domain is None else domain
    network.restrict_to_loopback(os.environ)
    if not any(map(os.environ.get, ("ROS_LOG_DIR", "ROS_HOME", "HOME"))):  # rclpy insists on one
        os.environ["ROS_LOG_DIR"] = str(Path(tempfile.gettempdir()) / f"ros_log_{os.getuid()}")
    signals = SignalHandlerOptions.NO  # its handlers end all communication at once
    rclpy.init(context=context, domain_id=domain, signal_handler_options=signals)


def executor_for(node: Node) -> Executor:
    """Return the events executor, which needs half the CPU of the plain one, if rclpy has it."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        node.get_logger().warning("no events executor in this rclpy; using the plain one")
        executor: Executor = SingleThreadedExecutor(context=node.context)
    else:
        executor = EventsExecutor(context=node.context)
    executor.add_node(node)
    return executor


def spin(
    node: Node,
    ended: Callable[[], bool],
    between: Callable[[], None] | None = None,
    period: Callable[[], float] = lambda: 0.2,
    on_error: Callable[[Exception], None] | None = None,
) -> None:
    """Dispatch the callbacks of a node until `ended()`.

    `ended` is checked, and `between` called, after every callback and at least once a `period()`
    [s]. `on_error` is called with an exception that a callback did not catch, after which the node
    goes on; without it, the exception ends the node.
    """
    executor = executor_for(node)
    while not ended() and rclpy.ok():  # not executor.spin(): it hangs in builds for Jazzy
        try:
            executor.spin_once(timeout_sec=period())
            if between is not None:
                between()
        except Exception as error:
            if on_error is None or isinstance(error, ExternalShutdownException):
                raise
            on_error(error)


def check_arguments() -> None:
    """Raise a ValueError if the command line has words that no node reads."""
    if unread := remove_ros_args(sys.argv)[1:]:
        raise ValueError(f"{' '.join(unread)}: a node reads only what follows --ros-args")


def run(
    make_node: Callable[[], Node], spin: Callable[[Node, Callable[[], bool]], None] = spin
) -> int:
    """Run a node until SIGINT or SIGTERM, after which it can still send.

    Its method `close`, if it has one, is called at the end, to finish files and send the last
    command. Returns the exit status: 0 after a signal, 2 if `make_node` refused the parameters by
    a ValueError.
    """
    received: list[int] = []
    for number in SIGNALS:
        signal.signal(number, lambda signum, _: received.append(signum))
    node = None
    try:
        init()
        check_arguments()
        node = make_node()
        spin(node, lambda: bool(received))
    except (ValueError, RCLError) as error:
        if node is not None:
            raise
        if isinstance(error, network.VariableError):  # maybe of the log itself
            sys.stderr.write(f"{error}\n")
        else:
            get_logger("wam_power_ros").fatal(str(error))
        return REFUSED
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if hasattr(node, "close"):
            node.close()
        end()
    return 0


def interrupt_on_signals() -> None:
    """Let the first SIGINT or SIGTERM raise KeyboardInterrupt; further ones are ignored.

    Only for processes whose main thread dispatches no callbacks: an exception that a signal handler
    raises while the events executor calls Python from C++ becomes a RuntimeError or is lost.
    """

    def interrupt(signum: int, frame: FrameType | None) -> None:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    for number in SIGNALS:
        signal.signal(number, interrupt)


def end() -> None:
    """Shut ROS down at the end of a process, and ignore further signals.

    `ros2 launch` sends a SIGINT after that of the terminal. The interpreter removes its handlers
    when it ends, and such a signal would change the exit status.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    rclpy.try_shutdown()


@contextmanager
def participant(
    make_node: Callable[[], N],
    domain: int | None = None,
    context: Context | None = None,
    on_loopback: bool = False,
) -> Iterator[N]:
    """Make a node; its context, by default that of the process, is shut down at the end.

    With `on_loopback` it reaches this machine only, as a simulation does, even if the environment
    asks for more.
    """
    # The middleware reads its transports from the environment and nowhere else.
    node, before = None, dict(os.environ)
    try:
        try:
            if on_loopback:
                os.environ.update(network.ON_LOOPBACK)
            init(context, domain)
            node = make_node()
        finally:
            for name in os.environ.keys() - before.keys():
                del os.environ[name]
            os.environ.update(before)
        yield node
    finally:
        if node is not None and isinstance(node.executor, SingleThreadedExecutor):
            node.executor.shutdown()  # its garbage collection may print a traceback
        rclpy.try_shutdown(context=context)


def run_script(make_node: Callable[[], N], work: Callable[[N], int | None]) -> int:
    """Run a script that needs a node, and whose main thread dispatches no callbacks.

    Returns the exit status: that of `work`, 0 if None; REFUSED after an exception that is reported
    without a traceback; INTERRUPTED after a signal.
    """
    interrupt_on_signals()
    try:
        with participant(make_node) as node:
            return work(node) or 0
    except (ServiceError, ValueError, OSError) as error:
        text = explained(error) if isinstance(error, OSError) else str(error)
        sys.stderr.write(f"{text}\n")
        return REFUSED
    except (KeyboardInterrupt, ExternalShutdownException):
        return INTERRUPTED
