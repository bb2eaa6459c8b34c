# SPDX-License-Identifier: Apache-2.0
"""ROS scripts that a person runs: teach, replay, play a bag, enabling switch, feedback."""
