# SPDX-License-Identifier: Apache-2.0
"""The ROS nodes: message -> validated arrays -> one core call -> message."""
