# SPDX-License-Identifier: Apache-2.0
"""Runs of each study."""
