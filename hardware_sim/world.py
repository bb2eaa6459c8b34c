# SPDX-License-Identifier: Apache-2.0
"""The simulated world: an arm with a pan in a scene, its motors, sensors and driver; no ROS.

After `reset(rollout_id, ...)` all that follows is a function of the seed, the id and the torques
from the release on, so a rollout comes out the same on any machine, however it got there.
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
from hardware_sim.sensors import Encoders, Mocap, MocapFrame, joint_counts
from hardware_sim.settings import SceneSettings, WorldSettings
from hardware_sim.wam import PERIOD, PERIOD_NS, WATCHDOG_TICKS, N
from wam_power_ros.control.arm import Arm
from wam_power_ros.params.resources import share
from wam_power_ros.tracking.marker_fit import LAYOUT

QUIET = "-quiet"  # a rollout whose id ends so is run without any noise
DROP_HEIGHT = 0.7  # [m]
_SETTLE_STEPS = 900  # physics steps, at most, in which bodies come to rest
_SETTLE_CHECK = 50  # steps from one check for rest to the next
_SETTLE_SLICE = 10  # steps that may be done within a tick
_SETTLED = 0.003  # [m/s] and [rad/s]: at rest
_TRACE_TICKS = 5  # 100 Hz


class JointSample(NamedTuple):
    """Joint state as the arm's driver reports it, once a tick."""

    stamp_ns: int
    q: np.ndarray  # (7,) [rad]
    qd: np.ndarray  # (7,) [rad/s]
    tau: np.ndarray  # (7,) commanded, the driver's own gravity torque included [N m]


