# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for the WAM and for OptiTrack: same topics, rates, stamps and watchdogs as the drivers."""
