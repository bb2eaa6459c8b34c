# SPDX-License-Identifier: Apache-2.0
"""Checks that a driver conforms to its set-up. Pure: no ROS, file or clock."""
