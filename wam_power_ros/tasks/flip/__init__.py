# SPDX-License-Identifier: Apache-2.0
"""Flipping a pancake (Eq. 5, and a return for a full flip that lands in the pan)."""
