# SPDX-License-Identifier: Apache-2.0
"""A preparation process that dies of what it reads; the next one tells what it was told."""

from wam_power_ros.nodes.preparation import POLICY, channel_of_process

channel = channel_of_process()
values = channel.receive().values
if values["seen"]:
    channel.send({"what": "refused", "kind": "seen", "text": str(values["seen"])})
    channel.receive()
channel.send({"what": "reading", "kind": POLICY, "stamp": 7})
