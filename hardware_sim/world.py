# SPDX-License-Identifier: Apache-2.0
"""The stand-in's world: a WAM with a pan, a pancake, sensors and motors. Steps; no ROS, no sleep.

After `reset(rollout_id, ...)` all that follows is a function of the seed, the id and the torques,
so a rollout comes out the same on any machine, however long it took to get there.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import mujoco
import numpy as np

from hardware_sim import scene
from hardware_sim.motors import Motors
from hardware_sim.scene import SceneSettings
from hardware_sim.sensing import Encoders, Mocap, MocapFrame, MocapSettings
from wam_power_ros.markers import LAYOUT
from wam_power_ros.resources import share

HOME = np.deg2rad([0.0, 20.0, 0.0, 122.0, 0.0, -27.0, 0.0])  # [rad] the pan 25 degrees front down
PERIOD = 0.002  # [s]
PERIOD_NS = 2_000_000
QUIET = "-quiet"  # a rollout whose id ends so is run without any noise
DELTA_H = 0.12  # [m] over the pan's floor, where a falling pancake is judged
_WATCHDOG_TICKS = 5  # 10 ms without a command
_SETTLE_STEPS = 900  # physics steps in which the pancake comes to rest in the pan
_TRACE_TICKS = 5  # 100 Hz
_FOREARM_POINT = np.array([-0.045, -0.35, 0.0])  # in wam_link4: where the safety board looks


@dataclass(frozen=True)
class WorldSettings:
    """Choices of the stand-in; the defaults are the arm as it is.

    Attributes:
        bus_voltage: of the motors [V].
        command_delay_ticks: control periods from a state to the torque that answers it.
        pancake_offset_sd: of where the pancake lies in the pan, an axis [m].
        wind_sd: of a steady draught a rollout, an axis [m/s].
        torque_scale_sd: of each joint's torque constant a rollout, as a share.
        friction_sd: of each joint's Coulomb friction a rollout, as a share.
        driver_compensates_gravity: the arm adds g(q) to what is commanded.
        watchdog_damping: of the arm's own fallback [1/s].
    """

    bus_voltage: float = 48.0
    command_delay_ticks: int = 1
    pancake_offset_sd: float = 0.003
    wind_sd: float = 0.1
    torque_scale_sd: float = 0.01
    friction_sd: float = 0.1
    driver_compensates_gravity: bool = False
    watchdog_damping: float = 5.0
    scene: SceneSettings = field(default_factory=SceneSettings)
    mocap: MocapSettings = field(default_factory=MocapSettings)

    def __post_init__(self) -> None:
        if not 0 <= self.command_delay_ticks <= 50:
            raise ValueError(f"command_delay_ticks {self.command_delay_ticks} must be 0 to 50")
        for name in ("pancake_offset_sd", "wind_sd", "torque_scale_sd", "friction_sd"):
            if not 0.0 <= getattr(self, name) < 10.0:
                raise ValueError(f"{name} {getattr(self, name)} must not be negative")


class JointSample(NamedTuple):
    """What the arm's driver reports, once a tick."""

    stamp_ns: int
    q: np.ndarray  # (7,) [rad]
    qd: np.ndarray  # (7,) [rad/s]
    tau: np.ndarray  # (7,) commanded [N m]


@dataclass(frozen=True)
class Truth:
    """What really happened in a rollout, seen by nobody but the simulator.

    Attributes:
        id: of the rollout.
        caught: the pancake lies flat on the pan's floor (centre under 12 mm, |cos| over .98).
        flipped: it lies on its other side.
        tossed: it rose over `DELTA_H` and fell through it again.
        angle: turned from rest until then, about the axis across the throw [rad].
        true_flip: caught, flipped, and turned by 150 to 240 degrees in the air.
        apex: highest point over the pan's height at the start [m].
        landing_error: pancake less pan when it fell through `DELTA_H`, along x and y [m]. (2,)
        peak_qd: [rad/s]. (7,)
        peak_tau: [N m]. (7,)
        peak_elbow_speed, peak_forearm_speed, peak_pan_speed: [m/s]; the forearm's at 350 mm.
        beyond_no_load: a joint was faster than its motor can turn unloaded.
        saturated: share of ticks in which a motor could not give what was commanded.
    """

    id: str
    caught: bool
    flipped: bool
    tossed: bool
    angle: float
    true_flip: bool
    apex: float
    landing_error: list[float]
    peak_qd: list[float]
    peak_tau: list[float]
    peak_elbow_speed: float
    peak_forearm_speed: float
    peak_pan_speed: float
    beyond_no_load: bool
    saturated: float


