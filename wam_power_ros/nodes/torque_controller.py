# SPDX-License-Identifier: Apache-2.0
"""Torque controller: joint states in, one torque each out; requests in, finished rollouts out.

A managed (lifecycle) node that wraps `control.controller.Controller`. Each state triggers a control
step; a watchdog on the steady clock acts when no states come. All slow work is done in a process
beside it (see `preparation`), which takes requests, prepares their policies and movements, answers,
publishes paths and diagnostics, and logs.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.client.link import unanswered
from wam_power_ros.control.controller import Controller
from wam_power_ros.control.modes import MOVING_MODES, ControllerError, Mode, Refusal
from wam_power_ros.control.watchdog import StampClock, Watchdog, overload
from wam_power_ros.faults import Fault, FaultKind
from wam_power_ros.nodes.controller_report import Condition, ControllerReport
from wam_power_ros.nodes.motion_requests import MotionRequests, attempt
from wam_power_ros.nodes.preparation import Preparation
from wam_power_ros.params.resources import robot_description
from wam_power_ros.params.torque_controller_params import TorqueControllerParams
from wam_power_ros.ros import (
    cdr,
    endpoints,
    interface,
    joint_messages,
    network,
    node_runner,
    scheduling,
)
from wam_power_ros.ros.guards import CommandGuard, Info, SimulationGuard, StateGuard, with_info
from wam_power_ros.ros.loop_statistics import LoopStatistics
from wam_power_ros.ros.outcomes import Answer, Code, fill

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
STATE_AGE_MAX_NS = 1_000_000_000  # [ns] of the last joint state at activation
VELOCITY_AGE_MAX_NS = 10_000_000  # [ns] of a velocity from a separate topic
STOP_TIMEOUT = 0.5  # [s] to bring the arm to rest when this node ends
REST_TIME = 0.05  # [s] at rest that suffices: slower than REST_SPEED the arm still coasts
RELEASE_TIME = 0.05  # [s] after that, to change to the torque that holds the arm
RECEIPT_TIMEOUT = 2.0  # longest wait until a busy driver has the last torque [s]
ENABLE_TIMEOUT_NS = 100_000_000  # [ns] after which the enabling switch counts as released


class TorqueController(LifecycleNode):
    """Answers each joint state with one torque."""

    def __init__(self) -> None:
        super().__init__("torque_controller", automatically_declare_parameters_from_overrides=True)
        self._params = params = TorqueControllerParams.from_node(self)
        if (exposed := network.exposed(os.environ)) is not None:
            self.get_logger().warning(exposed)
        self._frame = interface.frame(self.get_namespace(), params.base_frame)
        self._autostart = params.autostart
        self._urdf = robot_description(params.urdf) if params.urdf else ""
        self._controller: Controller | None = None
        self._active = self._finalized = False
        self._qd: np.ndarray | None = None  # from the velocity topic [rad/s]
        self._qd_ns = 0  # when it came, steady clock
        self._refused_ns, self._refusal = -STATE_AGE_MAX_NS, ""  # the last refused joint state
        self._latched: Fault | None = None  # of a controller that was cleaned up
        self._stamp_clock = StampClock()
        self._stamp_ns = 0  # of the last state
        self._sent_ns = 0  # when the last torque was passed to the middleware, steady clock
        self._sent: np.ndarray | None = None  # the last set point, if fewer are sent than states
        self._enabled_ns = -ENABLE_TIMEOUT_NS  # when the switch was last held, steady clock
        sim_time = self.get_parameter("use_sim_time").value  # lockstep: states may pause
        self._watchdog = Watchdog(0.0 if sim_time else params.state_timeout, params.period)
        self._statistics = LoopStatistics(round(params.period * 1e9))
        self._figures: tuple[dict[str, str], str] = {}, ""  # of the last second, and a warning
        self._granted = scheduling.Granted()

        self._reader = joint_messages.JointStateReader(params.joint_names)
        self._read = cdr.StateReader(self._reader)
        names, frame = params.joint_names, (params.base_frame, params.simulation)
        writer = joint_messages.TorqueWriter(names, params.message, params.sent_period, *frame)
        self._write = cdr.TorqueSerializer(writer)
        self._command_qos = qos = interface.DEEP if sim_time else interface.COMMAND
        self._commands = self.create_publisher(writer.message_type, params.command_topic, qos)
        self._preparation = Preparation(
            self.context.get_domain_id(),
            lambda *request: self._requests.begin(*request),
            self._on_cancel,
            lambda reason: self._report.refuse("request", reason),
            lambda id, reason: self._requests.refuse(id, reason),
        )
        self._report = ControllerReport(self, params, self._preparation)
        self._guard = CommandGuard(self, self._commands)
        self._state_guard = StateGuard(self, params.state_topic)
        self._velocity_guard = StateGuard(self, params.velocity_topic or params.state_topic)
        simulated = params.simulation, not self._watchdog.enabled
        self._simulation_guard = SimulationGuard(self, params.state_topic, *simulated)
        idle = params.idle_service or interface.WAM_IDLE
        self._idle = unanswered(self, idle, interface.IDLE_QOS)
        subscribe, state_in = self.create_subscription, interface.STATE_IN
        on_state, on_velocity = with_info(self._on_state), with_info(self._on_velocity)
        self._states = subscribe(JointState, params.state_topic, on_state, state_in, raw=True)
        if params.hold_to_run:
            subscribe(Bool, interface.ENABLE, self._on_enable, interface.NEWEST)
        if params.velocity_topic:
            subscribe(JointState, params.velocity_topic, on_velocity, state_in)
        self._descriptions: Subscription | None = None
        self._await_description()
        serve = self.create_service
        serve(Trigger, interface.STOP, self._on_stop)
        serve(Trigger, interface.RESET, self._answering(self._reset))
        serve(SetBool, interface.GRAVITY_COMPENSATION, self._on_gravity_compensation)
        active, replies = self._active_controller, self._preparation
        self._requests = MotionRequests(params.joint_names, active, replies)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.1, self._supervise, clock=steady)
        self.create_timer(1.0, self._publish_report, clock=steady)
        params.follow(self, self._accept)

    def _accept(self, params: TorqueControllerParams) -> None:
        """Move at another speed if the arm rests; limit torques more if the node is not active."""
        lowered, core = params.torque_share - self._params.torque_share, self._controller
        if lowered > 0.0:
            raise ValueError("torque_share is only lowered while the node runs: restart it")
        if self._active and (lowered or core.mode is not Mode.HOLD or not core.at_rest):
            raise ValueError(
                "move_speed is set while the arm holds still, torque_share while the controller is "
                f"not active; it is active, in mode {core.mode.value}"
            )
        if core is not None and lowered:  # its arm and its tables are made anew
            core = self._controller = params.controller(self._urdf, core.latched)
            self._preparation.configure(core.settings, params.joint_names)
        self._params = params
        if core is not None:
            speed = {"move_speed": params.move_speed}
            core.settings = core.settings.model_copy(update=speed)

    # Life cycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build the controller, which takes long."""
        try:
            if not self._urdf:
                topic = self.resolve_topic_name(interface.ROBOT_DESCRIPTION)
                raise ValueError(f"no robot description on {topic} yet{self._no_description()}")
            self._controller = self._params.controller(self._urdf, self._latched)
        except ValueError as error:
            self._report.refuse("configuration", error)
            return FAILURE
        if self._descriptions is not None:  # a large message would block the loop
            self.destroy_subscription(self._descriptions)
            self._descriptions = None
        self._preparation.configure(self._controller.settings, self._params.joint_names)
        self._granted = scheduling.request(self._params.realtime_priority)
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Hold the arm where it is; requires recent states of one publisher, no other commander.

        In simulation it also requires that no node but a stand-in publishes states.
        """
        simulation = self._simulation_guard
        reason = self._missing_state() or simulation.other_publisher() or simulation.other_clock()
        reason = reason or self._missing_realtime() or self._unheard() or self._guard.begin()
        if not reason and self._controller.mode is not Mode.FAULT:
            try:
                self._controller.hold()
            except ControllerError as error:
                reason = str(error)
        if reason:
            self._guard.listen()
            self._report.refuse("activation", reason)
            return FAILURE
        self._active = True
        self._requests.expire()
        self._watchdog.activated()
        self._report.log_changes(self._condition())
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the arm, send the torque that holds it a last time, then nothing."""
        if self._active:
            self._requests.stop(self._controller)
        self.close()
        self._guard.listen()
        self._report.log_changes(self._condition())
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Delete the controller and its policy; a fault stays latched."""
        self._latched = None if self._controller is None else self._controller.latched
        self._controller = None
        self._preparation.configure(None, ())
        self._await_description()
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the arm and send a last torque, as for deactivation."""
        self.close()
        self._finalized = True
        return SUCCESS

    def close(self) -> None:
        """Bring the arm to rest, then end with a torque that a driver may keep.

        That is g(q), or zero for a driver that adds g(q). Needs no executor: it is called from a
        callback, or after the executor has ended.
        """
        self._autostart = False
        if not self._active:
            return
        core = self._controller
        core.stop()
        begun = moved = time.monotonic()
        while moved - begun < STOP_TIMEOUT and time.monotonic() - moved < REST_TIME:
            self._answer_next()
            if not core.at_rest:
                moved = time.monotonic()
        core.release()
        begun = time.monotonic()
        while time.monotonic() - begun < RELEASE_TIME:
            self._answer_next()
        self._send(self._stale_torque(), "inactive")
        self._stop_publishing()
        # What a busy reader does not have when this process ends may be lost.
        self._commands.wait_for_all_acked(Duration(seconds=RECEIPT_TIMEOUT))

    def _stop_publishing(self) -> None:
        """Send no torque any more, and refuse the pending requests."""
        self._active = False
        self._controller.deactivate()
        self._answer_requests(self._stamp_ns)
        self._requests.deactivated()

    def _answer_next(self) -> None:
        """Answer the next state if it has come, without an executor."""
        try:
            with self._states.handle:
                taken = self._states.handle.take_message(JointState, True)
            if taken is not None:
                return self._on_state(*taken)
            self.watch()
        except Exception as error:
            self.failed(error)
        return time.sleep(0.1 * self._params.period)

    def destroy_node(self) -> None:
        """End the preparation process, too."""
        if hasattr(self, "_preparation"):  # rclpy also destroys a node that refused its parameters
            self._preparation.close()
        super().destroy_node()

    def _second_publisher(self) -> str | None:
        return self._state_guard.second_publisher() or self._velocity_guard.second_publisher()

    def _missing_state(self) -> str | None:
        now_ns, params = time.monotonic_ns(), self._params
        if (second := self._second_publisher()) is not None:
            return second
        if now_ns - self._watchdog.arrived_ns >= STATE_AGE_MAX_NS:
            if now_ns - self._refused_ns < STATE_AGE_MAX_NS:
                return f"joint states arrive, but are refused: {self._refusal}"
            unmatched = self._unmatched(params.state_topic, JointState, interface.STATE_IN)
            known = self.count_publishers(params.state_topic)  # its clock would be known as well
            clock = self._simulation_guard.other_clock() if known else ""
            return f"no joint state within the last second{unmatched}{clock and f'; {clock}'}"
        if params.velocity_topic and now_ns - self._qd_ns >= STATE_AGE_MAX_NS:
            unmatched = self._unmatched(params.velocity_topic, JointState, interface.STATE_IN)
            return f"no joint velocity on {params.velocity_topic} within the last second{unmatched}"
        return None

    def _no_description(self) -> str:
        return self._unmatched(interface.ROBOT_DESCRIPTION, String, interface.LATCHED)

    def _unmatched(self, topic: str, kind: type, qos: QoSProfile) -> str:
        """Publishers from which nothing is received, as the end of a sentence; empty if none."""
        found = endpoints.unmatched_publishers(self, topic, (endpoints.type_name(kind),), qos)
        return "".join(f"; {text}" for text in found)

    def _unheard(self) -> str | None:
        """Drivers that do not receive the torques, if no other node does either."""
        kind, topic = endpoints.type_name(self._commands.msg_type), self._commands.topic_name
        unmatched, matched = endpoints.unmatched_subscriptions(self, topic, kind, self._command_qos)
        return None if matched or not unmatched else "; ".join(unmatched)

    def _missing_realtime(self) -> str | None:
        granted = self._granted
        if self._params.allow_no_realtime or granted.complete:
            return None
        return (
            f"no real-time scheduling (SCHED_FIFO {granted.scheduling}; locked memory "
            f"{granted.memory}): grant both, or set allow_no_realtime"
        )

    # Joint states

    def _on_state(self, message: bytes, info: Info) -> None:
        try:
            self._answer(message, info)
        except Exception as error:
            self.failed(error)

    def _answer(self, message: bytes, info: Info) -> None:
        arrived_ns = time.monotonic_ns()
        controller = self._controller
        try:
            reading = self._read(message)
        except ValueError as error:
            if controller is not None:
                controller.refuse_state()
            return self._refuse_state(arrived_ns, str(error))
        if reading is None or not self._followed(self._state_guard, info) or controller is None:
            return None
        stamp_ns, q, qd = reading
        if self._params.hold_to_run:
            controller.enabled = arrived_ns - self._enabled_ns < ENABLE_TIMEOUT_NS
        if qd is None and self._params.velocity_topic:
            qd = self._qd
            if self._watchdog.enabled and arrived_ns - self._qd_ns > VELOCITY_AGE_MAX_NS:
                qd = None  # the controller differentiates the positions instead
                age = (arrived_ns - self._qd_ns) * 1e-6
                text = f"no joint velocity on {self._params.velocity_topic} for {age:.0f} ms"
                controller.fault(Fault(FaultKind.VELOCITY, text))
        elapsed = since_sent = None  # lockstep: the stamps are the clock
        if self._watchdog.enabled:
            elapsed = (arrived_ns - self._watchdog.arrived_ns) * 1e-9
            since_sent = (arrived_ns - self._sent_ns) * 1e-9
        tau = controller.step(stamp_ns, q, qd, elapsed, since_sent)
        if controller.fresh:
            self._watchdog.arrived(arrived_ns)
            self._stamp_ns = stamp_ns
            if self._watchdog.enabled and (fault := self._stamp_clock.check(stamp_ns, arrived_ns)):
                controller.fault(fault)
        elif controller.stamp_ns != stamp_ns:
            return self._refuse_state(arrived_ns, controller.refusal)
        elif self._watchdog.silent(arrived_ns):
            return None  # repeated for long; `watch` sends until a new one comes
        elif not self._watchdog.enabled:
            self._watchdog.arrived(arrived_ns)  # lockstep: repeated until a torque answers it
        if not self._active:
            return None
        if self._guard.foreign:
            text = "another publisher, which was silent at activation, sends commands"
            controller.fault(Fault(FaultKind.SECOND_COMMANDER, text))
        self._send(tau, controller.label)
        self._statistics.add(arrived_ns, self._watchdog.sent_ns)
        return self._answer_requests(stamp_ns)

    def _refuse_state(self, now_ns: int, reason: str) -> None:
        """Until a valid one comes `watch` sends."""
        self._refused_ns, self._refusal = now_ns, reason
        self._report.refuse("joint state", reason)

    def _followed(self, guard: StateGuard, info: Info) -> bool:
        """Whether a message is from the publisher that is followed; if not, that is a fault."""
        if guard.follows(info, self._active):
            return True
        if self._active and self._controller.mode is not Mode.FAULT:
            text = guard.second_publisher()
            self._controller.fault(Fault(FaultKind.SECOND_PUBLISHER, text))
        return False

    def _answer_requests(self, stamp_ns: int) -> None:
        """Publish the path of a rollout that has ended, and answer what was requested."""
        core = self._controller
        if (path := core.take_finished()) is not None:
            start_ns = core.rollout_stamp_ns or stamp_ns
            self._preparation.publish_path(path, start_ns, self._frame)
            self._requests.rollout_ended(core, path, start_ns)
        self._requests.answer(core)

    def _on_enable(self, message: Bool) -> None:
        self._enabled_ns = time.monotonic_ns() if message.data else -ENABLE_TIMEOUT_NS

    def failed(self, error: Exception) -> None:
        """Latch a fault after an exception in a callback; brake and carry the arm. Never raises."""
        try:
            if self._active:
                self._controller.fault(Fault(FaultKind.SOFTWARE, f"a callback failed: {error!r}"))
                self._send(self._stale_torque(), Mode.FAULT.value)
        except Exception as another:  # such as one of the middleware; the next state is answered
            self._report_failure(another)
        self._report_failure(error)

    def _report_failure(self, error: Exception) -> None:
        with contextlib.suppress(Exception):  # without a log the arm is braked all the same
            self._report.failed(error)

    def _on_velocity(self, message: JointState, info: Info) -> None:
        try:
            qd = self._reader.velocity(message)
        except ValueError as error:
            return self._report.refuse("joint velocity", error)
        if qd is not None and self._followed(self._velocity_guard, info):
            self._qd, self._qd_ns = qd, time.monotonic_ns()
        return None

    def patience(self) -> float:
        """Longest time until the next call of `watch` if no state comes [s]."""
        if not self._active or not self._watchdog.enabled:
            return 0.01 if self._active else 0.1
        return self._watchdog.time_to_check(time.monotonic_ns())

    def watch(self) -> None:
        """Between callbacks: brake and carry the arm if no states come (not in lockstep)."""
        if not self._active or not self._watchdog.enabled:
            return
        now_ns = time.monotonic_ns()
        silence = self._watchdog.check(now_ns)
        if silence is None:
            return
        core = self._controller
        if silence.fault is not None:
            core.fault(silence.fault)
        if silence.idle and self._params.idle_service:
            self._idle()
        label = core.mode.value if core.mode is Mode.FAULT else core.label
        self._send(self._stale_torque(), label)

    def _stale_torque(self) -> np.ndarray:
        """Torque to send now without a state."""
        since_ns = max(self._watchdog.arrived_ns, self._sent_ns)
        elapsed = (time.monotonic_ns() - since_ns) * 1e-9 if self._watchdog.enabled else None
        return self._controller.stale_torque(elapsed)

    def _send(self, tau: np.ndarray, label: str) -> None:
        self._sent_ns = time.monotonic_ns()
        # Positions that are not due are repeated in lockstep alone, which needs an answer.
        if tau is not self._sent or not self._watchdog.enabled:
            self._guard.publish(self._write(self._stamp_ns, label, tau))
        self._sent = tau if self._params.set_point_period else None
        self._watchdog.sent_ns = time.monotonic_ns()
        if (error := self._controller.take_error()) is not None:
            self._report_failure(error)

    # Requests

    def attend(self) -> None:
        """Between callbacks: handle a message of the preparation process, then `watch`."""
        self._preparation.poll()
        self.watch()

    def _await_description(self) -> None:
        if not self._params.urdf:
            described = interface.ROBOT_DESCRIPTION, self._on_description, interface.LATCHED
            self._descriptions = self.create_subscription(String, *described)

    def _on_description(self, message: String) -> None:
        self._urdf = message.data

    def _active_controller(self) -> Controller | None:
        return self._controller if self._active else None

    def _on_cancel(self, id: str) -> None:
        """Stop the arm for the sender of the request under way."""
        if self._requests.is_under_way(id):
            self._stop()

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        answer = self._stop()
        fault = self._controller.latched if answer.success and self._controller else None
        if fault is not None:  # nothing moves, but nothing holds the posture either
            answer = dataclasses.replace(answer, text=f"nothing to stop: fault ({fault.text})")
        return fill(response, answer)

    def _reset(self, core: Controller, _: Trigger.Request) -> None:
        if (second := self._second_publisher()) is not None:
            raise ControllerError(Refusal.REFUSED, f"reset refused: {second}")
        core.reset()

    def _stop(self) -> Answer:
        """Stop the arm for a person, and report it at once to whoever waits for something else."""
        self._requests.stop(self._controller)
        answer = attempt(self._active_controller(), Controller.stop)
        self._report.publish(self._condition(), *self._figures)
        return answer

    def _on_gravity_compensation(
        self, asked: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        """Begin or end gravity compensation; asking for it in a movement stops the arm."""
        core = self._active_controller()
        if asked.data and core is not None and core.mode is not Mode.GRAVITY_COMPENSATION:
            moved = core.mode in MOVING_MODES
            self._stop()
            if moved:
                text = "refused: the arm moved and is stopped now; ask again when it rests"
                return fill(response, Answer(Code.BUSY, text))
        switch = self._answering(lambda core, asked: core.set_gravity_compensation(asked.data))
        return switch(asked, response)

    def _answering(
        self, request: Callable[[Controller, Any], None]
    ) -> Callable[[Any, Trigger.Response], Trigger.Response]:
        """Service callback that makes a request to the controller."""

        def answer(asked: Any, response: Trigger.Response) -> Trigger.Response:  # noqa: ANN401
            self._requests.expire()
            core = self._active_controller()
            return fill(response, attempt(core, lambda core: request(core, asked)))

        return answer

    # Timers

    def _supervise(self) -> None:
        if self._autostart and self._controller is None and self._urdf:
            self._autostart = self.trigger_configure() is SUCCESS
        if self._autostart and self._controller is not None and self._missing_state() is None:
            self._autostart = self.trigger_activate() is not SUCCESS
        if self._active and (robot := self._simulation_guard.unexpected_publisher()) is not None:
            self._stop_publishing()  # at once: a last torque would reach a robot
            self._report.refuse("joint states", robot)
            self.trigger_deactivate()
        if self._active and (commander := self._guard.unexpected_publisher()):
            self._controller.fault(Fault(FaultKind.SECOND_COMMANDER, commander))
        if self._active:
            self._answer_requests(self._stamp_ns)
        self._report.log_changes(self._condition())
        if self._controller is None or self._controller.mode not in MOVING_MODES:
            self._preparation.restart_if_ended()

    def _publish_report(self) -> None:
        statistics, warning = self._statistics, ""
        figures = statistics.report()
        if self._watchdog.enabled:
            warning, fault = overload(statistics.share_missed, statistics.missed_in_row)
            if fault is not None and self._active and not self._params.allow_no_realtime:
                self._controller.fault(fault)
        if self._active and not self._commands.get_subscription_count():  # looked up only then
            warning = self._unheard() or warning
        self._figures = figures, warning
        self._report.publish(self._condition(), *self._figures)

    def _condition(self) -> Condition:
        core = self._controller
        return Condition(
            core=core,
            fault=self._latched if core is None else core.latched,
            description_missing=None if self._urdf else self._no_description(),
            autostart=self._autostart,
            active=self._active,
            missing_state=self._missing_state(),
            granted=self._granted,
            last_stop=self._requests.last_stop,
            finalized=self._finalized,
        )


def main() -> int:
    """Entry point of `ros2 run wam_power_ros torque_controller`."""
    return node_runner.run(
        TorqueController,
        spin=lambda node, ended: node_runner.spin(
            node, ended, node.attend, node.patience, node.failed
        ),
    )
