# SPDX-License-Identifier: Apache-2.0
"""A rigid body in motion capture: filter, marker fit. Pure."""
