# SPDX-License-Identifier: Apache-2.0
"""The course of a session: which policy is tried next, and its log on disk."""