class World:
    """One arm with a pan in a scene.

    Attributes:
        settings: Settings of the world.
        scene: Scene around the arm.
        time_ns: Time of the simulation [ns].
        frozen: Clock and cameras go on; physics, encoders and commands wait for `release`.
        idle: The motors are shorted and commands have no effect.
        urdf: Text of the arm's description.
        motors: The torque-speed envelope.
        trace: Joint positions of arm and bodies since the release, 100 a second, once it is set to
            []; None keeps none.

    Args:
        settings: Settings of the world; None for the defaults.
        seed: Seed of all noise.
        make_scene: Makes the scene.
    """

    def __init__(
        self,
        settings: WorldSettings | None = None,
        seed: int = 0,
        make_scene: Callable[[SceneSettings], Scene] = Flip,
    ) -> None:
        self._given = settings = settings or WorldSettings()
        self._make_scene = make_scene
        self.seed = seed
        arm = settings.arm
        self.urdf = share(arm.urdf).read_text()
        # the driver's own model of the arm
        self._arm = Arm(self.urdf, arm.joints, arm.tool, guarded=arm.guarded)
        self._substeps = round(PERIOD / scene.TIMESTEP)
        self.motors: Motors | DirectDrives = Motors(settings.bus_voltage)
        self._encoders = Encoders()
        if arm.drives == "direct":
            self.motors = DirectDrives(self._arm.tau_max, self._arm.qd_max)
            self._encoders = Encoders(joint_counts)
        self._mocap = Mocap(np.asarray(LAYOUT), settings.mocap)
        self._velocity = np.zeros(6)
        self._build(unknown_world.drawn(settings, seed) if settings.unknown else settings)

        self.time_ns = PERIOD_NS
        self.frozen = False
        self.idle = False
        self.trace: list[np.ndarray] | None = None
        self._delayed: deque[list[float] | None] = deque()
        self.reset("start", self.scene.home if arm.home is None else np.array(arm.home))
        self.release()

    def _build(self, settings: WorldSettings) -> None:
        """Take these settings, and the physics that have them."""
        self.settings = settings
        self.scene = self._make_scene(settings.scene)
        arm = settings.arm
        self.model = model = scene.build(
            self.urdf,
            self.scene,
            settings.scene.friction,
            arm.tool,
            arm.guarded,
            arm.joints,
            settings.payload,
        )
        self.data = data = mujoco.MjData(model)
        self._pan = model.body(arm.tool).id
        self._friction = settings.friction_share * model.dof_frictionloss[:N]
        self._watchdog_damping = (settings.watchdog_damping * model.dof_M0[:N]).tolist()
        # views into MuJoCo's own arrays
        self._q, self._qd, self._applied = data.qpos[:N], data.qvel[:N], data.qfrc_applied[:N]
        self._others_qd = data.qvel[N:]
        columns = _free_joint(model, self.scene.body)
        self._body, self._body_twist = data.qpos[columns[0]], data.qvel[columns[1]]
        self._pan_position = data.xpos[self._pan]
        self._pan_rotation = data.xmat[self._pan].reshape(3, 3)
        self._log = RolloutLog(model, data, [point.name for point in arm.guarded], columns)

    def reset(self, rollout_id: str, q_start: np.ndarray) -> None:
        """Put the arm to rest and the bodies of the scene to rest in their places, and freeze them.

        What follows the release depends on the seed and `rollout_id` alone.

        Args:
            rollout_id: Name of the rollout; one that ends in `QUIET` has no noise but the cameras'.
            q_start: Start posture [rad]. Shape (7,).

        Raises:
            ValueError: A joint is not finite or outside its limits.
        """
        deque(self.resetting(rollout_id, q_start), maxlen=0)

    def resetting(self, rollout_id: str, q_start: np.ndarray) -> Iterator[None]:
        """`reset` in slices, for a clock that may not wait; the world is frozen from the call on.

        Raises:
            ValueError: As `reset`, at once.
        """
        q_start = np.array(q_start, dtype=float)
        low, high = self.model.jnt_range[:N].T
        if q_start.shape != (N,) or not np.all((low <= q_start) & (q_start <= high)):
            raise ValueError(f"q_start {q_start.tolist()} must be {N} joints within their limits")
        self.frozen = True
        return self._resetting(rollout_id, q_start)

    def _resetting(self, rollout_id: str, q_start: np.ndarray) -> Iterator[None]:
        if self._given.unknown == "rollout":
            self._build(unknown_world.drawn(self._given, self.seed, rollout_id))
        key = [self.seed, zlib.crc32(rollout_id.encode())]
        rng = np.random.default_rng(key)
        self._mocap_rng = np.random.default_rng([*key, 1])
        self.rollout_id = rollout_id
        settings, model, data = self.settings, self.model, self.data
        loud = 0.0 if rollout_id.endswith(QUIET) else 1.0
        offset = loud * settings.scene.body_offset_sd * rng.standard_normal(2)
        wind = loud * settings.wind_sd * rng.standard_normal(3)
        scale = 1.0 + loud * settings.torque_scale_sd * rng.standard_normal(N)
        scale *= settings.torque_constants
        friction = 1.0 + loud * settings.friction_sd * rng.standard_normal(N)
        self._torque_scale: list[float] = scale.tolist()
        model.dof_frictionloss[:N] = self._friction * np.maximum(friction, 0.0)
        model.opt.wind[:] = 0.0

        mujoco.mj_resetData(model, data)
        self._q[:] = q_start
        mujoco.mj_kinematics(model, data)
        self.scene.place(data, self._pan_position, self._pan_rotation, offset)
        gravity = self._arm.gravity(q_start)
        self._applied[:] = gravity
        if self._others_qd.size:
            yield from self._settle(q_start)
        data.qvel[:] = 0.0
        model.opt.wind[:] = wind
        mujoco.mj_forward(model, data)

        self._encoders.reset(q_start.tolist())
        self._mocap.forget()
        self._command = [0.0] * N if settings.driver_compensates_gravity else gravity.tolist()
        self._effort: list[float] = gravity.tolist()
        self._delayed = deque([self._command] * settings.command_delay_ticks)
        self._since_command = 0
        self._puller: Demonstrator | None = None
        self._puller_start_ns = 0
        self.idle = False
        self.frozen = True
        self._restart_log()

    def _settle(self, q_start: np.ndarray) -> Iterator[None]:
        """Let the bodies come to rest around an arm that is held still."""
        for step in range(1, _SETTLE_STEPS + 1):
            mujoco.mj_step(self.model, self.data)
            self._q[:] = q_start
            self._qd[:] = 0.0
            if step % _SETTLE_CHECK == 0 and np.abs(self._others_qd).max() < _SETTLED:
                return
            if step % _SETTLE_SLICE == 0:
                yield

    def release(self) -> None:
        """Let the physics go on from the frozen state."""
        self.frozen = False
        self._mocap.restart(self.time_ns, self._mocap_rng)
        self._restart_log()

    def attach(self, puller: Demonstrator | None) -> None:
        """Let somebody lead the pan from now on, or nobody any more."""
        self._puller, self._puller_start_ns = puller, self.time_ns
        self.data.xfrc_applied[self._pan] = 0.0

    def drop(self) -> None:
        """Let the tracked body fall from `DROP_HEIGHT` over the pan, z level: least drag on a disc.

        Raises:
            ValueError: The scene has no tracked body.
        """
        if not self._body.size:
            raise ValueError("the scene has no body that could be dropped")
        self._body[:] = [*self._pan_position, math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0]
        self._body[2] += DROP_HEIGHT
        self._body_twist[:] = 0.0

    @property
    def pulled(self) -> bool:
        """Whether an external force still acts on the pan."""
        return self._puller is not None

    @property
    def pan_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) [m] and rotation (3, 3) of the pan."""
        return self._pan_position.copy(), self._pan_rotation.copy()

    def joint_state(self) -> JointSample:
        """Joint state as sensed now."""
        encoders = self._encoders
        return JointSample(
            self.time_ns, np.array(encoders.q), np.array(encoders.qd), np.array(self._effort)
        )

    def mocap_frames(self) -> list[MocapFrame]:
        """Frames of the tracked body delivered since the last call; none without one."""
        return self._mocap.delivered(self.time_ns)

    def step(self, tau_cmd: np.ndarray | None) -> None:
        """One tick of 2 ms.

        Args:
            tau_cmd: Commanded torques (7,) [N m], or None without a new command: the last one
                holds, with a watchdog for 10 ms; then the driver compensates gravity, damped.

        Raises:
            ValueError: The torques are not seven finite numbers.
        """
        command = None if tau_cmd is None else tau_cmd.tolist()
        if command is not None and not (len(command) == N and math.isfinite(sum(command))):
            raise ValueError(f"torques {command} must be {N} finite numbers")
        self.time_ns += PERIOD_NS
        if not self.frozen:
            self._delayed.append(command)
            command = self._delayed.popleft()
            if command is None:
                self._since_command += 1
            else:
                self._command, self._since_command = command, 0
            saturated = self._advance()
            self._encoders.read(self._q.tolist())
            self._record(saturated)
        if self._body.size and self._mocap.due(self.time_ns):
            self._mocap.expose(self.time_ns, self._body[:3].copy(), rotation_of(self._body))

    def _advance(self) -> bool:
        """Motors and physics of one tick; returns whether a motor gave less than commanded."""
        qd, saturated = self._qd.tolist(), False
        if self.idle:
            self._effort = [0.0] * N
            self._applied[:] = self.motors.braking(qd)
        else:
            wanted = self._wanted()
            self._effort = wanted
            given = self.motors.limit(wanted, qd)
            saturated = given is not wanted
            self._applied[:] = [a * b for a, b in zip(given, self._torque_scale, strict=True)]
        if self._puller is None:
            mujoco.mj_step(self.model, self.data, self._substeps)
        else:
            for substep in range(self._substeps):
                self._pull(substep)
        return saturated

    def _wanted(self) -> list[float]:
        """Joint torques (7,) the driver asks of the motors [N m]."""
        if self.settings.watchdog and self._since_command > WATCHDOG_TICKS:
            damped = zip(self._gravity(), self._watchdog_damping, self._encoders.qd, strict=True)
            return [g - d * qd for g, d, qd in damped]
        if self.settings.driver_compensates_gravity:
            return [a + b for a, b in zip(self._command, self._gravity(), strict=True)]
        return self._command

    def _gravity(self) -> list[float]:
        return self._arm.gravity(np.array(self._encoders.q)).tolist()

    def _pull(self, substep: int) -> None:
        """One physics step under the external force."""
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        if self._puller is not None:
            mujoco.mj_objectVelocity(
                model, data, mujoco.mjtObj.mjOBJ_XBODY, self._pan, self._velocity, 0
            )
            elapsed = (self.time_ns - PERIOD_NS - self._puller_start_ns) * 1e-9
            wrench = self._puller.wrench(
                elapsed + substep * scene.TIMESTEP,
                self._pan_position,
                self._pan_rotation,
                self._velocity[[3, 4, 5, 0, 1, 2]],
            )
            applied = data.xfrc_applied[self._pan]
            if wrench is None:
                self._puller = None
                applied[:] = 0.0
            else:  # MuJoCo wants it at the centre of mass
                applied[:3] = wrench[:3]
                lever = self._pan_position - data.xipos[self._pan]
                applied[3:] = wrench[3:] + np.cross(lever, wrench[:3])
        mujoco.mj_step2(model, data)

    # The ground truth

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
        """Id of the rollout, the scene's truth since the release, and `RolloutLog.arm_truth`."""
        now = Snapshot(self._body, *self._arm.tool_pose(self._q))
        truth, peaks = self.scene.truth(self._log, now), self._log.arm_truth(self.motors)
        return {"id": self.rollout_id, **truth, **peaks}


def _free_joint(model: mujoco.MjModel, body: str) -> tuple[slice, slice]:
    """Columns of a body's free joint in qpos and qvel; empty for "".

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