class Puller(Protocol):
    """Something that pulls at the pan, such as `hand.Hand`."""

    def wrench(
        self, t: float, position: np.ndarray, rotation: np.ndarray, twist: np.ndarray
    ) -> np.ndarray | None:
        """Force and moment (6,) at the pan's centre at time t [s]; None when it has let go."""
        ...


class World:
    """One arm, one pan, one pancake."""

    def __init__(self, settings: WorldSettings | None = None, seed: int = 0) -> None:
        """Build the scene; `seed` is that of every noise."""
        self.settings = settings = settings or WorldSettings()
        self.seed = seed
        self.urdf = share("urdf/wam7.urdf").read_text()
        self.model = model = scene.build(self.urdf, settings.scene)
        self.data = data = mujoco.MjData(model)
        self._scratch = mujoco.MjData(model)
        self._substeps = round(PERIOD / settings.scene.timestep)
        self.motors = Motors(settings.bus_voltage)
        self._encoders = Encoders(PERIOD)
        self._mocap = Mocap(np.asarray(LAYOUT), settings.mocap)
        self._pan = model.body("pan").id
        self._pancake = model.body("pancake").id
        self._elbow = model.body("wam_link4").id
        self._friction = model.dof_frictionloss[:7].copy()
        # views into MuJoCo's own arrays
        self._q, self._qd = data.qpos[:7], data.qvel[:7]
        self._pancake_q, self._pancake_v = data.qpos[7:14], data.qvel[7:13]
        self._pan_position = data.xpos[self._pan]
        self._pan_matrix = data.xmat[self._pan]
        self._pancake_matrix = np.zeros(9)
        self._velocity = np.zeros(6)

        self.time_ns = PERIOD_NS
        self.frozen = False
        self.idle = False
        self.trace: list[np.ndarray] | None = None  # of joints and pancake, set to [] to record
        self._puller: Puller | None = None
        self._puller_start_ns = 0
        self._since_command = 0
        self._command = np.zeros(7)
        self._effort = np.zeros(7)
        self._delayed: deque[np.ndarray | None] = deque()
        self._torque_scale = np.ones(7)
        self._release_ns = 0
        self.reset("start", HOME)
        self.release()

    def reset(self, rollout_id: str, q_start: np.ndarray) -> None:
        """Arm at rest at `q_start` (7,) [rad], the pancake at rest in the pan, all of it frozen.

        What follows the release depends on the seed and `rollout_id` alone.
        """
        key = [self.seed, zlib.crc32(rollout_id.encode())]
        rng = np.random.default_rng(key)
        self._mocap_rng = np.random.default_rng([*key, 1])
        self.rollout_id = rollout_id
        settings, model, data = self.settings, self.model, self.data
        loud = 0.0 if rollout_id.endswith(QUIET) else 1.0
        offset = loud * settings.pancake_offset_sd * rng.standard_normal(2)
        wind = loud * settings.wind_sd * rng.standard_normal(3)
        self._torque_scale = 1.0 + loud * settings.torque_scale_sd * rng.standard_normal(7)
        friction = 1.0 + loud * settings.friction_sd * rng.standard_normal(7)
        model.dof_frictionloss[:7] = self._friction * np.maximum(friction, 0.0)
        model.opt.wind[:] = 0.0

        mujoco.mj_resetData(model, data)
        self._q[:] = q_start
        mujoco.mj_kinematics(model, data)
        rotation = self._pan_matrix.reshape(3, 3)
        self._pancake_q[:3] = self._pan_position + rotation @ np.array([*offset, 0.004])
        mujoco.mju_mat2Quat(self._pancake_q[3:], self._pan_matrix)
        for _ in range(_SETTLE_STEPS):
            mujoco.mj_step(model, data)
            self._q[:] = q_start
            self._qd[:] = 0.0
        data.qvel[:] = 0.0
        data.qacc_warmstart[:] = 0.0
        data.time = 0.0
        mujoco.mj_forward(model, data)
        model.opt.wind[:] = wind

        self._encoders.reset(self._q)
        self._delayed = deque([None] * settings.command_delay_ticks)
        self._since_command = 0
        self._puller = None
        self.frozen = True
        self.idle = False
        self._clear_truth()

    def release(self) -> None:
        """Let the physics go on from the frozen state."""
        self.frozen = False
        self._release_ns = self.time_ns
        self._mocap.restart(self.time_ns, self._mocap_rng)
        if self.trace is not None:
            self.trace.clear()

    def attach(self, puller: Puller) -> None:
        """Let something pull at the pan from now on."""
        self._puller, self._puller_start_ns = puller, self.time_ns

    @property
    def pulled(self) -> bool:
        """Whether something still pulls at the pan."""
        return self._puller is not None

    @property
    def pan_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) [m] and rotation (3, 3) of the pan."""
        return self._pan_position.copy(), self._pan_matrix.reshape(3, 3).copy()

    def joint_state(self) -> JointSample:
        """The joints as sensed now."""
        return JointSample(self.time_ns, self._encoders.q, self._encoders.qd, self._effort)

    def mocap_frames(self) -> list[MocapFrame]:
        """Frames that have come in since the last call."""
        return self._mocap.delivered(self.time_ns)

    def step(self, tau_cmd: np.ndarray | None) -> None:
        """One tick of 2 ms.

        Args:
            tau_cmd: commanded torques (7,) [N m], or None when no command has come: the last one
                holds for 10 ms, then the arm compensates its own gravity, damped.
        """
        self.time_ns += PERIOD_NS
        if tau_cmd is not None:
            self._effort = tau_cmd
        self._delayed.append(tau_cmd)
        command = self._delayed.popleft()
        if command is not None:
            self._command, self._since_command = command, 0
        else:
            self._since_command += 1
        if not self.frozen:
            self._advance()
            self._encoders.read(self._q)
            self._observe()
        mujoco.mju_quat2Mat(self._pancake_matrix, self._pancake_q[3:])
        self._mocap.sample(self.time_ns, self._pancake_q[:3], self._pancake_matrix)

    def _advance(self) -> None:
        data = self.data
        if self.idle:
            tau = self.motors.braking(self._qd)
        elif self._since_command > _WATCHDOG_TICKS:
            tau = self._own_gravity() - self.settings.watchdog_damping * self.model.dof_M0[:7] * (
                self._qd
            )
            tau = self.motors.limit(tau, self._qd)
        else:
            command = self._command
            if self.settings.driver_compensates_gravity:
                command = command + self._own_gravity()
            tau = self.motors.limit(command, self._qd)
            self._saturated += tau is not command
            tau = tau * self._torque_scale
        data.qfrc_applied[:7] = tau
        self._tau = tau
        if self._puller is None:
            mujoco.mj_step(self.model, data, self._substeps)
            return
        for substep in range(self._substeps):
            self._pull(substep)
            mujoco.mj_step(self.model, data)

    def _pull(self, substep: int) -> None:
        data = self.data
        if self._puller is not None:
            mujoco.mj_objectVelocity(
                self.model, data, mujoco.mjtObj.mjOBJ_XBODY, self._pan, self._velocity, 0
            )
            elapsed = (self.time_ns - PERIOD_NS - self._puller_start_ns) * 1e-9
            wrench = self._puller.wrench(
                elapsed + substep * self.settings.scene.timestep,
                self._pan_position,
                self._pan_matrix.reshape(3, 3),
                self._velocity[[3, 4, 5, 0, 1, 2]],
            )
            if wrench is not None:
                applied = data.xfrc_applied[self._pan]
                applied[:3] = wrench[:3]
                arm = self._pan_position - data.xipos[self._pan]
                applied[3:] = wrench[3:] + np.cross(arm, wrench[:3])
                return
            self._puller = None
        data.xfrc_applied[self._pan] = 0.0

    def _own_gravity(self) -> np.ndarray:
        scratch = self._scratch
        scratch.qpos[:] = self.data.qpos
        scratch.qvel[:] = 0.0
        mujoco.mj_fwdPosition(self.model, scratch)
        mujoco.mj_fwdVelocity(self.model, scratch)
        return scratch.qfrc_bias[:7].copy()

    # What really happened

    def _clear_truth(self) -> None:
        self._ticks = 0
        self._saturated = 0
        self._peak_qd = np.zeros(7)
        self._peak_tau = np.zeros(7)
        self._peaks = [0.0, 0.0, 0.0]
        self._tau = np.zeros(7)
        mujoco.mju_quat2Mat(self._pancake_matrix, self._pancake_q[3:])
        self._side = self._pancake_matrix.reshape(3, 3)[:, 2] @ self._pan_matrix.reshape(3, 3)[:, 2]
        self._normal_x, self._normal_z = self._pancake_matrix[2], self._pancake_matrix[8]
        self._angle = 0.0
        self._pan_height = float(self._pan_position[2])
        self._apex = 0.0
        self._above = False
        self._toss: tuple[float, float, float] | None = None  # angle, error x, error y

    def _observe(self) -> None:
        self._ticks += 1
        np.maximum(self._peak_qd, np.abs(self._qd), out=self._peak_qd)
        np.maximum(self._peak_tau, np.abs(self._tau), out=self._peak_tau)
        if self._ticks % 2 == 0:
            self._observe_speeds()
        x, y, z = self._pancake_q[:3].tolist()
        w, i, j, k = self._pancake_q[3:].tolist()
        normal_x, normal_z = 2.0 * (i * k + w * j), 1.0 - 2.0 * (i * i + j * j)
        # turned about +y: from z towards x
        self._angle += math.atan2(
            self._normal_z * normal_x - self._normal_x * normal_z,
            self._normal_x * normal_x + self._normal_z * normal_z,
        )
        self._normal_x, self._normal_z = normal_x, normal_z
        self._apex = max(self._apex, z - self._pan_height)
        pan_x, pan_y, pan_z = self._pan_position.tolist()
        above = z > pan_z + DELTA_H
        if self._above and not above and self._toss is None:
            self._toss = (self._angle, x - pan_x, y - pan_y)
        self._above = above
        if self.trace is not None and self._ticks % _TRACE_TICKS == 1:
            self.trace.append(self.data.qpos.copy())

    def _observe_speeds(self) -> None:
        velocity, point = self._velocity, mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self.model, self.data, point, self._elbow, velocity, 0)
        wx, wy, wz, vx, vy, vz = velocity.tolist()
        a, b, c = (self.data.xmat[self._elbow].reshape(3, 3) @ _FOREARM_POINT).tolist()
        elbow = math.sqrt(vx * vx + vy * vy + vz * vz)
        forearm = math.hypot(vx + wy * c - wz * b, vy + wz * a - wx * c, vz + wx * b - wy * a)
        mujoco.mj_objectVelocity(self.model, self.data, point, self._pan, velocity, 0)
        pan = math.hypot(*velocity[3:].tolist())
        self._peaks = [max(p, s) for p, s in zip(self._peaks, (elbow, forearm, pan), strict=True)]

    def truth(self) -> Truth:
        """What has happened since the release."""
        rotation = self._pan_matrix.reshape(3, 3)
        offset = rotation.T @ (self._pancake_q[:3] - self._pan_position)
        mujoco.mju_quat2Mat(self._pancake_matrix, self._pancake_q[3:])
        side = float(self._pancake_matrix.reshape(3, 3)[:, 2] @ rotation[:, 2])
        within = math.hypot(offset[0], offset[1]) < scene.PAN_RADIUS
        caught = bool(within and abs(offset[2]) < 0.012 and abs(side) > 0.98)
        flipped = bool(side * self._side < 0.0)
        angle, *error = self._toss or (0.0, math.nan, math.nan)
        beyond = self._peak_qd > self.motors.no_load_speed
        return Truth(
            id=self.rollout_id,
            caught=caught,
            flipped=flipped,
            tossed=self._toss is not None,
            angle=angle,
            true_flip=caught and flipped and 150.0 <= math.degrees(abs(angle)) <= 240.0,
            apex=self._apex,
            landing_error=[e if math.isfinite(e) else 0.0 for e in error],
            peak_qd=self._peak_qd.tolist(),
            peak_tau=self._peak_tau.tolist(),
            peak_elbow_speed=self._peaks[0],
            peak_forearm_speed=self._peaks[1],
            peak_pan_speed=self._peaks[2],
            beyond_no_load=bool(beyond.any()),
            saturated=self._saturated / max(self._ticks, 1),
        )
