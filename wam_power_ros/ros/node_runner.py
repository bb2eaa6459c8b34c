# SPDX-License-Identifier: Apache-2.0
"""Bodies of every `main` that has a node: `run` for nodes, `run_script` for console scripts.

Both keep the process to the loopback interface, unless the network is asked for (`network`), remove
shared memory of dead processes, and number the process among the DDS participants.

Fast DDS gives a process the lowest participant number that is free, and with it its ports: after a
kill (-9) those of the killed one. The others still send there for 20 s, through shared memory, and
now and then one of them takes that port for dead and deletes it under the new listener, which then
receives no message and no answer for as long as it lives (Fast DDS, pull requests 4728 and 4737;
open in the 2.14 of Jazzy; seen in one to ten of a hundred restarts).
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from wam_power_ros.entry import INTERRUPTED
from wam_power_ros.params import parameter_file
from wam_power_ros.ros import interrupts, network, security, shared_memory
from wam_power_ros.ros.domain import FIRST_PORT, PORTS_PER_DOMAIN, PORTS_PER_PARTICIPANT, exported
from wam_power_ros.ros.service_client import ServiceError

N = TypeVar("N", bound=Node)
RCLError = rclpy_implementation.RCLError  # of the middleware, such as invalid keys
SPREAD = 16  # of the 32 numbers that are looked for within LOCALHOST, the rest for who comes later
REFUSED = 2  # exit status


def init(
    args: Sequence[str] | None = None, signals: SignalHandlerOptions = SignalHandlerOptions.ALL
) -> None:
    """Initialise rclpy for a process that reaches no further than it is asked to.

    Args:
        args: Command line; that of the process if None.
        signals: Signals that rclpy handles.

    Raises:
        ValueError: ROS_DOMAIN_ID is no domain, or security has no keystore.
    """
    exported(os.environ)
    security.check_keystore(os.environ, sys.argv if args is None else args)
    network.confine(os.environ)
    if not any(map(os.environ.get, ("ROS_LOG_DIR", "ROS_HOME", "HOME"))):  # rclpy insists on one
        os.environ["ROS_LOG_DIR"] = str(Path(tempfile.gettempdir()) / f"ros_log_{os.getuid()}")
    shared_memory.remove_dead_segments()
    rclpy.init(args=args, signal_handler_options=signals)


@contextmanager
def number_by_process() -> Iterator[None]:
    """Let the participant number begin at the process id modulo SPREAD; for the first node made.

    Lower numbers that are free are bound meanwhile, as if they were those of living processes.

    Raises:
        ValueError: The sockets of that node reach further than they were to.
    """
    first = FIRST_PORT + PORTS_PER_DOMAIN * exported(os.environ)
    others = network.bound_addresses()
    with ExitStack() as held:
        for number in range(os.getpid() % SPREAD):
            place = held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            with suppress(OSError):  # in use
                place.bind(("", first + PORTS_PER_PARTICIPANT * number))
        yield
    if (
        network.wider_reach(os.environ) is None
    ):  # a profile that is not applied leaves the network open
        beyond = [each for each in network.bound_addresses() if not each.startswith("127.")]
        if beyond := [each for each in beyond if each not in others]:
            raise ValueError(f"sockets at {', '.join(beyond)} are open to the network")


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
        interrupts.spin_once(executor, 0.05)
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
    """Dispatch the callbacks of a node until `ended()`.

    Args:
        node: Node.
        ended: Condition, checked after every callback and at least every `every` [s].
        between: Function that is called as often.
        every: Longest time between two checks [s], or a function that returns it.
        failed: Function that takes an exception that a callback did not catch, after which the node
            goes on; without it, the exception ends the node.
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
    """Run a node until SIGINT or SIGTERM, after which it can still send.

    Args:
        make_node: Makes the node; a `ValueError` from it is a configuration that is not acceptable.
            A method `close` of the node is called at the end: finish files, send the last command.
        args: Command line; that of the process if None.
        spin: Dispatches callbacks until the function it is given returns True.

    Returns:
        Exit status: 0 after a signal, 2 when the configuration was refused.
    """
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: signals.append(received))
    node = None
    try:
        init(args, SignalHandlerOptions.NO)
        with number_by_process():
            made = make_node()
        node = made
        spin(node, lambda: bool(signals))
    except (ValueError, RCLError) as error:
        if node is not None:
            raise
        get_logger("wam_power_ros").fatal(f"{error}{parameter_file_hint()}")
        return REFUSED
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if hasattr(node, "close"):
            node.close()
        end()
    return 0


def parameter_file_hint() -> str:
    """Where to get a parameter file, for a node that was started without one."""
    if parameter_file.given(sys.argv):
        return ""
    return (
        "\nStarted without a parameter file. `wam-power config > parameters.yaml` prints one for "
        "all nodes; give it with --ros-args --params-file parameters.yaml"
    )


def end() -> None:
    """Shut ROS down at the end of a process, which further signals do not end another way.

    `ros2 launch` sends a SIGINT after that of the terminal. The interpreter gives up its handlers
    when it ends, and a signal would then be the exit status.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    rclpy.try_shutdown()


@contextmanager
def participant(
    make_node: Callable[[], N], signals: SignalHandlerOptions = SignalHandlerOptions.ALL
) -> Iterator[N]:
    """Node of a script, alone in its process; ROS is shut down at the end.

    Args:
        make_node: Makes the node.
        signals: Signals that rclpy handles, each of which shuts ROS down.
    """
    init(signals=signals)
    try:
        with number_by_process():
            node = make_node()
        yield node
    finally:
        with suppress(RuntimeError):  # the shutdown of a signal, in a thread of rclpy, came first
            rclpy.try_shutdown()


def run_script(
    make_node: Callable[[], N],
    work: Callable[[N], int | None],
    signals: SignalHandlerOptions = SignalHandlerOptions.ALL,
) -> int:
    """Run a script that has a node and an end.

    Args:
        make_node: Makes the node.
        work: Does the work of the script; its result is the exit status, 0 if None.
        signals: Signals that rclpy handles.

    Returns:
        Exit status: that of `work`, REFUSED after an exception that is reported without a
        traceback, INTERRUPTED after a signal.
    """
    try:
        with participant(make_node, signals) as node:
            return work(node) or 0
    except (ServiceError, ValueError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return REFUSED
    except (KeyboardInterrupt, ExternalShutdownException):
        return INTERRUPTED
