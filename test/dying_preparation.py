# SPDX-License-Identifier: Apache-2.0
"""A preparation process that dies of what it reads."""

from wam_power_ros.nodes.preparation import channel_of_process

channel = channel_of_process()
channel.receive()
channel.send({"what": "reading", "id": "7"})
