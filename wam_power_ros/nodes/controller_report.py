# SPDX-License-Identifier: Apache-2.0
"""What the torque controller logs and reports, by way of its preparation process."""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from rclpy.node import Node

from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import Mode
from wam_power_ros.learning.rollout import Fault
from wam_power_ros.nodes.preparation import Preparation
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.ros import interface
from wam_power_ros.ros.diagnostics import FAULT_KIND, component
from wam_power_ros.ros.scheduling import Granted


@dataclass(frozen=True)
class Condition:
    """How far the torque controller is, and what it lacks."""

    core: Controller | None  # None until the node is configured
    fault: Fault | None  # that is latched, also in a controller that was cleaned up
    described: bool  # the robot description is known
    autostart: bool  # it configures and activates itself
    active: bool
    unfit: str | None  # what the joint states lack; None when the arm can be held
    granted: Granted  # by the machine

    @property
    def mode(self) -> str:
        """Mode of the controller, in words."""
        return "unconfigured" if self.core is None else self.core.mode.value


class ControllerReport:
    """Logs what changes, counts what is refused, and publishes both as diagnostics.

    Args:
        node: Node of the loop.
        params: Its parameters.
        preparation: Process that logs and publishes.
    """

    def __init__(
        self, node: Node, params: TorqueControllerParams, preparation: Preparation
    ) -> None:
        self._node, self._params, self._preparation = node, params, preparation
        self._refused: Counter[str] = Counter()
        self._last_refusal, self._refused_lately = "", False
        self._logged: dict[str, object] = {}  # what was logged last of mode, fault and waiting

    def refuse(self, what: str, reason: object) -> None:
        """Count and log what was refused."""
        self._refused[what] += 1
        self._last_refusal, self._refused_lately = f"{what} refused: {reason}", True
        self._preparation.log("warning", self._last_refusal)

    def failed(self, error: Exception) -> None:
        """Count and log a callback that has failed."""
        where = " < ".join(  # innermost first; to read the lines of the source would take long
            f"{frame.f_code.co_filename}:{line} {frame.f_code.co_name}"
            for frame, line in reversed([*traceback.walk_tb(error.__traceback__)])
        )
        self.refuse("callback", f"{error!r} at {where}")

    def log_changes(self, now: Condition) -> None:
        """Log once each: modes, faults, their reset, and what the node waits for."""
        changes = {"mode": now.mode, "fault": now.fault, "waiting": self._awaited(now)}
        changed = {key: value for key, value in changes.items() if value != self._logged.get(key)}
        self._logged = changes
        if isinstance(fault := changed.get("fault"), Fault):
            self._preparation.log("error", f"fault ({fault.kind.value}): {fault.text}")
        elif "fault" in changed:
            self._preparation.log("info", "the fault was reset")
        if "mode" in changed:
            self._preparation.log("info", f"mode {now.mode}")
        if changed.get("waiting"):
            self._preparation.log("info", f"waiting for {changed['waiting']}")

    def _awaited(self, now: Condition) -> str:
        """What the node waits for before it is active, in words; empty when it is."""
        if now.active:
            return ""
        node = self._node.get_fully_qualified_name()
        if not now.described:
            topic = self._node.resolve_topic_name(interface.ROBOT_DESCRIPTION)
            return f"the robot description on {topic}"
        if now.core is None:
            return "" if now.autostart else f"ros2 lifecycle set {node} configure"
        if now.unfit:
            return f"joint states on {self._node.resolve_topic_name(self._params.state_topic)}"
        return "" if now.autostart else f"ros2 lifecycle set {node} activate"

    def publish(self, now: Condition, figures: Mapping[str, str], overload: str) -> None:
        """Publish the figures of the last second, with a warning of overload or an empty one."""
        core = now.core
        values = {
            "mode": now.mode,
            "policy": (core and core.policy_id) or "",
            FAULT_KIND: now.fault.kind.value if core and now.fault else "",
            **figures,
            **({} if core is None else core.counters),
            **{f"refused: {name}": count for name, count in self._refused.items()},
            "real-time scheduling": now.granted.scheduling,
            "locked memory": now.granted.memory,
            "last refusal": self._last_refusal,
            "preparation processes": self._preparation.starts,
        }
        level, text = self._summary(now, overload)
        self._refused_lately = False
        stamp_ns = self._node.get_clock().now().nanoseconds
        name, device = component(self._node, "loop"), self._params.hardware_id
        self._preparation.report(stamp_ns, name, device, level, text, values)

    def _summary(self, now: Condition, overload: str) -> tuple[str, str]:
        """Level and text of the diagnostics."""
        if now.core is not None and now.core.mode is Mode.FAULT:
            return "error", now.fault.text if now.fault else "fault"
        if not now.active or now.unfit:
            return "warn", now.unfit or "not active"
        if overload:
            return "warn", overload
        if self._params.realtime_priority and not now.granted.complete:
            return "warn", f"{now.mode}; no real-time scheduling"
        if self._refused_lately:
            return "warn", self._last_refusal
        return "ok", now.mode
