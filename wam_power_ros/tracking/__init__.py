# SPDX-License-Identifier: Apache-2.0
"""Tracking of a rigid body in motion capture: frame checks, state, marker fit. Pure."""
