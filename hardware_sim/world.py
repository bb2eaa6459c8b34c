# SPDX-License-Identifier: Apache-2.0
"""The stand-in's world: a WAM with a pan, a pancake, sensors and motors. Steps; no ROS, no sleep.

After `reset(rollout_id, ...)` all that follows is a function of the seed, the id and the torques
from the release on, so a rollout comes out the same on any machine, however it got there.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol

import mujoco
import numpy as np

from hardware_sim import scene
from hardware_sim.motors import DirectDrives, Motors
from hardware_sim.scene import SceneSettings
from hardware_sim.sensors import Encoders, Mocap, MocapFrame, MocapSettings, joint_counts
from wam_power_ros import rotations
from wam_power_ros.control.arm import WAM_GUARDED, Arm, Guarded
from wam_power_ros.params.resources import share
from wam_power_ros.tracking.marker_fit import LAYOUT

N = 7  # joints
JOINTS = tuple(f"wam_j{number}" for number in range(1, N + 1))
PERIOD = 0.002  # [s]
PERIOD_NS = 2_000_000
QUIET = "-quiet"  # a rollout whose id ends so is run without any noise
DELTA_H = 0.12  # [m] over the pan's floor, where a falling pancake is judged
HOME = np.deg2rad([0.0, 20.0, 0.0, 122.0, 0.0, -27.0, 0.0])  # [rad] the pan 25 degrees front down
HOME.setflags(write=False)
_WATCHDOG_TICKS = 5  # 10 ms without a command
_SETTLE_STEPS = 900  # physics steps, at most, in which the pancake comes to rest in the pan
_SETTLE_LOOK = 50  # steps after which it is looked at
_SETTLE_SLICE = 10  # steps that may be done within a tick
_SETTLED = 0.003  # [m/s] and [rad/s]: it is at rest
_LOG_TICKS = 5000  # after a release that are logged: 10 s
_TRACE_TICKS = 5  # 100 Hz


@dataclass(frozen=True)
class ArmSettings:
    """Which arm there is; by default the WAM.

    Attributes:
        urdf: File, or one below our share folder.
        joints: From base to tip; seven.
        tool: Link that holds the pan: z its normal, origin on its floor.
        guarded: Points whose speeds are told; the first counts as elbow, the last as forearm.
        home: Where it is at first [rad]; seven.
        drives: "wam", its cables and motors, or "direct": what the URDF says.

    Raises:
        ValueError: Not seven joints, or no guarded point.
    """

    urdf: str = "urdf/wam7.urdf"
    joints: tuple[str, ...] = JOINTS
    tool: str = "pan"
    guarded: tuple[Guarded, ...] = WAM_GUARDED
    home: tuple[float, ...] = tuple(HOME)
    drives: Literal["wam", "direct"] = "wam"

    def __post_init__(self) -> None:
        for name in ("joints", "home"):
            if len(getattr(self, name)) != N:
                raise ValueError(f"{name} {getattr(self, name)} must be {N}")
        if not self.guarded:
            raise ValueError("the stand-in tells the speed of at least one guarded point")


@dataclass(frozen=True)
class WorldSettings:
    """Choices of the stand-in; the defaults are the arm as it is.

    Attributes:
        bus_voltage: Of the motors [V].
        command_delay_ticks: Control periods from a state to the torque that answers it.
        pancake_offset_sd: Of where the pancake lies in the pan, an axis [m].
        wind_sd: Of a steady draught a rollout, an axis [m/s].
        torque_scale_sd: Of each joint's torque constant a rollout, as a share.
        friction_sd: Of each joint's Coulomb friction a rollout, as a share.
        friction_share: Of the URDF's Coulomb friction that the joints have.
        driver_compensates_gravity: The arm adds g(q) to what is commanded.
        watchdog: The arm carries itself after 10 ms without a command; else it holds the last one.
        watchdog_damping: Of that fallback [1/s].
        scene: What there is.
        mocap: How it is seen.
        arm: Which arm.

    Raises:
        ValueError: A value out of range.
    """

    bus_voltage: float = 48.0
    command_delay_ticks: int = 2
    pancake_offset_sd: float = 0.003
    wind_sd: float = 0.1
    torque_scale_sd: float = 0.01
    friction_sd: float = 0.1
    friction_share: float = 1.0
    driver_compensates_gravity: bool = False
    watchdog: bool = True
    watchdog_damping: float = 5.0
    scene: SceneSettings = field(default_factory=SceneSettings)
    mocap: MocapSettings = field(default_factory=MocapSettings)
    arm: ArmSettings = field(default_factory=ArmSettings)

    def __post_init__(self) -> None:
        if not 0 <= self.command_delay_ticks <= 50:
            raise ValueError(f"command_delay_ticks {self.command_delay_ticks} must be 0 to 50")
        for name in (
            "pancake_offset_sd",
            "wind_sd",
            "torque_scale_sd",
            "friction_sd",
            "friction_share",
        ):
            if not 0.0 <= getattr(self, name) < 10.0:
                raise ValueError(f"{name} {getattr(self, name)} must be from 0 to below 10")
        if not 0.0 <= self.watchdog_damping <= 100.0:
            raise ValueError(f"watchdog_damping {self.watchdog_damping} must be 0 to 100")


class JointSample(NamedTuple):
    """What the arm's driver reports, once a tick."""

    stamp_ns: int
    q: np.ndarray  # (7,) [rad]
    qd: np.ndarray  # (7,) [rad/s]
    tau: np.ndarray  # (7,) commanded, the driver's own gravity torque included [N m]


