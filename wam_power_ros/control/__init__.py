# SPDX-License-Identifier: Apache-2.0
"""Arm model, torque laws, safety limits and the torque controller. Pure: no ROS, file or clock."""
