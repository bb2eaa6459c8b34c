# SPDX-License-Identifier: Apache-2.0
"""Compiled inner loops of the control step, where a C compiler was there to build them.

`kernel` is the module built from `_kernel.c`, else None: everything runs without it, only slower.
A function of it stands in front of the Python code that does the same, and answers only while
nothing is wrong; beyond a limit the Python code decides and finds the words. Torques are the same
bit for bit, so a session does not depend on which of the two has run.
"""

from importlib import import_module
from types import ModuleType

_INTERFACE = 1  # of the functions: one built from another version of the source is not used


def _built() -> ModuleType | None:
    try:
        module = import_module("wam_power_ros._kernel")
    except ImportError:
        return None
    return module if module.INTERFACE == _INTERFACE else None


kernel = _built()
