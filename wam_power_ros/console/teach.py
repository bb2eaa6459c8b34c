# SPDX-License-Identifier: Apache-2.0
"""A series of kinesthetic demonstrations: the arm is made weightless, each movement recorded.

The hand is a person, who presses Enter, or the stand-in's. When the series is complete the paths of
its bags are written as a JSON list.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import rclpy
from pydantic import Field
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.params.node_params import Params
from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import number_by_process
from wam_power_ros.ros.service_client import TIMEOUT, ServiceCalls, ServiceError

RECORDER = "demonstration_recorder"


class TeachingParams(Params):
    """Parameters of the series."""

    demonstrations: int = Field(ge=1)
    series: str  # file to write the list of bags to
    person: bool  # a person leads the arm; otherwise the stand-in's hand does
    body: str  # that is tracked; empty: none
    state_topic: str  # that the recorder listens to


class Teaching(Node):
    """Calls the services of controller, recorder and hand in turn."""

    def __init__(self) -> None:
        super().__init__("teaching", automatically_declare_parameters_from_overrides=True)
        self.params = TeachingParams.of(self)
        self._calls = ServiceCalls(self)

    def teach(self) -> None:
        """Record the series; the arm holds its position afterwards.

        Raises:
            ServiceError: A service does not appear, does not answer in time, or refuses.
        """
        self._calls.insist(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=True))
        if not self.params.person:  # who takes longer than any node does
            self._wait_for_recorder()
        bags = []
        for number in range(1, self.params.demonstrations + 1):
            self._ask(f"demonstration {number}: press Enter, then lead the arm")
            if not self.params.person:  # back to the start, and the pancake into the pan
                self._calls.insist(
                    Trigger, interface.body_topic(self.params.body, "reset"), Trigger.Request()
                )
            self._calls.insist(SetBool, interface.RECORD, SetBool.Request(data=True))
            if self.params.person:
                self._ask("press Enter when the movement is over")
            else:
                self._calls.insist(Trigger, interface.HAND_DEMONSTRATE, Trigger.Request())
            bags.append(self._calls.insist(SetBool, interface.RECORD, SetBool.Request(data=False)))
            sys.stdout.write(f"  {number} of {self.params.demonstrations}: {bags[-1]}\n")
            sys.stdout.flush()
        self._calls.insist(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=False))
        Path(self.params.series).write_text(json.dumps(bags))

    def _wait_for_recorder(self) -> None:
        """A recorder that has just started offers its service before it hears the arm."""
        end = time.monotonic() + TIMEOUT
        while not any(
            info.node_name == RECORDER
            for info in self.get_subscriptions_info_by_topic(self.params.state_topic)
        ):
            if time.monotonic() > end:
                raise ServiceError(f"{RECORDER} did not listen in {TIMEOUT:.0f} s")
            time.sleep(0.05)

    def _ask(self, text: str) -> None:
        if self.params.person:
            sys.stderr.write(f"{text} ")
            sys.stderr.flush()
            if not sys.stdin.readline():
                raise ServiceError("nobody is at the keyboard: standard input is closed")


def main() -> int:
    """Entry point of `python -m wam_power_ros.console.teach`."""
    rclpy.init()
    try:
        with number_by_process():
            teaching = Teaching()
        teaching.teach()
    except (ServiceError, ValueError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        return 130
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
