# SPDX-License-Identifier: Apache-2.0
"""What the nodes share: names, QoS, message conversion, scheduling, service calls, security."""
