# SPDX-License-Identifier: Apache-2.0
"""Record a series of kinesthetic demonstrations under gravity compensation.

The teacher is a person, who presses Enter, or the demonstrator of the stand-in. When the series is
complete, the paths of its bags are written as a JSON list.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from pydantic import Field
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.console.prompt import ask, show
from wam_power_ros.params.node_params import Params
from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import run_script
from wam_power_ros.ros.service_client import TIMEOUT, ServiceClient, ServiceError

RECORDER = "demonstration_recorder"


class TeachParams(Params):
    """Parameters of a series.

    Attributes:
        demonstrations: Number of demonstrations to record.
        series: File to which the list of bags is written.
        person: Whether a person leads the arm; otherwise the demonstrator of the stand-in does.
        body: Name of the tracked body; empty for none.
        state_topic: Topic of the joint states, to which the recorder subscribes.
    """

    demonstrations: int = Field(ge=1, le=100, description="a person's patience")
    series: str
    person: bool
    body: str
    state_topic: str


class Teach(Node):
    """Calls the services of controller, recorder and demonstrator in turn."""

    def __init__(self) -> None:
        super().__init__("teaching", automatically_declare_parameters_from_overrides=True)
        self._params = TeachParams.of(self)
        self._calls = ServiceClient(self)

    def run(self) -> None:
        """Record the series; the arm holds its position afterwards.

        Raises:
            ServiceError: A service does not appear, does not answer in time, or refuses.
        """
        params, insist = self._params, self._calls.insist
        insist(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=True))
        if not params.person:  # a person takes longer than any node does
            self._wait_for_recorder()
        bags = []
        for number in range(1, params.demonstrations + 1):
            if params.person:
                self._ask(f"demonstration {number}: press Enter, then lead the arm ")
            else:  # arm and body back to the start
                insist(Trigger, interface.body_topic(params.body, "reset"))
            insist(SetBool, interface.RECORD, SetBool.Request(data=True))
            if params.person:
                self._ask("press Enter when the movement is over ")
            else:
                insist(Trigger, interface.DEMONSTRATE)
            bags.append(insist(SetBool, interface.RECORD, SetBool.Request(data=False)).text)
            show(f"  {number} of {params.demonstrations}: {bags[-1]}")
        insist(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=False))
        Path(params.series).write_text(json.dumps(bags))

    def _wait_for_recorder(self) -> None:
        """Wait until the recorder is subscribed: it offers its service earlier than that."""
        end = time.monotonic() + TIMEOUT
        while not any(
            info.node_name == RECORDER
            for info in self.get_subscriptions_info_by_topic(self._params.state_topic)
        ):
            if time.monotonic() > end:
                raise ServiceError(f"{RECORDER} did not subscribe within {TIMEOUT:.0f} s")
            time.sleep(0.05)

    def _ask(self, text: str) -> None:
        if not ask(text):
            raise ServiceError("no answer: standard input is closed")


def main() -> int:
    """Entry point of `python -m wam_power_ros.console.teach`."""
    return run_script(Teach, Teach.run)


if __name__ == "__main__":
    sys.exit(main())
