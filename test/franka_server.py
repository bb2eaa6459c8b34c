# SPDX-License-Identifier: Apache-2.0
"""A process that is an FR3 at the level of its network protocol: franka-sim with our URDF.

`python franka_server.py ADDRESS` ends a motion as the robot does: after 20 lost cycles, a step of
torque, a limit. Each line on its input is answered by one: `reflex NUMBER` provokes an error of
libfranka, `stopped` and `released` are the person's switch, `freeze SECONDS` repeats the measured
posture, `push JOINT TORQUE SECONDS` is a hand, `lead FILE` one that guides the arm along a file's
rows of time and posture, `arm` asks for the true posture, speeds and mode.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from conftest import ROOT

IDLE, USER_STOPPED = 1, 5  # modes of the protocol
PRIORITY = 75  # a robot has a computer of its own
HAND = (
    np.array([300.0] * 4 + [60.0] * 3),
    np.array([40.0] * 4 + [4.0] * 3),
)  # [N m/rad], [N m s/rad]


def model() -> str:
    """Path of the arm as MuJoCo's XML, with the inertia of its rotors, which franka-sim wants."""
    from hardware_sim import scene

    names = [f"fr3_joint{number}" for number in range(1, 8)]
    spec = scene.arm((ROOT / "urdf/fr3.urdf").read_text(), names)
    spec.compile()
    file = Path(tempfile.mkdtemp()) / "fr3.xml"
    file.write_text(spec.to_xml())
    return str(file)


def main(address: str) -> None:
    """Serve until the input ends."""
    os.environ["FR3_MJCF"] = model()
    import mujoco

    if not hasattr(mujoco.MjSpec, "find_body"):  # franka-sim is written for MuJoCo 3.2
        mujoco.MjSpec.find_body = mujoco.MjSpec.body
        mujoco.MjsLight.directional = property(fset=lambda light, value: None)
    from franka_sim import FrankaSimServer
    from franka_sim.robot_state import RobotState

    enforced = {"enforce_comm_constraints": True, "enforce_motion_limits": True}
    server = FrankaSimServer(host=address, enable_gripper=False, **enforced)
    arm = server.physics_sim
    measure, driven = arm.get_robot_state, arm.arm_control_torque
    frozen, frozen_until, hand, hand_until = {}, 0.0, np.zeros(7), 0.0
    shown, shown_from = np.zeros((1, 8)), -1e9  # [s], [rad]: where a hand guides the arm
    switched = False  # the person's switch

    def measured() -> dict[str, object]:
        state = measure()
        if switched:  # whatever the client asks for
            server.robot_state.state["robot_mode"] = USER_STOPPED
        return {**state, **frozen} if time.monotonic() < frozen_until else state

    def driving() -> np.ndarray:
        tau = driven() + (hand if time.monotonic() < hand_until else 0.0)
        if (t := time.monotonic() - shown_from) < shown[-1, 0]:
            state = measure()
            wanted = np.array([np.interp(t, shown[:, 0], column) for column in shown.T[1:]])
            tau = tau + HAND[0] * (wanted - state["q"]) - HAND[1] * np.array(state["dq"])
        return tau

    begun = time.monotonic()

    def count(robot: RobotState) -> None:
        """Stamp a state [ms]: a robot's clock goes on while this machine stalls."""
        robot._message_id = max(robot._message_id + 1, int(1e3 * (time.monotonic() - begun)))
        robot.state["message_id"] = robot._message_id

    RobotState.update = count
    arm.get_robot_state, arm.arm_control_torque = measured, driving
    threading.Thread(target=server.start, daemon=True).start()
    with contextlib.suppress(PermissionError):
        for thread in os.listdir("/proc/self/task"):
            os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(PRIORITY))
    for line in sys.stdin:
        word, *values = line.split()
        if word == "reflex":
            server._abort_with_error(int(values[0]), "provoked")
        elif word == "stopped":
            switched = True
            server._abort_with_error((), "the user's stop")
        elif word == "released":
            switched = False
            server.robot_state.state["robot_mode"] = IDLE
        elif word == "freeze":
            frozen = {"q": measure()["q"], "dq": [0.0] * 7}
            frozen_until = time.monotonic() + float(values[0])
        elif word == "push":
            hand[:] = 0.0
            hand[int(values[0])], hand_until = float(values[1]), time.monotonic() + float(values[2])
        elif word == "lead":
            shown, shown_from = np.load(values[0]), time.monotonic()
        state, robot = measure() if arm.model else None, server.robot_state.state
        answer = state and {
            "q": [*map(float, state["q"])],
            "dq": [*map(float, state["dq"])],
            "mode": int(robot["robot_mode"]),
        }
        sys.stdout.write(f"{json.dumps(answer)}\n")
        sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1])
