# SPDX-License-Identifier: Apache-2.0
"""Reaching around an obstacle (Eq. 4)."""
