# SPDX-License-Identifier: Apache-2.0
"""Entry points of all processes: a signal that comes while their modules are imported ends them.

The imports take seconds on a slow machine, and nothing has been opened then: the process ends as
it would later, without a traceback. Nothing but the standard library is imported here.

NumPy's linear algebra gets one thread, which has to be set before it is imported: with more, sums
are ordered otherwise, last digits depend on the number of cores, and a session that is resumed on
another machine would go on otherwise.
"""

from __future__ import annotations

import importlib
import os
import signal
from functools import partial

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
INTERRUPTED = 130  # exit status of a program that was interrupted before it had done its work
SIGNALS = (signal.SIGINT, signal.SIGTERM)


def start(module: str, interrupted: int = 0) -> int:
    """Import a module and run its `main`.

    Args:
        module: Name of the module.
        interrupted: Exit status after SIGINT or SIGTERM during the import.

    Returns:
        Exit status.
    """
    os.environ |= ONE_THREAD
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        if before[number] is not signal.SIG_IGN:
            signal.signal(number, lambda *_: os._exit(interrupted))
    main = importlib.import_module(module).main
    for number in SIGNALS:
        signal.signal(number, before[number])
    status: int = main()
    return status


torque_controller = partial(start, "wam_power_ros.nodes.torque_controller")
demonstration_recorder = partial(start, "wam_power_ros.nodes.demonstration_recorder")
pancake_tracker = partial(start, "wam_power_ros.nodes.pancake_tracker")
learner = partial(start, "wam_power_ros.nodes.learner")
check_driver = partial(start, "wam_power_ros.nodes.check_driver", INTERRUPTED)
wam_sim = partial(start, "hardware_sim.main")
wam_power = partial(start, "wam_power_ros.cli.main", INTERRUPTED)
