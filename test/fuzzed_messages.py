# SPDX-License-Identifier: Apache-2.0
"""Random messages that a broken driver, a broken learner or an attacker might send.

Most joint states are those of a slowly drifting arm, so that the controller is active. Mixed into
them are wrong stamps, values, lengths and names, corrupted or truncated bytes, corrupted policies,
and calls.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from benchmark.nodes import PERIOD_NS
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import ControllerError
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.learning import policy as policies
from wam_power_ros.learning.policy import Policy
from wam_power_ros.ros import cdr, joint_messages
from wam_power_ros.ros.stamps import time_message

CALM_STATES = 150  # valid states in a row
ODD_VALUES = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 1e9, -25.0, 25.0, 0.0)
STAMP_STEPS = (0, -PERIOD_NS, -(10**9), 3, 4 * PERIOD_NS, 10 * PERIOD_NS, 3_600 * 10**9)
CALLS = (
    Controller.hold,
    Controller.stop,
    Controller.execute,
    Controller.move_to_start,
    lambda core: core.set_gravity_compensation(True),
    lambda core: core.set_gravity_compensation(False),
    lambda core: core.fault(Fault(FaultKind.SOFTWARE, "fuzz")),
)
TIMEOUT = 0.005  # [s] without a state until a torque is due, as in config/torque_controller.yaml


def states(names: list[str], home: np.ndarray, rng: np.random.Generator) -> Iterator[JointState]:
    """Yield joint states endlessly; calm periods, in which a fault can be reset, and storms."""
    n, stamp_ns = len(names), 10**12
    q, qd = home.copy(), np.zeros(n)
    calm, storm = CALM_STATES, 0  # remaining states of each
    while True:
        if not calm and not storm:
            calm, storm = CALM_STATES, int(rng.integers(1, 2 * CALM_STATES))
        qd = 0.98 * qd + 0.002 * rng.standard_normal(n)  # mostly at rest, so that a reset succeeds
        q = home + 0.999 * (q - home) + 0.002 * qd
        stamp_ns += PERIOD_NS
        values = [q.tolist(), qd.tolist(), [0.0] * n]
        named, stamp = list(names), stamp_ns
        wrong = int(rng.integers(64))
        if calm:
            calm, wrong = calm - 1, 64
        else:
            storm -= 1
        if wrong < 3:
            field = values[int(rng.integers(2))]
            field[int(rng.integers(n))] = ODD_VALUES[int(rng.integers(len(ODD_VALUES)))]
        elif wrong == 3:
            stamp += STAMP_STEPS[int(rng.integers(len(STAMP_STEPS)))]
            stamp_ns = max(stamp, stamp_ns) if rng.random() < 0.1 else stamp_ns
        elif wrong == 4:
            field = values[int(rng.integers(2))]
            del field[int(rng.integers(n)) :]
        elif wrong == 5:
            order = rng.permutation(n)
            named = [names[i] for i in order] + ["finger"]
            values = [[field[i] for i in order] + [9.0] for field in values]
        elif wrong == 6:
            named[int(rng.integers(n))] = names[int(rng.integers(n))]
        elif wrong == 7:
            values = (10.0 * rng.standard_normal((3, n))).tolist()
        message = JointState(name=named)
        message.position, message.velocity, message.effort = values
        message.header.stamp = time_message(max(stamp, 0))
        yield message


def garbled(data: bytes, rng: np.random.Generator) -> bytes:
    """Corrupt or truncate the bytes of one message in 256."""
    if rng.random() > 1.0 / 256.0:
        return data
    spoilt, at = bytearray(data), int(rng.integers(len(data)))
    if rng.random() < 0.2:
        return data[:at]
    spoilt[at] = int(rng.integers(256))
    return bytes(spoilt)


def spoilt(policy: Policy, rng: np.random.Generator) -> str:
    """Text of a policy, corrupted in four of five cases."""
    text = policies.to_json(policy)
    kind, at = int(rng.integers(5)), int(rng.integers(len(text)))
    if kind == 0:
        return text
    if kind == 1:
        return text[:at]
    if kind == 2:
        return text[:at] + chr(int(rng.integers(32, 127))) + text[at + 1 :]
    numbers = [i for i, mark in enumerate(text) if mark in "0123456789"]
    at = numbers[int(rng.integers(len(numbers)))]
    return text[:at] + ("NaN", "1e999", "-9", "[]", "9e9")[int(rng.integers(5))] + text[at + 1 :]


class Wire:
    """What a driver sees: every torque with the time at which it was sent, by a clock of its own.

    Attributes:
        now, arrived: Time, and that of the last new state [s].
        found: "torques": number of torques; of these "not finite", "over" a limit, and "rate",
            which differ from the last by more than the rate limit allows in the time between them;
            "largest": largest torque as a share of its limit.
    """

    def __init__(self, controller: Controller) -> None:
        self._limits = controller.limits
        self.now = self.arrived = self._sent = 0.0
        self._last: np.ndarray | None = None  # torque that the driver has
        self.found = {"torques": 0, "not finite": 0, "over": 0, "rate": 0, "largest": 0.0}

    @property
    def since_sent(self) -> float:
        """Time since the last torque [s]."""
        return self.now - self._sent

    @property
    def unanswered(self) -> float:
        """Time since the last torque or the last new state [s]."""
        return self.now - max(self._sent, self.arrived)

    def send(self, tau: np.ndarray, limited: bool) -> None:
        """Send a torque [N m]; `limited` if the rate limit holds for it."""
        found, limits = self.found, self._limits
        found["torques"] += 1
        found["not finite"] += not np.isfinite(tau).all()
        share = float(np.max(np.abs(tau) / limits.torque))
        found["largest"] = max(found["largest"], share)
        found["over"] += not share <= 1.0
        if self._last is not None and limited:
            step = limits.torque_rate * (self.now - self._sent)
            found["rate"] += not (np.abs(tau - self._last) <= step + 1e-9).all()
        self._last, self._sent = tau, self.now


def bombard(controller: Controller, policy: Policy, messages: int, seed: int) -> dict[str, float]:
    """Pass messages through reader, controller and writer, as the node does, in one process.

    The states come after 2 ms, in bursts, and after silences of up to 0.15 s.

    Returns:
        See `Wire.found`; "refused": number of refusals.
    """
    rng, arm = np.random.default_rng(seed), controller.arm
    names = list(arm.joint_names)
    read = cdr.StateReader(joint_messages.JointStateReader(names))
    write = cdr.TorqueSerializer(joint_messages.TorqueWriter(names, "multiarray"))
    wire, refused = Wire(controller), 0
    controller.load(policy)
    source = states(names, policy.q_start, rng)
    for _ in range(messages):
        chance = rng.random()
        if chance < 0.01:
            try:
                CALLS[int(rng.integers(len(CALLS)))](controller)
            except ControllerError:
                refused += 1
        elif chance < 0.06:  # as a person resets faults
            try:
                controller.reset()
            except ControllerError:
                refused += 1
        elif chance < 0.062:
            try:
                controller.load(policies.from_json(spoilt(policy, rng)))
            except (ValueError, ControllerError):
                refused += 1
        for _ in range(_silence(wire, rng)):
            active = controller.mode.value != "inactive"
            wire.send(controller.stale_torque(wire.unanswered), active)
            wire.now += 0.002 if rng.random() < 0.9 else rng.uniform(1e-5, 0.002)
        try:
            reading = read(garbled(serialize_message(next(source)), rng))
        except ValueError:
            refused += 1
            continue
        if reading is None:  # no known joint name is left
            continue
        active = controller.mode.value != "inactive"
        tau = controller.step(*reading, wire.now - wire.arrived, wire.since_sent)
        if controller.fresh:
            wire.arrived = wire.now
        sent = write(reading[0], controller.label, tau)
        wire.send(np.array(deserialize_message(sent, Float64MultiArray).data), active)
    return wire.found | {"refused": refused}


def _silence(wire: Wire, rng: np.random.Generator) -> int:
    """Let time go on until the next state; returns the number of torques due without one."""
    chance = rng.random()
    if chance < 0.01:
        wire.now = max(wire.now, wire.arrived + TIMEOUT) + rng.uniform(0.0, 0.001)
        return int(rng.integers(1, 75))
    wire.now += rng.uniform(1e-5, 3e-4) if chance < 0.1 else 0.002 * rng.uniform(0.7, 1.3)
    return 0
