# SPDX-License-Identifier: Apache-2.0
"""Kinesthetic teaching and trial-and-error learning for a torque-controlled arm.

A movement is a mixture of spring-dampers with full coordination matrices (Eq. 1), learnt by
PoWER (Eqs. 2-3) from the returns of rollouts (Eqs. 4-5). Equation numbers are those of
Kormushev, Calinon and Caldwell, "Robot Motor Skill Coordination with EM-based Reinforcement
Learning", IROS 2010. Modules at the top level are the core: they import no rclpy, open no file,
read no clock, and take their random generator as an argument.
"""

from importlib import import_module

__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    """The library in `learning.skill`, which is imported when it is first used."""
    if name not in ("Attempt", "Policy", "fit", "path", "practise"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("wam_power_ros.learning.skill"), name)
