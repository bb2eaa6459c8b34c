# SPDX-License-Identifier: Apache-2.0
"""Simulated world: an arm with a pan in a scene, its motors, sensors and driver; no ROS.

After `reset(rollout_id, ...)` the world is a function of the seed, the id and the torques since the
release, so a rollout is the same on any machine, whatever happened before.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from hardware_sim import scene, unknown_world
from hardware_sim.demonstrator import Demonstrator
from hardware_sim.ground_truth import LOG_TICKS, RolloutLog, Snapshot, Truth, rotation_of
from hardware_sim.motors import DirectDrives, Motors
from hardware_sim.scenes import Scene
from hardware_sim.scenes.flip import Flip
from hardware_sim.sensors import Encoders, Mocap, MocapFrame, quantize_geared
from hardware_sim.settings import SceneSettings, WorldSettings
from hardware_sim.wam import PERIOD, PERIOD_NS, WATCHDOG_TICKS, N
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.joint_references import MinJerk
from wam_power_ros.params.resources import share
from wam_power_ros.tracking.marker_fit import LAYOUT

QUIET = "-quiet"  # suffix of the id of a rollout without wind, offset and variation of the arm
DROP_HEIGHT = 0.7  # [m]
TRACE_RATE = 100.0  # [Hz] of the poses in `World.trace`
CARRY_REST = 0.1  # [s] at its end, in which the filtered velocity becomes zero
CARRY_SPEED = 1.0  # [rad/s] peak joint speed of an arm that is carried to a posture
_SETTLE_STEPS = 900  # physics steps, at most, until bodies are at rest
_SETTLE_CHECK = 50  # physics steps between checks for rest
_SETTLE_SLICE = 10  # physics steps done within one tick
_REST_SPEED = 0.003  # [m/s] and [rad/s] below which a body is at rest
_TRACE_TICKS = round(1.0 / (TRACE_RATE * PERIOD))  # between poses of the trace


class JointSample(NamedTuple):
    """Joint state as the driver of the arm reports it every tick."""

    stamp_ns: int
    q: np.ndarray  # (7,) [rad]
    qd: np.ndarray  # (7,) [rad/s]
    tau: np.ndarray  # (7,) commanded, with the driver's own gravity torque [N m]


class World:
    """One arm with a pan in a scene.

    Attributes:
        settings: Settings of the world.
        scene: Scene around the arm.
        time_ns: Time of the simulation [ns].
        frozen: True while only clock and cameras go on; physics, encoders and commands wait for
            `release`.
        idle: True while the motors are shorted and commands have no effect.
        urdf: Text of the arm's URDF.
        motors: Torque limits of the motors.
        trace: Set to [] to record joint positions of arm and bodies since the release, 100 a
            second; None records nothing.

    Args:
        settings: Settings of the world; None for the defaults.
        seed: Seed of all noise.
        make_scene: Creates the scene.
    """

    def __init__(
        self,
        settings: WorldSettings | None = None,
        seed: int = 0,
        make_scene: Callable[[SceneSettings], Scene] = Flip,
    ) -> None:
        self._nominal_settings = settings = settings or WorldSettings()
        self._make_scene = make_scene
        self.seed = seed
        arm = settings.arm
        self.urdf = share(arm.urdf).read_text()
        self._arm = Arm(self.urdf, arm.joints, arm.tool, guarded=arm.guarded)  # driver's model
        self._substeps = round(PERIOD / scene.TIMESTEP)
        self.motors: Motors | DirectDrives = Motors(settings.bus_voltage)
        self._encoders = Encoders()
        if arm.drives == "direct":
            self.motors = DirectDrives(self._arm.tau_max, self._arm.qd_max)
            self._encoders = Encoders(quantize_geared)
        self._mocap = Mocap(np.asarray(LAYOUT), settings.mocap)
        self._velocity = np.zeros(6)
        self._carrying: tuple[MinJerk, int] | None = None  # path and its beginning [ns]
        self._build(unknown_world.draw(settings, seed) if settings.unknown else settings)

        self.time_ns = PERIOD_NS
        self.trace: list[np.ndarray] | None = None
        self.reset("start", self.scene.home if arm.home is None else np.array(arm.home))
        self.release()

    def _build(self, settings: WorldSettings) -> None:
        """Compile scene and physics for these settings."""
        self.settings = settings
        self.scene = self._make_scene(settings.scene)
        arm = settings.arm
        self.model = model = scene.build(self.urdf, self.scene, settings)
        self.data = data = mujoco.MjData(model)
        self._pan = model.body(arm.tool).id
        self._friction = settings.friction_share * model.dof_frictionloss[:N]
        self._watchdog_damping = (settings.watchdog_damping * model.dof_M0[:N]).tolist()
        # views into MuJoCo's arrays
        self._q, self._qd, self._applied = data.qpos[:N], data.qvel[:N], data.qfrc_applied[:N]
        self._scene_qd = data.qvel[N:]
        columns = _free_joint(model, self.scene.body)
        self._body, self._body_twist = data.qpos[columns[0]], data.qvel[columns[1]]
        self._pan_position = data.xpos[self._pan]
        self._pan_rotation = data.xmat[self._pan].reshape(3, 3)
        self._log = RolloutLog(model, data, [point.name for point in arm.guarded], columns)

    def reset(self, rollout_id: str, q_start: np.ndarray) -> None:
        """Put the arm and the bodies of the scene to rest at the start of a rollout; freeze them.

        After the release the world depends only on the seed, `rollout_id`, `q_start` and the
        torques.

        Args:
            rollout_id: Id of the rollout; with suffix `QUIET` only the cameras are noisy.
            q_start: Start posture [rad]. Shape (7,).

        Raises:
            ValueError: A joint is not finite or outside its limits.
        """
        deque(self.resetting(rollout_id, q_start), maxlen=0)

    def resetting(self, rollout_id: str, q_start: np.ndarray) -> Iterator[None]:
        """Do `reset` in slices, between which ticks go on; the world is frozen from the call on.

        Raises:
            ValueError: As `reset`, before the first slice.
        """
        q_start = np.array(q_start, dtype=float)
        low, high = self.model.jnt_range[:N].T
        if q_start.shape != (N,) or not np.all((low <= q_start) & (q_start <= high)):
            raise ValueError(f"q_start {q_start.tolist()} must be {N} angles within their limits")
        self.frozen = True
        return self._resetting(rollout_id, q_start)

    def _resetting(self, rollout_id: str, q_start: np.ndarray) -> Iterator[None]:
        if self._nominal_settings.unknown == "rollout":
            self._build(unknown_world.draw(self._nominal_settings, self.seed, rollout_id))
        key = [self.seed, zlib.crc32(rollout_id.encode())]
        rng = np.random.default_rng(key)
        self._mocap_rng = np.random.default_rng([*key, 1])
        self.rollout_id = rollout_id
        settings, model, data = self.settings, self.model, self.data
        noise = 0.0 if rollout_id.endswith(QUIET) else 1.0
        offset = noise * settings.scene.body_offset_sd * rng.standard_normal(2)
        wind = noise * settings.wind_sd * rng.standard_normal(3)
        scale = 1.0 + noise * settings.torque_scale_sd * rng.standard_normal(N)
        scale *= settings.torque_constants
        friction = 1.0 + noise * settings.friction_sd * rng.standard_normal(N)
        self._torque_scale: list[float] = scale.tolist()
        model.dof_frictionloss[:N] = self._friction * np.maximum(friction, 0.0)
        model.opt.wind[:] = 0.0

        mujoco.mj_resetData(model, data)
        self._q[:] = q_start
        mujoco.mj_kinematics(model, data)
        self.scene.place(data, self._pan_position, self._pan_rotation, offset)
        gravity = self._arm.gravity(q_start)
        self._applied[:] = gravity
        if self._scene_qd.size:
            yield from self._settle(q_start)
        data.qvel[:] = 0.0
        model.opt.wind[:] = wind
        mujoco.mj_forward(model, data)

        self._encoders.reset(q_start.tolist())
        self._mocap.forget()
        self._command = [0.0] * N if settings.driver_compensates_gravity else gravity.tolist()
        self._effort: list[float] = gravity.tolist()
        self._delayed: deque[list[float] | None]
        self._delayed = deque([self._command] * settings.command_delay_ticks)
        self._ticks_since_command = 0
        self._demonstrator: Demonstrator | None = None
        self._grip_ns = 0
        self.idle = False
        self.frozen = True
        self._restart_log()

    def _settle(self, q_start: np.ndarray) -> Iterator[None]:
        """Let the bodies come to rest while the arm is held still."""
        for step in range(1, _SETTLE_STEPS + 1):
            mujoco.mj_step(self.model, self.data)
            self._q[:] = q_start
            self._qd[:] = 0.0
            if step % _SETTLE_CHECK == 0 and np.abs(self._scene_qd).max() < _REST_SPEED:
                return
            if step % _SETTLE_SLICE == 0:
                yield

    def carry(self, q: np.ndarray) -> None:
        """Let a person carry the arm to a posture (7,) [rad], by its joints alone; freezes it.

        The encoders see a movement of minimum jerk, as of a real arm; `carried` says when it ends.
        """
        self.frozen = True
        self._carrying = MinJerk(self._q.copy(), q, CARRY_SPEED), self.time_ns

    @property
    def carried(self) -> bool:
        """Whether no movement of `carry` is under way."""
        return self._carrying is None

    def _carry_on(self) -> None:
        """Move a carried arm by one tick."""
        if self._carrying is None:
            return
        path, begun_ns = self._carrying
        t = (self.time_ns - begun_ns) * 1e-9
        self._q[:] = path.at(t)[0]
        self._encoders.read(self._q.tolist())
        if t >= path.duration + CARRY_REST:
            self._carrying = None

    def release(self) -> None:
        """Continue the physics from the frozen state."""
        self.frozen = False
        self._mocap.restart(self.time_ns, self._mocap_rng)
        self._restart_log()

    def attach(self, demonstrator: Demonstrator | None) -> None:
        """Let a demonstrator guide the pan from now on; None lets go of it."""
        self._demonstrator, self._grip_ns = demonstrator, self.time_ns
        self.data.xfrc_applied[self._pan] = 0.0

    def drop(self) -> None:
        """Drop the tracked body from `DROP_HEIGHT` above the pan, z level: least drag on a disc.

        Raises:
            ValueError: The scene has no tracked body.
        """
        if not self._body.size:
            raise ValueError("the scene has no tracked body to drop")
        self._body[:] = [*self._pan_position, math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0]
        self._body[2] += DROP_HEIGHT
        self._body_twist[:] = 0.0

    @property
    def pulled(self) -> bool:
        """Whether a demonstrator guides the pan."""
        return self._demonstrator is not None

    @property
    def pan_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) [m] and rotation (3, 3) of the pan."""
        return self._pan_position.copy(), self._pan_rotation.copy()

    def joint_state(self) -> JointSample:
        """Current joint state as measured."""
        encoders = self._encoders
        return JointSample(
            self.time_ns, np.array(encoders.q), np.array(encoders.qd), np.array(self._effort)
        )

    def mocap_frames(self) -> list[MocapFrame]:
        """Frames delivered since the last call; none if the scene has no tracked body."""
        return self._mocap.delivered(self.time_ns)

    def step(self, tau_cmd: np.ndarray | None) -> None:
        """Advance by one tick of 2 ms.

        Args:
            tau_cmd: Commanded torques [N m], shape (7,). None without a new command: the last one
                stays, with a watchdog for 10 ms; then the driver compensates gravity, damped.

        Raises:
            ValueError: The torques are not seven finite numbers.
        """
        command = None if tau_cmd is None else tau_cmd.tolist()
        if command is not None and not (len(command) == N and math.isfinite(sum(command))):
            raise ValueError(f"torques {command} must be {N} finite numbers")
        self.time_ns += PERIOD_NS
        self._carry_on()
        if not self.frozen:
            self._delayed.append(command)
            command = self._delayed.popleft()
            if command is None:
                self._ticks_since_command += 1
            else:
                self._command, self._ticks_since_command = command, 0
            saturated = self._advance()
            self._encoders.read(self._q.tolist())
            self._record(saturated)
        if self._body.size and self._mocap.due(self.time_ns):
            self._mocap.expose(self.time_ns, self._body[:3].copy(), rotation_of(self._body))

    def _advance(self) -> bool:
        """Step motors and physics by one tick; returns whether a motor was at its limit."""
        qd, saturated = self._qd.tolist(), False
        if self.idle:
            self._effort = [0.0] * N
            self._applied[:] = self.motors.braking(qd)
        else:
            self._effort = self._commanded_torque()
            given = self.motors.limit(self._effort, qd)
            saturated = given is not self._effort
            self._applied[:] = [a * b for a, b in zip(given, self._torque_scale, strict=True)]
        if self._demonstrator is None:
            mujoco.mj_step(self.model, self.data, self._substeps)
        else:
            for substep in range(self._substeps):
                self._guided_step(substep)
        return saturated

    def _commanded_torque(self) -> list[float]:
        """Joint torques (7,) that the driver commands to the motors [N m]."""
        if self.settings.watchdog and self._ticks_since_command > WATCHDOG_TICKS:
            damped = zip(self._gravity(), self._watchdog_damping, self._encoders.qd, strict=True)
            return [g - d * qd for g, d, qd in damped]
        if self.settings.driver_compensates_gravity:
            return [a + b for a, b in zip(self._command, self._gravity(), strict=True)]
        return self._command

    def _gravity(self) -> list[float]:
        return self._arm.gravity(np.array(self._encoders.q)).tolist()

    def _guided_step(self, substep: int) -> None:
        """Do one physics step with the force of the demonstrator."""
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        if self._demonstrator is not None:
            mujoco.mj_objectVelocity(
                model, data, mujoco.mjtObj.mjOBJ_XBODY, self._pan, self._velocity, 0
            )
            elapsed = (self.time_ns - PERIOD_NS - self._grip_ns) * 1e-9
            wrench = self._demonstrator.wrench(
                elapsed + substep * scene.TIMESTEP,
                self._pan_position,
                self._pan_rotation,
                self._velocity[[3, 4, 5, 0, 1, 2]],
            )
            applied = data.xfrc_applied[self._pan]
            if wrench is None:
                self._demonstrator = None
                applied[:] = 0.0
            else:  # MuJoCo applies it at the centre of mass
                applied[:3] = wrench[:3]
                lever = self._pan_position - data.xipos[self._pan]
                applied[3:] = wrench[3:] + np.cross(lever, wrench[:3])
        mujoco.mj_step2(model, data)

    # Ground truth

    def _restart_log(self) -> None:
        if self.trace is not None:
            self.trace.clear()
        start = self._body, self._pan_position, self._pan_rotation
        self._log.restart(Snapshot(*(array.copy() for array in start)))

    def _record(self, saturated: bool) -> None:
        row = self._log.rows
        if self.trace is not None and row < LOG_TICKS and row % _TRACE_TICKS == 0:
            self.trace.append(self.data.qpos.copy())
        self._log.record(saturated)

    def truth(self) -> Truth:
        """Ground truth since the release: id, outcome by the scene, `RolloutLog.arm_truth`."""
        now = Snapshot(self._body, *self._arm.tool_pose(self._q))
        truth, peaks = self.scene.truth(self._log, now), self._log.arm_truth(self.motors)
        return {"id": self.rollout_id, **truth, **peaks}


def _free_joint(model: mujoco.MjModel, body: str) -> tuple[slice, slice]:
    """Columns of a body's free joint in qpos and qvel; empty if the name is "".

    Raises:
        ValueError: The body is not on a free joint.
    """
    if not body:
        return slice(0), slice(0)
    joint = model.body(body).jntadr[0]
    if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        raise ValueError(f"the tracked body {body!r} must be on a free joint")
    q, v = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
    return slice(q, q + 7), slice(v, v + 6)
