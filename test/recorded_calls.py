# SPDX-License-Identifier: Apache-2.0
"""Calls of controllers with their answers, in every mode and in faults of eight kinds.

A new controller must answer the same calls the same way, a torque bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np

from benchmark.false_states import FALSE_STATES, PERIOD, Falsifier
from benchmark.hidden_arm import KNOWN, NOMINAL, begin, held
from benchmark.loop import PHASES, Loop
from benchmark.nodes import JOINTS, taught
from benchmark.reaction_matrix import drawn
from hardware_sim.hidden_arm import HiddenArm
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.controller_settings import ControllerSettings
from wam_power_ros.control.joint_references import interpolated
from wam_power_ros.control.modes import ControllerError, Mode
from wam_power_ros.control.safety import limits_of
from wam_power_ros.faults import Fault
from wam_power_ros.learning.rollout import EndEffectorPath
from wam_power_ros.params.resources import share

URDF = share("urdf/wam7.urdf").read_text()
CALLS = ("step", "stale_torque", "refuse_state", "load", "hold", "stop", "release", "fault")
CALLS += ("set_gravity_compensation", "move_to_start", "start_replay", "execute", "reset")
CALLS += ("deactivate", "take_finished")


class Answer(NamedTuple):
    """What a controller answered to a call, and what it was in afterwards.

    Attributes:
        result: Bytes of the torque, or of the path of the tool, in hexadecimal; else text.
        mode: Mode after the call.
        label: Label of the last torque.
        fault: Latched fault, None without one.
        fresh: True if the last state was accepted as a new one.
    """

    result: str
    mode: Mode
    label: str
    fault: Fault | None
    fresh: bool


class Call(NamedTuple):
    """One call: name of the method, arguments, whether the switch was held, and the answer."""

    name: str
    arguments: tuple[Any, ...]
    enabled: bool
    answer: Answer


class Drive(NamedTuple):
    """Settings of one controller of the WAM, and all of its calls."""

    settings: ControllerSettings
    calls: list[Call]


def answered(controller: Controller, result: object) -> Answer:
    """Answer of a call with a result, which may be a refusal."""
    if isinstance(result, EndEffectorPath):
        result = np.hstack([result.t[:, None], result.position, result.quat_xyzw])
    given = result.tobytes().hex() if isinstance(result, np.ndarray) else str(result)
    return Answer(given, controller.mode, controller.label, controller.latched, controller.fresh)


class Recorded(Controller):
    """Keeps the calls that are made from outside, with their answers."""

    def __init__(self, arm: Arm, settings: ControllerSettings) -> None:
        self.calls: list[Call] = []
        self._nested = False  # within a call, which is recorded itself
        super().__init__(arm, settings)


def _recorded(name: str) -> Callable[..., object]:
    """Method of `Recorded` in place of one of the controller."""
    method = getattr(Controller, name)

    def run(self: Recorded, *arguments: Any) -> object:  # noqa: ANN401 - whatever it takes
        if self._nested:
            return method(self, *arguments)
        given = tuple(a.copy() if isinstance(a, np.ndarray) else a for a in arguments)
        self._nested, result = True, None
        try:
            result = method(self, *arguments)
        except ControllerError as error:
            result = error
            raise
        finally:
            self._nested = False
            self.calls.append(Call(name, given, self.enabled, answered(self, result)))
        return result

    return run


for _name in CALLS:
    setattr(Recorded, _name, _recorded(_name))


def whole(loop: Loop) -> None:
    """Teach, move to the start, execute the policy, replay a movement."""
    core = loop.controller
    begin(loop, "move")
    while core.mode is Mode.MOVE_TO_START:
        loop.play(PERIOD)
    rollout(loop)
    q = loop.policy.q_start + 0.2 * np.sin(np.linspace(0.0, np.pi, 61))[:, None] ** 2 * np.ones(7)
    core.start_replay(interpolated(np.linspace(0.0, 1.2, 61), q, PERIOD))
    loop.play(2.0)
    core.stop()
    core.deactivate()
    loop.play(0.05)


def rollout(loop: Loop) -> None:
    """Move to the start, execute the policy and hold again."""
    core = loop.controller
    core.move_to_start()
    while not core.ready and core.latched is None:
        loop.play(PERIOD)
    core.enabled = True
    core.execute()
    loop.play(loop.policy.basis.duration + 1.2)
    core.take_finished()


def recovered(loop: Loop, falsify: Falsifier, phase: str) -> None:
    """Falsify the states from a phase on until 0.5 s after the fault; then reset it."""
    begin(loop, phase)
    loop.falsify = falsify
    loop.play(0.5)
    loop.plant.let_go()
    loop.falsify = lambda state: state
    loop.play(0.5)
    with suppress(ControllerError):
        loop.controller.reset()
    loop.play(0.1)


def changed(loop: Loop, **offsets: np.ndarray) -> None:
    """Execute the policy with offsets (3,) on rows of its fields."""
    fields = {name: getattr(loop.policy, name) + offset for name, offset in offsets.items()}
    loop.controller.load(replace(loop.policy, **fields))
    rollout(loop)


def released(loop: Loop) -> None:
    """Release the enabling switch in a rollout."""
    loop.controller.enabled = True
    begin(loop, "upwards")
    loop.controller.enabled = False
    loop.play(0.5)


def pulled(loop: Loop) -> None:
    """Let a demonstrator pull at the arm that holds."""
    loop.plant.guide(0)
    loop.play(0.6)


def drives(every: int = 1) -> Iterator[Drive]:
    """Record every drive, or only each n-th."""
    home = taught().q_start
    near = limits_of(
        Arm(URDF, JOINTS),
        teaching_tool_speed=4.0,
        q_max=home + np.array([0.05, 2, 2, 0.02, 2, 2, 2]),
    )
    rows: list[tuple[Callable[[Loop], None], dict[str, Any], HiddenArm]] = [
        (whole, {}, NOMINAL),
        (partial(begin, phase="hold"), {}, KNOWN["payload of 0.5 kg"]),
        (whole, {}, drawn(9001)),
        (rollout, {"law": "virtual_mass"}, NOMINAL),
        (pulled, {"driver_compensates_gravity": True}, NOMINAL),
        (rollout, {"limits": near}, NOMINAL),
        (pulled, {}, NOMINAL),
        (released, {"hold_to_run": True}, NOMINAL),
        (partial(changed, attractors=np.array([0.0, 0.0, 3.0])), {}, NOMINAL),
        (partial(changed, rotation_attractors=np.full(3, 2.0)), {}, NOMINAL),
    ]
    falsified = [
        (lambda state: state._replace(qd=None), "upwards"),
        (lambda state: state._replace(q=np.full(7, np.nan)), "hold"),
        (lambda state: state._replace(q=state.q + 0.5 * np.eye(7)[1]), "teaching"),
        *zip((make() for make in FALSE_STATES.values()), cycle(PHASES)),
    ]
    rows += [
        (partial(recovered, falsify=each, phase=phase), {}, NOMINAL) for each, phase in falsified
    ]
    for drive, choices, hidden in rows[::every]:
        fast = {"limits": limits_of(Arm(URDF, JOINTS), teaching_tool_speed=4.0)}
        settings = ControllerSettings(**fast | choices)
        loop = held(hidden, partial(Recorded, settings=settings))
        with suppress(ControllerError):  # of an arm that has faulted
            drive(loop)
        yield Drive(settings, loop.controller.calls)


def repeat(drive: Drive) -> Iterator[Answer]:
    """Repeat a drive with a new controller; yields its answers."""
    controller = Controller(Arm(URDF, JOINTS), drive.settings)
    for call in drive.calls:
        controller.enabled = call.enabled
        try:
            result = getattr(controller, call.name)(*call.arguments)
        except ControllerError as error:
            result = error
        yield answered(controller, result)


def differences(drive: Drive) -> list[tuple[int, Call, Answer]]:
    """Calls of a drive that are answered differently now: number, call and present answer."""
    pairs = enumerate(zip(drive.calls, repeat(drive), strict=True))
    return [(k, call, now) for k, (call, now) in pairs if call.answer != now]
