# SPDX-License-Identifier: Apache-2.0
"""Simulated world: an arm with its tool in a scene, its motors, sensors and driver; no ROS.

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

from hardware_sim import scene
from hardware_sim.demonstrator import GRIP_DAMPING, ROTATION_DAMPING, Demonstrator
from hardware_sim.ground_truth import RolloutLog, Snapshot, Truth, rotation_of
from hardware_sim.hidden_arm import HiddenArm, drawn
from hardware_sim.motors import DirectDrives, Motors
from hardware_sim.scenes import Scene, scene_type
from hardware_sim.sensors import Encoders, Mocap, MocapFrame, MocapSettings
from hardware_sim.servo import Servo, ToolServo
from hardware_sim.settings import ArmSimParams, OptitrackSimParams, WorldSettings
from hardware_sim.wam import WATCHDOG_DAMPING, WATCHDOG_TIMEOUT
from wam_power_ros import rotations
from wam_power_ros.control.arm import Arm
from wam_power_ros.control.joint_references import MinJerk
from wam_power_ros.params.resources import robot_description

QUIET = "-quiet"  # suffix of the id of a rollout without wind, offset and variation of the arm
DROP_HEIGHT = 0.7  # [m]
TRACE_RATE = 100.0  # [Hz] of the poses in `World.trace`
CARRY_REST = 0.1  # [s] at its end, in which the filtered velocity becomes zero
REST_SPEED = 0.05  # [rad/s] or [m/s] of what counts as at rest
CARRY_SPEED = 1.0  # [rad/s] peak joint speed of an arm that is carried to a posture
# Physics steps until bodies are at rest, at most; between checks for rest; within one tick
_SETTLE_STEPS, _SETTLE_CHECK, _SETTLE_SLICE = 900, 50, 10
_SETTLED_SPEED = 0.003  # [m/s] and [rad/s] below which a body is at rest then


class JointSample(NamedTuple):
    """Joint state as the driver of the arm reports it every tick."""

    stamp_ns: int
    q: np.ndarray  # (n,) [rad]
    qd: np.ndarray  # (n,) [rad/s]
    tau: np.ndarray  # (n,) commanded, with the driver's own gravity torque [N m]


class World:
    """One arm with its tool in a scene.

    `hidden` says how the arm differs from its model; None: as the settings do.

    Attributes:
        settings: Settings, with what was drawn.
        time_ns: Time of the simulation [ns].
        frozen: True while only clock and cameras go on; physics, encoders and commands wait for
            `release`.
        idle: True while the motors are shorted and commands have no effect.
        guided: True while a person guides the arm: one that takes positions is then in free drive.
        arm: The driver's model of the arm.
    """

    def __init__(
        self,
        make_scene: Callable[[WorldSettings], Scene],
        settings: WorldSettings | None = None,
        seed: int = 0,
        mocap: MocapSettings | None = None,
        hidden: HiddenArm | None = None,
    ) -> None:
        self.settings, found = drawn(settings or WorldSettings(), seed)
        self.hidden = hidden or found
        self.seed, settings, mocap = seed, self.settings, mocap or MocapSettings()
        self.scene = make_scene(settings)
        self.urdf = robot_description(settings.urdf)
        names, tool, guarded = settings.model_joint_names, settings.tool_frame, settings.guarded
        base, limits = settings.base_frame, settings.position_limits
        self.arm = Arm(self.urdf, names, tool, guarded, None, base, limits)
        self.n = self.arm.n
        self._period_ns = settings.period_ns
        self._substeps = round(settings.period / scene.TIMESTEP)
        self._watchdog_ticks = settings.ticks(WATCHDOG_TIMEOUT)
        self.motors: Motors | DirectDrives = Motors(settings.bus_voltage)
        if settings.drives == "direct":
            self.motors = DirectDrives(self.arm.tau_max, self.arm.qd_max)
        self._encoders = Encoders(settings.drives, settings.period)
        self._mocap = Mocap(mocap)
        self._by_pose = settings.output == "pose"
        servo = ToolServo if self._by_pose else Servo
        self._servo = servo(self.arm, settings.servo_lag, settings.period)
        self._velocity = np.zeros(6)
        self._carrying: tuple[MinJerk, int] | None = None  # path and its beginning [ns]
        self._build()
        self.time_ns = self._period_ns
        self.reset("start", self.scene.home if settings.home is None else np.array(settings.home))
        self._mocap.aim(self._tool_position.copy())
        self.release()

    @classmethod
    def from_params(cls, params: ArmSimParams, cameras: OptitrackSimParams | None) -> World:
        """World of the stand-ins' parameters; `cameras` may be None in a scene without a body.

        Raises:
            ValueError: A parameter is not acceptable.
        """
        make_scene = scene_type(params.scene)
        if cameras is not None and make_scene.body not in ("", cameras.body):
            raise ValueError(
                f"optitrack_sim is set to body {cameras.body!r}, but the tracked body of scene "
                f"{params.scene!r} is {make_scene.body!r}"
            )
        return cls(make_scene, params, params.seed, cameras)

    def _build(self) -> None:
        """Compile scene and physics."""
        settings, n = self.settings, self.n
        self._drags = self.hidden.drags
        root = self.arm.root.translation, self.arm.root.rotation
        self.model = model = scene.build(self.urdf, self.scene, settings, self.hidden, root)
        self.data = data = mujoco.MjData(model)
        self._tool = model.body(settings.tool_frame).id
        self._friction = settings.friction_share * model.dof_frictionloss[:n]
        self._watchdog_damping = (WATCHDOG_DAMPING * model.dof_M0[:n]).tolist()
        # views into MuJoCo's arrays
        self._q, self._qd, self._applied = data.qpos[:n], data.qvel[:n], data.qfrc_applied[:n]
        self._scene_qd = data.qvel[n:]
        columns = _free_joint(model, "" if self.scene.mounted else self.scene.body)
        self._body, self._body_twist = data.qpos[columns[0]], data.qvel[columns[1]]
        self._tool_position = data.xpos[self._tool]
        self._tool_rotation = data.xmat[self._tool].reshape(3, 3)
        self._log = RolloutLog(model, data, settings, columns)

    def reset(self, rollout_id: str, q_start: np.ndarray) -> None:
        """Put the arm, at q_start (n,) [rad], and the bodies of the scene to rest; freeze them.

        In a rollout whose id has the suffix `QUIET` only the cameras are noisy.

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
        n = self.n
        low, high = self.arm.q_min, self.arm.q_max
        if q_start.shape != (n,) or not np.all((low <= q_start) & (q_start <= high)):
            raise ValueError(f"q_start {q_start.tolist()} must be {n} angles within their limits")
        self.frozen = True
        return self._resetting(rollout_id, q_start - self.hidden.zeros)

    def _resetting(self, rollout_id: str, q_start: np.ndarray) -> Iterator[None]:
        key = [self.seed, zlib.crc32(rollout_id.encode()), 1]
        self._mocap_rng = np.random.default_rng(key)
        model, data = self.model, self.data
        offset, wind = self._vary(rollout_id)
        model.opt.wind[:] = 0.0

        mujoco.mj_resetData(model, data)
        self._q[:] = q_start
        mujoco.mj_kinematics(model, data)
        self.scene.place(data, self._tool_position, self._tool_rotation, offset)
        gravity = self.arm.gravity(q_start)
        self._applied[:] = gravity
        if self._scene_qd.size:
            yield from self._settle(q_start)
        data.qvel[:] = 0.0
        model.opt.wind[:] = wind
        mujoco.mj_forward(model, data)

        self._encoders.reset((q_start + self.hidden.zeros).tolist())
        self._mocap.forget()
        self._effort: list[float] = gravity.tolist()
        own = self.settings.driver_compensates_gravity
        self._command = [0.0] * self.n if own else self._effort
        if self.settings.output != "torque":
            held = q_start + self.hidden.zeros
            self._servo.reset(held)
            self._command = held.tolist()
            if self._by_pose:
                position, rotation = self.arm.tool_pose(held)
                self._command = [*position.tolist(), *rotations.quat_xyzw(rotation).tolist()]
        self.guided = False
        self._delayed: deque[list[float] | None]
        self._delayed = deque([self._command] * self.settings.command_delay_ticks)
        self._ticks_since_command = 0
        self._demonstrator: Demonstrator | None = None
        self._grip_ns = 0
        self.idle = False
        self.frozen = True
        self._restart_log()

    def _vary(self, rollout_id: str) -> tuple[np.ndarray, np.ndarray]:
        """Draw the variation of the arm in a rollout; offset (2,) [m] and wind (3,) [m/s] in it."""
        self.rollout_id = rollout_id
        settings, n = self.settings, self.n
        rng = np.random.default_rng([self.seed, zlib.crc32(rollout_id.encode())])
        noise = 0.0 if rollout_id.endswith(QUIET) else 1.0
        offset = noise * settings.body_offset_sd * rng.standard_normal(2)
        wind = noise * settings.wind_sd * rng.standard_normal(3)
        scale = 1.0 + noise * settings.torque_scale_sd * rng.standard_normal(n)
        scale *= self.hidden.motors
        friction = 1.0 + noise * settings.friction_sd * rng.standard_normal(n)
        self._torque_scale: list[float] = scale.tolist()
        self.model.dof_frictionloss[:n] = self._friction * np.maximum(friction, 0.0)
        return offset, wind

    def _settle(self, q_start: np.ndarray) -> Iterator[None]:
        """Let the bodies come to rest while the arm is held still."""
        for step in range(1, _SETTLE_STEPS + 1):
            mujoco.mj_step(self.model, self.data)
            self._q[:] = q_start
            self._qd[:] = 0.0
            if step % _SETTLE_CHECK == 0 and np.abs(self._scene_qd).max() < _SETTLED_SPEED:
                return
            if step % _SETTLE_SLICE == 0:
                yield

    def carry(self, q: np.ndarray) -> None:
        """Let a person carry the arm to a posture (n,) [rad], by its joints alone; freezes it.

        The encoders see a movement of minimum jerk, as of a real arm; `carried` says when it ends.
        """
        self.frozen = True
        self._carrying = MinJerk(self._q.copy(), q - self.hidden.zeros, CARRY_SPEED), self.time_ns

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
        self._encoders.read((self._q + self.hidden.zeros).tolist())
        if t >= path.duration + CARRY_REST:
            self._carrying = None

    def release(self, rollout_id: str = "") -> None:
        """Continue the physics from the frozen state, in the rollout of the reset.

        With an id another rollout begins now, with arm and bodies as they are: its wind and its
        variation of the arm are drawn as by `reset`.
        """
        if rollout_id:
            _, self.model.opt.wind[:] = self._vary(rollout_id)
        self.frozen = False
        self._mocap.restart(self.time_ns, self._mocap_rng)
        self._restart_log()

    def attach(self, demonstrator: Demonstrator | None) -> None:
        """Let a demonstrator guide the tool from now on; None lets go of it."""
        self._demonstrator, self._grip_ns = demonstrator, self.time_ns
        self.data.xfrc_applied[self._tool] = 0.0

    def drop(self) -> None:
        """Drop the tracked body from `DROP_HEIGHT` above the tool, z level: least drag on a disc.

        Raises:
            ValueError: The scene has no tracked body.
        """
        if not self._body.size:
            raise ValueError("the scene has no tracked body to drop")
        self._body[:] = [*self._tool_position, math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0]
        self._body[2] += DROP_HEIGHT
        self._body_twist[:] = 0.0

    @property
    def moving(self) -> bool:
        """Whether arm or scene move, such as a body that has not come to rest."""
        return not self.frozen and bool(np.abs(self.data.qvel).max() > REST_SPEED)

    @property
    def pulled(self) -> bool:
        """Whether a demonstrator guides the tool."""
        return self._demonstrator is not None

    @property
    def tool_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) [m] and rotation (3, 3) of the tool."""
        return self._tool_position.copy(), self._tool_rotation.copy()

    @property
    def home(self) -> np.ndarray:
        """Posture in which demonstrations begin (n,) [rad]: the scene knows that of the WAM."""
        own = self.settings.home if self.settings.drives == "direct" else None
        return self.scene.home if own is None else np.array(own)

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
        """Advance by one control period, with commanded torques [N m] or positions [rad]. (n,).

        An arm that takes poses has position [m] and quaternion xyzw of its tool instead. (7,).
        Without new ones the last stay; torques with a watchdog for 10 ms, then the driver
        compensates gravity, damped.

        Raises:
            ValueError: They are not so many finite numbers.
        """
        command, size = None if tau_cmd is None else tau_cmd.tolist(), len(self._command)
        if command is not None and not (len(command) == size and math.isfinite(sum(command))):
            raise ValueError(f"commands {command} must be {size} finite numbers")
        self.time_ns += self._period_ns
        self._carry_on()
        if not self.frozen:
            self._delayed.append(command)
            command = self._delayed.popleft()
            if command is None:
                self._ticks_since_command += 1
            else:
                self._command, self._ticks_since_command = command, 0
            saturated = self._advance()
            self._encoders.read((self._q + self.hidden.zeros).tolist())
            self._log.record(saturated)
        if self.scene.body and self._mocap.due(self.time_ns):
            position, rotation, twist = self._body_motion()
            turn, offset = self.hidden.cameras
            twist = np.concatenate([turn @ twist[:3], turn @ twist[3:]])
            self._mocap.expose(self.time_ns, turn @ position + offset, turn @ rotation, twist)

    def _advance(self) -> bool:
        """Step motors and physics by one tick; returns whether a motor was at its limit."""
        qd, saturated = self._qd.tolist(), False
        if self.idle:
            self._effort = [0.0] * self.n
            self._applied[:] = self.motors.braking(qd)
        else:
            self._effort = self._commanded_torque()
            given = self.motors.limit(self._effort, qd)
            saturated = given is not self._effort
            self._applied[:] = [a * b for a, b in zip(given, self._torque_scale, strict=True)]
        if self._drags:
            self._applied[:] -= self.hidden.drag(self._qd, self.model.dof_frictionloss[: self.n])
        if self._demonstrator is None:
            mujoco.mj_step(self.model, self.data, self._substeps)
        else:
            for substep in range(self._substeps):
                self._guided_step(substep)
        return saturated

    def _body_motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position (3,) [m], rotation (3, 3) and velocities (6,) [m/s, rad/s] of the tracked body.

        Those of a mounted one, which moves slowly, are not told.
        """
        if self.scene.mounted is None:
            turned, twist = rotation_of(self._body), self._body_twist.copy()
            twist[3:] = turned @ twist[3:]
            return self._body[:3].copy(), turned, twist
        position, rotation = self.scene.mounted
        mujoco.mj_kinematics(self.model, self.data)  # a step leaves the tool where it began
        tool, turned = self._tool_position, self._tool_rotation
        return tool + turned @ position, turned @ rotation, np.zeros(6)

    def _commanded_torque(self) -> list[float]:
        """Joint torques (n,) that the driver commands to the motors [N m]."""
        positions = self.settings.output != "torque"
        silent = self.settings.watchdog and self._ticks_since_command > self._watchdog_ticks
        if self.guided if positions else silent:
            self._servo.reset(np.array(self._encoders.q))
            damped = zip(self._gravity(), self._watchdog_damping, self._encoders.qd, strict=True)
            return [g - d * qd for g, d, qd in damped]
        if positions:
            state = np.array(self._encoders.q), np.array(self._encoders.qd)
            return self._servo.torque(np.array(self._command), *state).tolist()
        if self.settings.driver_compensates_gravity:
            return [a + b for a, b in zip(self._command, self._gravity(), strict=True)]
        return self._command

    def _gravity(self) -> list[float]:
        return self.arm.gravity(np.array(self._encoders.q)).tolist()

    def _guided_step(self, substep: int) -> None:
        """Do one physics step with the force of the demonstrator."""
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        if self._demonstrator is not None:
            mujoco.mj_objectVelocity(
                model, data, mujoco.mjtObj.mjOBJ_XBODY, self._tool, self._velocity, 0
            )
            elapsed = (self.time_ns - self._period_ns - self._grip_ns) * 1e-9
            wrench = self._demonstrator.wrench(
                elapsed + substep * scene.TIMESTEP,
                self._tool_position,
                self._tool_rotation,
                self._velocity[[3, 4, 5, 0, 1, 2]],
            )
            applied = data.xfrc_applied[self._tool]
            if wrench is None:
                self._demonstrator = None
                applied[:] = 0.0
            else:  # MuJoCo applies it at the centre of mass
                if self.n < 6:  # such an arm turns its tool as it must
                    wrench[3:] = -ROTATION_DAMPING * self._velocity[:3]
                if not self.arm.armature.any():
                    wrench = self._yielding(wrench)
                applied[:3] = wrench[:3]
                lever = self._tool_position - data.xipos[self._tool]
                applied[3:] = wrench[3:] + np.cross(lever, wrench[:3])
        mujoco.mj_step2(model, data)

    def _yielding(self, wrench: np.ndarray) -> np.ndarray:
        """Wrench (6,) of a hand whose damping acts within the step of the physics, not after it.

        Else it shakes a wrist without rotor inertia.
        """
        jacobian = np.zeros((6, self.model.nv))
        position, tool = self._tool_position, self._tool
        mujoco.mj_jac(self.model, self.data, jacobian[:3], jacobian[3:], position, tool)
        mobile = np.zeros_like(jacobian)  # rows of M^-1 J^T
        mujoco.mj_solveM(self.model, self.data, mobile, jacobian)
        slowed = scene.TIMESTEP * GRIP_DAMPING[:, np.newaxis] * (jacobian @ mobile.T)
        return np.linalg.solve(np.eye(6) + slowed, wrench)

    def _restart_log(self) -> None:
        self._log.restart(Snapshot(self._body.copy(), *self.tool_pose))

    @property
    def trace(self) -> np.ndarray:
        """Joint positions of arm and bodies since the release, 100 a second. Shape (rows, nq)."""
        return self._log.positions[:: self.settings.ticks(1.0 / TRACE_RATE)].copy()

    def truth(self) -> Truth:
        """Ground truth since the release: id, outcome by the scene, `RolloutLog.arm_truth`."""
        mujoco.mj_kinematics(self.model, self.data)  # a step leaves the tool where it began
        now = Snapshot(self._body, *self.tool_pose)
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
