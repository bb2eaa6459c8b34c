# SPDX-License-Identifier: Apache-2.0
"""Commissioning: what an arm measures of itself and of its cameras before it learns; no ROS."""
