# SPDX-License-Identifier: Apache-2.0
"""Log and diagnostics of the torque controller, sent through its preparation process."""

from __future__ import annotations

import time
import traceback
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from rclpy.node import Node

from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import Mode
from wam_power_ros.faults import Fault
from wam_power_ros.nodes.preparation import Preparation
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.ros import interface
from wam_power_ros.ros.diagnostics import FAULT_KIND, LAST_STOP, component
from wam_power_ros.ros.scheduling import Granted

UNEXPLAINED = "unexplained torque"  # key of the diagnostics
FAILURE_PERIOD_NS = 1_000_000_000  # [ns] between two logged exceptions


@dataclass(frozen=True)
class Condition:
    """State of the torque controller node."""

    core: Controller | None  # None until the node is configured
    fault: Fault | None  # latched fault, also after a clean-up
    description_missing: str | None  # who does not send it; None if it is known
    autostart: bool  # the node configures and activates itself
    active: bool
    missing_state: str | None  # why the joint states do not suffice to hold the arm, else None
    granted: Granted
    last_stop: str = ""  # id of the last stop by a person
    finalized: bool = False  # shut down: only its process is left

    @property
    def mode(self) -> str:
        """Mode of the controller, "unconfigured" without one."""
        return "unconfigured" if self.core is None else self.core.mode.value


class ControllerReport:
    """Logs changes and refusals, and publishes diagnostics."""

    def __init__(
        self, node: Node, params: TorqueControllerParams, preparation: Preparation
    ) -> None:
        self._node, self._params, self._preparation = node, params, preparation
        preparation.logger = node.get_logger().name  # as in the diagnostics
        self._refused: Counter[str] = Counter()
        self._last_refusal, self._refused_since_report = "", False
        self._failed_ns = -FAILURE_PERIOD_NS  # when an exception was last logged
        self._logged: dict[str, object] = {}  # last logged mode, fault and awaited input

    def refuse(self, what: str, reason: object) -> None:
        """Count and log a refusal."""
        self._refused[what] += 1
        self._last_refusal, self._refused_since_report = f"{what} refused: {reason}", True
        self._preparation.log("warning", self._last_refusal)

    def failed(self, error: Exception) -> None:
        """Count an exception that a callback did not catch; log it, at most one a second."""
        now_ns = time.monotonic_ns()
        if now_ns - self._failed_ns < FAILURE_PERIOD_NS:  # every state may fail
            self._refused["callback"] += 1
            return
        self._failed_ns = now_ns
        where = " < ".join(  # innermost first; without source lines, which take long to read
            f"{frame.f_code.co_filename}:{line} {frame.f_code.co_name}"
            for frame, line in reversed([*traceback.walk_tb(error.__traceback__)])
        )
        self.refuse("callback", f"{error!r} at {where}")

    def log_changes(self, now: Condition) -> None:
        """Log every change of mode, fault, awaited input, and whether the model carries the arm."""
        excess = "" if now.core is None else now.core.unexplained.excess()
        values = {"mode": now.mode, "fault": now.fault, "waiting": self._awaited(now)}
        values["unexplained"] = bool(excess)  # not its size, which varies
        changed = {key: value for key, value in values.items() if value != self._logged.get(key)}
        self._logged = values
        if isinstance(fault := changed.get("fault"), Fault):
            self._preparation.log("error", f"fault ({fault.kind.value}): {fault.text}")
        elif "fault" in changed:
            self._preparation.log("info", "the fault was reset")
        if "mode" in changed:
            self._preparation.log("info", f"mode {now.mode}")
        if changed.get("unexplained"):
            self._preparation.log("warning", f"holding the arm takes more than its model: {excess}")
        if changed.get("waiting"):
            self._preparation.log("info", f"waiting for {changed['waiting']}")

    def _awaited(self, now: Condition) -> str:
        """What the node waits for before it can be active, as text; empty if nothing."""
        if now.active:
            return ""
        if now.finalized:
            return "its end (Ctrl-C): it was shut down"
        node = self._node.get_fully_qualified_name()
        if now.description_missing is not None:
            topic = self._node.resolve_topic_name(interface.ROBOT_DESCRIPTION)
            return f"the robot description on {topic}{now.description_missing}"
        if now.core is None:
            return "" if now.autostart else f"ros2 lifecycle set {node} configure"
        if now.missing_state:
            topic = self._node.resolve_topic_name(self._params.state_topic)
            return f"joint states on {topic} ({now.missing_state})"
        return "" if now.autostart else f"ros2 lifecycle set {node} activate"

    def publish(self, now: Condition, figures: Mapping[str, str], overload: str) -> None:
        """Publish the figures of the last second; `overload` is a warning, empty for none."""
        core = now.core
        unexplained = "" if core is None else core.unexplained.excess()
        if self._params.output != "torque":
            unexplained = f"not checked: the arm takes {self._params.output}"
        values = {
            "mode": now.mode,
            "policy": (core and core.policy_id) or "",
            FAULT_KIND: now.fault.kind.value if core and now.fault else "",
            **figures,
            LAST_STOP: now.last_stop,
            **({} if core is None else core.counters),
            UNEXPLAINED: unexplained,
            **{f"refused: {name}": count for name, count in self._refused.items()},
            "real-time scheduling": now.granted.scheduling,
            "locked memory": now.granted.memory,
            "last refusal": self._last_refusal,
            "preparation processes": self._preparation.starts,
        }
        level, text = self._summary(now, overload)
        self._refused_since_report = False
        stamp_ns = self._node.get_clock().now().nanoseconds
        of = {"name": component(self._node, "loop"), "hardware_id": self._params.hardware_id}
        self._preparation.report(stamp_ns, values, **of, level=level, text=text)

    def _summary(self, now: Condition, overload: str) -> tuple[str, str]:
        if now.core is not None and now.core.mode is Mode.FAULT:
            return "error", now.fault.text if now.fault else "fault"
        if not now.active or now.missing_state:
            return "warn", now.missing_state or "not active"
        if overload:
            return "warn", overload
        if now.core is not None and (excess := now.core.unexplained.excess()):
            return "warn", f"{now.mode}; {excess}"
        if self._params.realtime_priority and not now.granted.complete:
            return "warn", f"{now.mode}; no real-time scheduling"
        if self._refused_since_report:
            return "warn", self._last_refusal
        return "ok", now.mode
