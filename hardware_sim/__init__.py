# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for the WAM and for OptiTrack: topics, rates, stamps and watchdogs of the drivers."""
