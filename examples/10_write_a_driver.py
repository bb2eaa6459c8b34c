# SPDX-License-Identifier: Apache-2.0
"""A driver: 500 joint states a second out, torques in, a watchdog; here of a rigid-body model."""

import contextlib
import time

import numpy as np
import pinocchio as pin
import rclpy
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from wam_power_ros.params.resources import share

PERIOD, WATCHDOG = 0.002, 0.02  # [s]
model = pin.buildModelFromUrdf(str(share("urdf/wam7.urdf")))
model.armature = PERIOD * model.damping  # damps implicitly; joints as light as these need it
data, names = model.createData(), list(model.names)[1:]
q, qd = np.deg2rad([0.0, 20.0, 0.0, 115.0, 0.0, -45.0, 0.0]), np.zeros(model.nv)
tau, came = np.zeros(model.nv), 0.0  # last torque [N m], and when it came


def on_torque(message: Float64MultiArray) -> None:
    """Take a torque whole, or not at all."""
    global tau, came
    if len(message.data) == model.nv and np.isfinite(message.data).all():
        tau, came = np.array(message.data), time.monotonic()


def step() -> None:
    """Your bus or simulator: send the torque, read angles [rad] and speeds [rad/s]."""
    global q, qd, now
    mass = pin.crba(model, data, q)
    carry = pin.computeGeneralizedGravity(model, data, q) - 5.0 * mass @ qd  # and brake, in 0.2 s
    torque = tau if time.monotonic() - came < WATCHDOG else carry
    qd = qd + PERIOD * pin.aba(model, data, q, qd, torque - model.damping * qd)
    q = q + PERIOD * qd
    state = JointState(name=names, position=q.tolist(), velocity=qd.tolist())
    state.effort = torque.tolist()
    now += Duration(seconds=PERIOD)  # a bus: node.get_clock().now(), when it was measured
    state.header.stamp = now.to_msg()
    states.publish(state)


rclpy.init()
node = rclpy.create_node("my_driver")
now = node.get_clock().now()
states = node.create_publisher(JointState, "joint_states", 10)
node.create_subscription(Float64MultiArray, "effort_controller/commands", on_torque, 1)
node.create_timer(PERIOD, step)
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):  # Ctrl-C
    rclpy.spin(node)
