# SPDX-License-Identifier: Apache-2.0
"""Entry points of all processes: a signal during their imports ends them without a traceback.

The imports take seconds on a slow machine, and nothing has been opened by then. Only the standard
library is imported here.

NumPy's linear algebra is limited to one thread, before it is imported. With more threads the order
of sums, hence the last digits, depend on the number of cores, and a session resumed on another
machine would continue differently.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
import warnings
from ctypes.util import find_library
from functools import partial

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
INTERRUPTED = 130  # exit status of a program that is interrupted before its work is done
REFUSED = 2  # exit status of a node that refuses its parameters
OTHER_PYTHON = (
    "build and run with the Python that `make venv` has filled, .venv/bin/python -m colcon build "
    "(docs/ros2.md), or install the module into this one"
)
SIGNALS = (signal.SIGINT, signal.SIGTERM)


def missing(error: ImportError) -> str:
    """One line: what cannot be imported, and what brings it; raises any other error."""
    if find_library("gomp") is None:
        return f"{error}: apt install libgomp1"
    package = (error.name or "").partition(".")[0]
    if package in (__package__, "hardware_sim"):
        raise error
    extras = {"viser": "view", "cv2": "camera", "pylibfranka": "franka", "natnet": "natnet"}
    if extra := extras.get(package):
        return f'{error}: pip install "wam_power_ros[{extra}]"'
    if package == "rclpy" or package.endswith(("_interfaces", "_msgs", "_srvs")):
        ours = 'pip install "wam_power_ros[ros]" and, in a checkout, ./wam_power_interfaces'
        return f"{error}: source ROS 2, or {ours}. Without ROS: wam-power learn --in-process"
    if not isinstance(error, ModuleNotFoundError):
        raise error
    return f"{sys.executable} has no module {package!r}: {OTHER_PYTHON}"


def start(module: str, interrupted: int = 0) -> int:
    """Exit status of the `main` of a module; `interrupted` after a signal during the import."""
    leave_libraries_of_another_python()
    if unloadable := missing_middleware():
        sys.stderr.write(f"{unloadable}\n")
        return REFUSED
    if "error" in os.environ.get("PYTHONWARNINGS", ""):  # rclpy itself warns
        warnings.simplefilter("default")
        del os.environ["PYTHONWARNINGS"]  # of child processes, too
    os.environ |= ONE_THREAD
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        if before[number] is not signal.SIG_IGN:
            signal.signal(number, lambda *_: os._exit(interrupted))
    try:
        main = importlib.import_module(module).main
    except ImportError as error:
        sys.stderr.write(f"{missing(error)}\n")
        return REFUSED
    for number in SIGNALS:
        signal.signal(number, before[number])
    return main()


def leave_libraries_of_another_python() -> None:
    """Begin anew if a parent has told the wheels of rclpy to load its own libraries.

    A `ros2` of wheels does so to what it runs: libraries for another Python abort the process. At
    its new begin Python looks for those of its own.
    """
    paths = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    own = os.path.join(sys.prefix, "lib")
    kept = [path for path in paths if path == own or not os.path.exists(f"{path}/librcl.so")]
    if kept != paths and os.environ.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", ""):
        os.environ["LD_LIBRARY_PATH"] = os.pathsep.join(kept)
        os.execv(sys.executable, sys.orig_argv)


def missing_middleware() -> str:
    """Why the middleware that RMW_IMPLEMENTATION names cannot be loaded; empty if it can.

    ROS would end the process while it is imported, without the name of the variable.
    """
    name, get = os.environ.get("RMW_IMPLEMENTATION", ""), os.environ.get
    prefixes = [sys.prefix, *get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    folders = [os.path.join(prefix, "lib") for prefix in filter(None, prefixes)]
    folders += get("LD_LIBRARY_PATH", "").split(os.pathsep)
    if (
        not name
        or not importlib.util.find_spec("rclpy")
        or any(os.path.exists(f"{folder}/lib{name}.so") for folder in folders)
    ):
        return ""
    package = f"ros-{get('ROS_DISTRO', 'jazzy')}-{name.replace('_', '-')}"
    return f"RMW_IMPLEMENTATION={name}: not installed; apt install {package}, or unset the variable"


torque_controller = partial(start, "wam_power_ros.nodes.torque_controller")
demonstration_recorder = partial(start, "wam_power_ros.nodes.demonstration_recorder")
body_tracker = pancake_tracker = partial(start, "wam_power_ros.nodes.body_tracker")
learner = partial(start, "wam_power_ros.nodes.learner")
check_driver = partial(start, "wam_power_ros.nodes.check_driver", INTERRUPTED)
tag_camera = partial(start, "wam_power_ros.nodes.tag_camera")
franka_driver = partial(start, "wam_power_ros.nodes.franka_driver")
natnet_client = partial(start, "wam_power_ros.nodes.natnet_client")
wam_sim = partial(start, "hardware_sim.main")
replay = partial(start, "wam_power_ros.console.replay_running", INTERRUPTED)
wam_power = partial(start, "wam_power_ros.cli.main", INTERRUPTED)

if __name__ == "__main__":
    raise SystemExit(globals()[sys.argv.pop(1)]())
