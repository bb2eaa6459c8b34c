# SPDX-License-Identifier: Apache-2.0
"""Services of Barrett's own driver: gravity compensation, hold, idle, and a move home."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from hardware_sim.deferred_service import DeferredTrigger
from hardware_sim.settings import ArmSimParams, WorldSettings
from hardware_sim.wam import FOLDED, HOME_SPEED, POSITION_KD, POSITION_KP, POSITION_TAU_MAX
from hardware_sim.world import World
from wam_power_ros.control.arm import Arm
from wam_power_ros.ros import interface
from wam_power_ros.ros.outcomes import Answer, Code, fill

STIFFNESS, DAMPING = 400.0, 40.0  # [1/s^2], [1/s] of position control of another arm than the WAM


class PositionControl:
    """Position control with gravity compensation; overrides torque commands while engaged.

    The WAM has the gains of its driver, another arm the same dynamics in every joint.
    """

    def __init__(self, arm: Arm, settings: WorldSettings) -> None:
        self._arm, self._settings = arm, settings
        self._kp, self._kd, self._tau_max = POSITION_KP, POSITION_KD, POSITION_TAU_MAX
        if settings.drives != "wam":
            inertia = np.diag(arm.mass_matrix(0.5 * (arm.q_min + arm.q_max)))  # (n,) [kg m^2]
            self._kp, self._kd = STIFFNESS * inertia, DAMPING * inertia
            self._tau_max = arm.tau_max
        self._goal: np.ndarray | None = None
        self._ref = np.zeros(arm.n)

    @property
    def engaged(self) -> bool:
        """Whether position control overrides commands."""
        return self._goal is not None

    @property
    def arrived(self) -> bool:
        """Whether the reference has reached its goal."""
        return self._goal is not None and bool(np.array_equal(self._goal, self._ref))

    @property
    def reference(self) -> np.ndarray:
        """Present reference [rad]. Shape (n,)."""
        return self._ref

    def move(self, q: np.ndarray, goal: np.ndarray) -> None:
        """Move every joint from q (n,) to goal (n,) [rad] at `HOME_SPEED`, then hold there."""
        self._ref, self._goal = q.copy(), goal.copy()

    def disengage(self) -> None:
        """Let torque commands take effect again."""
        self._goal = None

    def torque(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Torque command (n,) [N m] in state q (n,) [rad], qd (n,) [rad/s], while engaged."""
        step = HOME_SPEED * self._settings.period
        self._ref = self._ref + np.clip(self._goal - self._ref, -step, step)
        tau = self._kp * (self._ref - q) - self._kd * qd
        tau = np.clip(tau, -self._tau_max, self._tau_max)
        return tau if self._settings.driver_compensates_gravity else tau + self._arm.gravity(q)


class BarrettServices:
    """Barrett's services on a simulated world.

    Attributes:
        control: Position control of the arm.
        deactivated: True if only zero torques reach the arm, until gravity compensation is
            requested, as with a ros2_control controller after a command of the wrong size.
    """

    def __init__(self, node: Node, world: World, params: ArmSimParams) -> None:
        self.control = PositionControl(world.arm, params)
        self.deactivated = False
        self._world, self._params = world, params
        serve = node.create_service
        serve(SetBool, interface.WAM_GRAVITY_COMPENSATE, self._on_gravity_compensate)
        serve(SetBool, interface.WAM_HOLD, self._on_hold)
        serve(Trigger, interface.WAM_IDLE, self._on_idle)
        self._home = DeferredTrigger(node, interface.WAM_MOVE_HOME, self._begin_home)

    def update(self) -> None:
        """Answer a pending move home once it has ended; called every tick."""
        if not self._home.pending:
            return
        if self.control.arrived:
            self._home.finish(True, "at home")
        elif not self.control.engaged:
            self._home.finish(False, "interrupted")

    def torque(self, tau: np.ndarray | None) -> np.ndarray | None:
        """Command (n,) that takes effect where `tau` is commanded; None for no command."""
        if self.control.engaged:
            sample = self._world.joint_state()
            torque = self.control.torque(sample.q, sample.qd)
            return torque if self._params.output == "torque" else self.control.reference
        if self.deactivated:
            return np.zeros(self._world.n) if self._params.output == "torque" else None
        return tau

    def _on_gravity_compensate(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        """On: torque commands reach the arm. Off: the arm is idle."""
        self.control.disengage()
        self.deactivated = False
        self._world.idle = not request.data
        return fill(response, Answer(Code.DONE))

    def _on_hold(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        q = self._world.joint_state().q
        self._world.idle = False
        self.control.move(q, q) if request.data else self.control.disengage()
        return fill(response, Answer(Code.DONE))

    def _on_idle(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.control.disengage()
        self._world.idle = True
        return fill(response, Answer(Code.DONE))

    def _begin_home(self) -> str | None:
        if self._world.frozen:
            if not self._params.lockstep:
                return "the scene is being reset"
            self._world.release()  # between rollouts
        self._world.idle = False
        home = FOLDED if self._params.drives == "wam" else self._world.home
        self.control.move(self._world.joint_state().q, home)
        return None
