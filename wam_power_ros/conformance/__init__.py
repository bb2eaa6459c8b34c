# SPDX-License-Identifier: Apache-2.0
"""Checks that a driver behaves as its set-up says. Pure."""
