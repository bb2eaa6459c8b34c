# SPDX-License-Identifier: Apache-2.0
"""ROS parameters -> one frozen object; values live in YAML only, so a missing key stops the node.

A node subclasses `Params` with typed, bounded fields and no defaults, is constructed with
`automatically_declare_parameters_from_overrides=True`, and reads once: `MyParams.of(self)`.
"""

from __future__ import annotations

from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

P = TypeVar("P", bound="Params")
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class Params(BaseModel):
    """Parameters of a node: strictly typed, finite, frozen; lists come as tuples."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @classmethod
    def of(cls: type[P], node: Node) -> P:
        """Read the parameters of `node`, which refuses later changes to them.

        Raises:
            ValueError: naming every key that is missing, unknown, of a wrong type or out of range.
        """
        given = node.get_parameters_by_prefix("").items()
        values = {
            name: parameter.value
            if isinstance(parameter.value, (bool, int, float, str))
            else tuple(parameter.value or ())
            for name, parameter in given
            if not name.startswith(OF_ROS)
        }
        try:
            params = cls(**values)
        except ValidationError as error:
            faults = "; ".join(
                f"{'.'.join(map(str, fault['loc'])) or 'all'}: {fault['msg']}"
                for fault in error.errors()
            )
            raise ValueError(f"parameters of {node.get_name()} refused: {faults}") from None
        node.add_on_set_parameters_callback(_refuse)
        return params


def _refuse(parameters: list[Parameter]) -> SetParametersResult:
    fixed = [parameter.name for parameter in parameters if not parameter.name.startswith(OF_ROS)]
    reason = f"{fixed} are read at start: change the YAML and start the node again"
    return SetParametersResult(successful=not fixed, reason=reason if fixed else "")
