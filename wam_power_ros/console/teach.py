# SPDX-License-Identifier: Apache-2.0
"""Record a series of kinesthetic demonstrations under gravity compensation.

The teacher is a person, who presses Enter, or the demonstrator of the stand-in. Every take is added
to the list of bags in a file at once. In a review after each take, a person may repeat or discard
it, or end the series.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports, which a signal may interrupt
    from wam_power_ros.entry import INTERRUPTED, start

    raise SystemExit(start("wam_power_ros.console.teach", INTERRUPTED))

from pathlib import Path

from pydantic import Field
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from wam_power_ros.bags import series
from wam_power_ros.console.prompt import ask, choose, cue, show
from wam_power_ros.params.node_params import Params
from wam_power_ros.ros import interface
from wam_power_ros.ros.node_runner import run_script
from wam_power_ros.ros.service_client import LOG_AFTER, TIMEOUT, ServiceClient, ServiceError

RECORDER = "demonstration_recorder"
KEEP, AGAIN, DISCARD, DONE = "keep", "again", "discard", "done"
KEYS = {"a": AGAIN, "d": DISCARD, "q": DONE}


class TeachParams(Params):
    """Parameters of a series.

    Attributes:
        demonstrations: Number of demonstrations to record.
        series: File with the list of bags, to which new ones are added.
        person: True if a person guides the arm by hand, False for the demonstrator of the stand-in.
        review: True to ask a person after each take to keep, repeat or discard it.
        bell: True for a cue at begin and end of a recording, see `prompt.cue`.
        body: Name of the tracked body; "" for none.
        state_topic: Topic of the joint states, to which the recorder subscribes.
    """

    demonstrations: int = Field(ge=1, le=100, description="a person's patience")
    series: str
    person: bool
    review: bool
    bell: bool
    body: str
    state_topic: str


class Teach(Node):
    """Calls the services of controller, recorder and demonstrator in turn."""

    def __init__(self) -> None:
        super().__init__("teaching", automatically_declare_parameters_from_overrides=True)
        self._params = TeachParams.of(self)
        self._calls = ServiceClient(self, log_period=LOG_AFTER)

    def run(self) -> None:
        """Record the series; the arm holds its position afterwards.

        Raises:
            ServiceError: A service does not appear, does not answer in time, or refuses.
        """
        params, insist = self._params, self._calls.insist
        insist(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=True))
        if not params.person:  # a person is slower than the start of any node
            self._wait_for_recorder()
        file = Path(params.series)
        bags, number, wanted = series.read(file), 1, params.demonstrations
        while number <= wanted:
            bag = self._take(number)
            bags.append(bag)
            series.write(file, bags)  # at once: kept even if interrupted
            show(f"  {number} of {wanted}: {bag}")
            choice = choose(KEEP, KEYS) if params.review else KEEP
            if choice in (AGAIN, DISCARD):
                bags.pop()
                show(f"  discarded; moved to {series.discard(bag)}")
            wanted = {DONE: number, DISCARD: wanted - 1}.get(choice, wanted)
            number += choice in (KEEP, DONE)
        insist(SetBool, interface.GRAVITY_COMPENSATION, SetBool.Request(data=False))

    def _take(self, number: int) -> Path:
        """Record one demonstration; returns the path of its bag."""
        params, insist = self._params, self._calls.insist
        if params.person:
            self._ask(f"demonstration {number}: press Enter, then guide the arm by hand ")
        else:  # arm and body back to the start
            insist(Trigger, interface.body_topic(params.body, "reset"))
        insist(SetBool, interface.RECORD, SetBool.Request(data=True))
        cue(params.bell, "recording")
        if params.person:
            self._ask("press Enter when the movement is over ")
        else:
            insist(Trigger, interface.DEMONSTRATE)
        bag = Path(insist(SetBool, interface.RECORD, SetBool.Request(data=False)).text)
        cue(params.bell, "recorded")
        return bag

    def _wait_for_recorder(self) -> None:
        """Wait until the recorder has subscribed, which may be later than its service appears."""
        if not self._calls.until(self._recorder_subscribed, f"the subscription of {RECORDER}"):
            raise ServiceError(f"{RECORDER} did not subscribe within {TIMEOUT:.0f} s")

    def _recorder_subscribed(self) -> bool:
        infos = self.get_subscriptions_info_by_topic(self._params.state_topic)
        return RECORDER in {info.node_name for info in infos}

    def _ask(self, text: str) -> None:
        if not ask(text):
            raise ServiceError("no answer: standard input is closed")


def main() -> int:
    """Run `python -m wam_power_ros.console.teach`."""
    return run_script(Teach, Teach.run)