@dataclass(frozen=True)
class Truth:
    """What really happened since a release (in its first 10 s), seen by nobody but the simulator.

    Attributes:
        id: Of the rollout.
        caught: The pancake lies flat on the pan's floor now (centre under 12 mm, |cos| over .98).
        flipped: It lies on its other side.
        tossed: It rose over `DELTA_H` and fell through it again.
        t_f: When it fell through [s since the release]; None when not tossed.
        angle_deg: Turned from rest until then, about the axis of the throw, beyond half a turn as
            well [degrees].
        true_flip: Caught, flipped, and turned by 150 to 240 degrees in the air.
        apex: Highest point over the pan's height at the start [m].
        landing_error: Pancake less pan at t_f, along x and y [m]; two.
        peak_qd: [rad/s]; seven.
        peak_tau: Of what the motors gave [N m]; seven.
        peak_elbow_speed: [m/s].
        peak_forearm_speed: 350 mm beyond the elbow [m/s].
        peak_pan_speed: [m/s].
        beyond_no_load: A motor was turned faster than its bus voltage turns it unloaded.
        saturated: Share of ticks in which a motor could not give what was commanded.
    """

    id: str
    caught: bool
    flipped: bool
    tossed: bool
    t_f: float | None
    angle_deg: float
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
    """One arm, one pan, one pancake.

    Attributes:
        time_ns: Now [ns].
        frozen: The clock and the cameras go on, physics, encoders and commands wait for `release`.
        idle: The motors are shorted and commands have no effect.
        urdf: Text of the arm's description.
        motors: The torque-speed envelope.
        trace: Positions of joints and pancake since the release, 100 a second, once it is set to
            []; None keeps none.

    Args:
        settings: None for the defaults.
        seed: Of every noise.
    """

    def __init__(self, settings: WorldSettings | None = None, seed: int = 0) -> None:
        self.settings = settings = settings or WorldSettings()
        self.seed = seed
        arm = settings.arm
        self.urdf = share(arm.urdf).read_text()
        self.model = model = scene.build(self.urdf, settings.scene, arm.tool, arm.guarded)
        self.data = data = mujoco.MjData(model)
        # the driver's own idea of gravity
        self._arm = Arm(self.urdf, arm.joints, arm.tool, guarded=arm.guarded)
        self._substeps = round(PERIOD / settings.scene.timestep)
        self.motors: Motors | DirectDrives = Motors(settings.bus_voltage)
        self._encoders = Encoders(PERIOD)
        if arm.drives == "direct":
            self.motors = DirectDrives(self._arm.tau_max, self._arm.qd_max)
            self._encoders = Encoders(PERIOD, counted=joint_counts)
        self._mocap = Mocap(np.asarray(LAYOUT), settings.mocap)
        self._pan = model.body(arm.tool).id
        self._told = [model.site(name).id for name in (*(p.name for p in arm.guarded), "pan")]
        self._friction = settings.friction_share * model.dof_frictionloss[:N]
        self._watchdog_damping = (settings.watchdog_damping * model.dof_M0[:N]).tolist()
        # views into MuJoCo's own arrays
        self._qpos, self._qvel = data.qpos, data.qvel
        self._q, self._qd, self._applied = data.qpos[:N], data.qvel[:N], data.qfrc_applied[:N]
        self._pancake_q = data.qpos[N:]
        self._pan_position = data.xpos[self._pan]
        self._pan_rotation = data.xmat[self._pan].reshape(3, 3)
        self._sites = data.site_xpos
        self._velocity = np.zeros(6)
        # what happened, one row a tick
        self._log_q = np.empty((_LOG_TICKS, model.nq))
        self._log_v = np.empty((_LOG_TICKS, model.nv))
        self._log_tau = np.empty((_LOG_TICKS, N))
        self._log_sites = np.empty((_LOG_TICKS, *self._sites.shape))

        self.time_ns = PERIOD_NS
        self.frozen = False
        self.idle = False
        self.trace: list[np.ndarray] | None = None
        self._delayed: deque[list[float] | None] = deque()
        self.reset("start", np.array(arm.home))
        self.release()

    def reset(self, rollout_id: str, q_start: np.ndarray) -> None:
        """Put the arm at rest and the pancake at rest in the pan, and freeze them.

        What follows the release depends on the seed and `rollout_id` alone.

        Args:
            rollout_id: A name; what ends in `QUIET` has no noise but that of the cameras.
            q_start: [rad]. Shape (7,).

        Raises:
            ValueError: A joint is not finite or outside its limits.
        """
        deque(self.resetting(rollout_id, q_start), maxlen=0)

    def resetting(self, rollout_id: str, q_start: np.ndarray) -> Iterator[None]:
        """`reset` in slices, for a world whose clock may not wait: frozen from the first on.

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
        key = [self.seed, zlib.crc32(rollout_id.encode())]
        rng = np.random.default_rng(key)
        self._mocap_rng = np.random.default_rng([*key, 1])
        self.rollout_id = rollout_id
        settings, model, data = self.settings, self.model, self.data
        loud = 0.0 if rollout_id.endswith(QUIET) else 1.0
        offset = loud * settings.pancake_offset_sd * rng.standard_normal(2)
        wind = loud * settings.wind_sd * rng.standard_normal(3)
        scale = 1.0 + loud * settings.torque_scale_sd * rng.standard_normal(N)
        friction = 1.0 + loud * settings.friction_sd * rng.standard_normal(N)
        self._torque_scale: list[float] = scale.tolist()
        model.dof_frictionloss[:N] = self._friction * np.maximum(friction, 0.0)
        model.opt.wind[:] = 0.0

        mujoco.mj_resetData(model, data)
        self._q[:] = q_start
        mujoco.mj_kinematics(model, data)
        self._pancake_q[:3] = self._pan_position + self._pan_rotation @ [*offset, 0.003]
        mujoco.mju_mat2Quat(self._pancake_q[3:], data.xmat[self._pan])
        gravity = self._arm.gravity(q_start)
        self._applied[:] = gravity
        for step in range(1, _SETTLE_STEPS + 1):
            mujoco.mj_step(model, data)
            self._q[:] = q_start
            self._qd[:] = 0.0
            if step % _SETTLE_LOOK == 0 and np.abs(data.qvel[N:]).max() < _SETTLED:
                break
            if step % _SETTLE_SLICE == 0:
                yield
        data.qvel[:] = 0.0
        model.opt.wind[:] = wind
        mujoco.mj_forward(model, data)

        self._encoders.reset(q_start.tolist())
        self._mocap.forget()
        self._command = [0.0] * N if settings.driver_compensates_gravity else gravity.tolist()
        self._effort: list[float] = gravity.tolist()
        self._delayed = deque([self._command] * settings.command_delay_ticks)
        self._since_command = 0
        self._puller: Puller | None = None
        self._puller_start_ns = 0
        self.idle = False
        self.frozen = True
        self._restart_log()

    def release(self) -> None:
        """Let the physics go on from the frozen state."""
        self.frozen = False
        self._mocap.restart(self.time_ns, self._mocap_rng)
        self._restart_log()

    def attach(self, puller: Puller) -> None:
        """Let something pull at the pan from now on."""
        self._puller, self._puller_start_ns = puller, self.time_ns

    def drop(self, height: float = 0.7) -> None:
        """Let the pancake fall, edge first, from a height over the pan [m]: drag is least so."""
        self._pancake_q[:] = [*self._pan_position, math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0]
        self._pancake_q[2] += height
        self._qvel[N:] = 0.0

    @property
    def pulled(self) -> bool:
        """Whether something still pulls at the pan."""
        return self._puller is not None

    @property
    def pan_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) [m] and rotation (3, 3) of the pan."""
        return self._pan_position.copy(), self._pan_rotation.copy()

    def joint_state(self) -> JointSample:
        """The joints as sensed now."""
        encoders = self._encoders
        return JointSample(
            self.time_ns, np.array(encoders.q), np.array(encoders.qd), np.array(self._effort)
        )

    def mocap_frames(self) -> list[MocapFrame]:
        """Frames that have come in since the last call."""
        return self._mocap.delivered(self.time_ns)

    def step(self, tau_cmd: np.ndarray | None) -> None:
        """One tick of 2 ms.

        Args:
            tau_cmd: Commanded torques (7,) [N m], or None when no command has come: the last one
                holds, with a watchdog for 10 ms; then the arm compensates its own gravity, damped.

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
            self._advance()
            self._encoders.read(self._q.tolist())
            self._record()
        if self._mocap.due(self.time_ns):
            self._mocap.expose(self.time_ns, self._pancake_q[:3].copy(), self._pancake_rotation())

    def _advance(self) -> None:
        """Motors and physics of one tick."""
        qd = self._qd.tolist()
        if self.idle:
            self._effort = [0.0] * N
            self._applied[:] = self.motors.braking(qd)
        else:
            wanted = self._wanted()
            self._effort = wanted
            given = self.motors.limit(wanted, qd)
            self._saturated += given is not wanted
            self._applied[:] = [a * b for a, b in zip(given, self._torque_scale, strict=True)]
        if self._puller is None:
            mujoco.mj_step(self.model, self.data, self._substeps)
        else:
            for substep in range(self._substeps):
                self._pull(substep)

    def _wanted(self) -> list[float]:
        """Torques the driver asks of the motors."""
        if self.settings.watchdog and self._since_command > _WATCHDOG_TICKS:
            damped = zip(self._gravity(), self._watchdog_damping, self._encoders.qd, strict=True)
            return [g - d * qd for g, d, qd in damped]
        if self.settings.driver_compensates_gravity:
            return [a + b for a, b in zip(self._command, self._gravity(), strict=True)]
        return self._command

    def _gravity(self) -> list[float]:
        return self._arm.gravity(np.array(self._encoders.q)).tolist()

    def _pull(self, substep: int) -> None:
        """One physics step under the hand's wrench."""
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        if self._puller is not None:
            mujoco.mj_objectVelocity(
                model, data, mujoco.mjtObj.mjOBJ_XBODY, self._pan, self._velocity, 0
            )
            elapsed = (self.time_ns - PERIOD_NS - self._puller_start_ns) * 1e-9
            wrench = self._puller.wrench(
                elapsed + substep * self.settings.scene.timestep,
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

    def _pancake_rotation(self) -> np.ndarray:
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, self._pancake_q[3:])
        return matrix.reshape(3, 3)

    # What really happened

    def _restart_log(self) -> None:
        self._rows = 0
        self._saturated = 0
        if self.trace is not None:
            self.trace.clear()
        self._pan_start = self._pan_position.copy()
        self._normal_start = self._pancake_rotation()[:, 2].copy()

    def _record(self) -> None:
        row = self._rows
        if row == _LOG_TICKS:
            return
        if self.trace is not None and row % _TRACE_TICKS == 0:
            self.trace.append(self._qpos.copy())
        self._log_q[row] = self._qpos
        self._log_v[row] = self._qvel
        self._log_tau[row] = self._applied
        self._log_sites[row] = self._sites
        self._rows = row + 1

    def truth(self) -> Truth:
        """What has happened since the release."""
        rows = self._rows
        height = self._log_q[:rows, N + 2]
        pan = self._log_sites[:rows, self._told[-1]]
        error, angle, t_f = [0.0, 0.0], 0.0, None
        at = _fallen(height - pan[:, 2])
        if at is not None:
            t_f = (at + 1) * PERIOD
            error = (self._log_q[at, N : N + 2] - pan[at, :2]).tolist()
            angle = math.degrees(self._turned(at))
        speeds = np.zeros(len(self._told))
        if rows > 1:
            steps = np.diff(self._log_sites[:rows, self._told], axis=0)
            speeds = np.linalg.norm(steps, axis=2).max(axis=0) / PERIOD
        qd = self._log_v[:rows, :N]
        motor_speeds = np.abs(qd @ self.motors.of_joints.T).max(axis=0, initial=0.0)
        caught, flipped = self._lies()
        return Truth(
            id=self.rollout_id,
            caught=caught,
            flipped=flipped,
            tossed=at is not None,
            t_f=t_f,
            angle_deg=angle,
            true_flip=caught and flipped and 150.0 <= angle <= 240.0,
            apex=float(height.max(initial=self._pan_start[2]) - self._pan_start[2]),
            landing_error=error,
            peak_qd=np.abs(qd).max(axis=0, initial=0.0).tolist(),
            peak_tau=np.abs(self._log_tau[:rows]).max(axis=0, initial=0.0).tolist(),
            peak_elbow_speed=float(speeds[0]),
            peak_forearm_speed=float(speeds[-2]),
            peak_pan_speed=float(speeds[-1]),
            beyond_no_load=bool((motor_speeds > self.motors.motor_no_load_speed).any()),
            saturated=self._saturated / max(rows, 1),
        )

    def _lies(self) -> tuple[bool, bool]:
        """Whether the pancake lies flat in the pan, and on its other side."""
        position, pan = self._arm.tool_pose(self._q)
        x, y, z = (pan.T @ (self._pancake_q[:3] - position)).tolist()
        cosine = float(self._pancake_rotation()[:, 2] @ pan[:, 2])
        flat = abs(z) < 0.012 and abs(cosine) > 0.98 and math.hypot(x, y) < scene.PAN_RADIUS
        return flat, cosine < 0.0

    def _turned(self, end: int) -> float:
        """Angle of the pancake's normal from the release to a row of the log, unfolded [rad]."""
        quat_xyzw = self._log_q[: end + 1, [N + 4, N + 5, N + 6, N + 3]]
        x, y, z, w = quat_xyzw.T
        normals = np.stack(
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1
        )
        begin = max(0, end - round(0.1 / PERIOD))  # the last 0.1 s of the flight
        omega = rotations.matrix(quat_xyzw[begin:]) @ self._log_v[begin : end + 1, N + 3 :, None]
        axis = omega.mean(axis=0)[:, 0]
        axis -= (axis @ self._normal_start) * self._normal_start  # a disc may spin on itself
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            return 0.0
        axis /= length
        across = np.cross(axis, self._normal_start)
        return float(np.unwrap(np.arctan2(normals @ across, normals @ self._normal_start))[-1])


def _fallen(height: np.ndarray) -> int | None:
    """First index after the highest point at which a height is under `DELTA_H`, if it ever rose."""
    risen = np.flatnonzero(height > DELTA_H)
    if len(risen) == 0:
        return None
    up = int(risen[0])
    down = np.flatnonzero(height[up:] < DELTA_H)
    stop = up + int(down[0]) if len(down) else len(height)
    apex = up + int(np.argmax(height[up:stop]))
    under = np.flatnonzero(height[apex:] < DELTA_H)
    return apex + int(under[0]) if len(under) else None
