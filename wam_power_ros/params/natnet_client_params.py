# SPDX-License-Identifier: Apache-2.0
"""Parameters of the NatNet client."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from wam_power_ros.params.node_params import Params

Address = Annotated[str, Field(pattern=r"^\d+\.\d+\.\d+\.\d+$", description="as 192.168.1.2")]
Port = Annotated[int, Field(ge=1, le=65_535)]


class NatNetClientParams(Params):
    """Parameters of the node; the values are in config/natnet_client.yaml."""

    file = "natnet_client.yaml"

    body: str
    server: Address
    local: Address
    multicast: bool
    group: Address
    command_port: Port
    data_port: Port
    frame: str
