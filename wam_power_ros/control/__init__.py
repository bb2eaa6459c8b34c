# SPDX-License-Identifier: Apache-2.0
"""The arm, the torque law, the limits, and the controller that applies them. Pure."""
