# SPDX-License-Identifier: Apache-2.0
"""Another demonstration in the middle of a session, from the page: pause, lead, learn, go on.

The arm is let go only after the learner has said that it is paused and no trial is under way: from
then on it sends nothing until it is told to go on.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from wam_power_ros.ros import interface
from wam_power_ros.ros.answers import Answer, Code

PATIENCE = 60.0  # for a service to agree [s of wall time]
RETRY_PERIOD = 0.2  # [s of wall time]


class Services(Protocol):
    """The part of `live.View` that is needed."""

    reset: str

    def offered(self, name: str) -> bool:
        """See `live.View`."""

    def ask(self, name: str, on: bool | None = None) -> Answer:
        """See `live.View`."""

    def name_bag(self, bag: Path) -> None:
        """See `live.View`."""


class NotTaughtError(RuntimeError):
    """The demonstration could not be given; the message says why. The learner may be paused."""


def begin(
    services: Services,
    tell: Callable[[str], object],
    patience: float = PATIENCE,
) -> None:
    """Pause the learner, let go of the arm and begin to record.

    Args:
        services: Services of the session.
        tell: Takes a line about what is waited for.
        patience: Longest wait for a service to agree [s of wall time].

    Raises:
        NotTaughtError: A service refused, or the trial did not end.
    """
    end = time.monotonic() + patience
    answer = _insist(services, interface.LEARNER_PAUSE, True, patience)
    tell(answer.text)
    while answer.values.get("trial") != "over":
        if time.monotonic() > end:
            raise NotTaughtError(f"no trial ended in {patience:.0f} s; the learner is paused")
        time.sleep(RETRY_PERIOD)
        answer = _insist(services, interface.LEARNER_PAUSE, True, patience)
    _insist(services, interface.GRAVITY_COMPENSATION, True, patience)
    try:
        if services.offered(interface.DEMONSTRATE):  # the stand-in: arm and body back to the start
            _insist(services, services.reset, None, patience)
        _insist(services, interface.RECORD, True, patience)
        if services.offered(interface.DEMONSTRATE):
            tell("the simulated demonstrator leads the arm")
            _insist(services, interface.DEMONSTRATE, None, patience)
        else:
            tell("lead the arm, then press End of movement")
    except NotTaughtError:
        services.ask(interface.RECORD, False)
        services.ask(interface.GRAVITY_COMPENSATION, False)  # an arm that nobody leads holds
        raise


def finish(services: Services, patience: float = PATIENCE) -> str:
    """End the recording, hold the arm, give the bag to the learner and let it go on.

    Returns:
        The learner's answer.

    Raises:
        NotTaughtError: A service refused; the learner's reason, if it was its.
    """
    try:
        bag = Path(_insist(services, interface.RECORD, False, patience).text)
    finally:
        _insist(services, interface.GRAVITY_COMPENSATION, False, patience)
    services.name_bag(bag.resolve())
    end = time.monotonic() + patience
    while True:  # topics and services are not ordered: the name of the bag may still come
        answer = services.ask(interface.LEARNER_DEMONSTRATION)
        if answer.code is not Code.NOTHING or time.monotonic() > end:
            break
        time.sleep(RETRY_PERIOD)
    _insist(services, interface.LEARNER_PAUSE, False, patience)
    if not answer.success:
        raise NotTaughtError(answer.text)
    return answer.text


def _insist(services: Services, name: str, on: bool | None, patience: float) -> Answer:
    end = time.monotonic() + patience
    while True:
        answer = services.ask(name, on)
        if answer.success:
            return answer
        if time.monotonic() > end:
            raise NotTaughtError(f"{name}: {answer.text}")
        time.sleep(RETRY_PERIOD)
