# SPDX-License-Identifier: Apache-2.0
"""From bags to feasible policies: read demonstrations and fit policies to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from logging import Logger

from wam_power_ros.arm_identity import remark
from wam_power_ros.bags import quality
from wam_power_ros.bags.bag import Bag
from wam_power_ros.bags.reader import read_states
from wam_power_ros.learning.demonstration import Demonstration
from wam_power_ros.learning.policy import Policy
from wam_power_ros.params.simulated_arm import SimulatedArm
from wam_power_ros.practice.candidates import fitted
from wam_power_ros.practice.settings import SessionSettings
from wam_power_ros.tasks.task import Task


class Demonstrations:
    """Reads the demonstrations of one task by one arm, and fits policies to them."""

    def __init__(
        self, kind: type[Task], arm: SimulatedArm, joint_names: Sequence[str], log: Logger
    ) -> None:
        self._kind, self._arm, self._joint_names, self._log = kind, arm, joint_names, log

    def candidates(
        self, settings: SessionSettings, bags: Sequence[str]
    ) -> tuple[list[str], list[Demonstration], list[Policy]]:
        """Usable bags, their demonstrations and policies; a ValueError if nothing can be learnt."""
        if not bags:
            raise ValueError("a new session needs demonstrations: name at least one bag")
        read: dict[int, Demonstration] = {}
        left_out: dict[tuple[int, ...], str] = {}
        for number, bag in enumerate(bags, start=1):
            try:
                read[number] = self.read(bag)
            except ValueError as error:
                left_out[(number,)] = str(error)
        arm = self._arm
        candidates, why = fitted(self._kind, settings, read, arm, arm.identity, arm.region)
        for group, text in why.items():
            left_out[group] = f"{', '.join(bags[number - 1] for number in group)}: {text}"
        for group, text in left_out.items():
            self._log.warning(f"demonstration {', '.join(map(str, group))} left out: {text}")
        if not candidates:
            text = f"nothing can be learnt from any of {len(bags)} demonstrations"
            raise ValueError(
                f"{text} ({'; '.join(left_out.values())}). Teach others in a new session, or name "
                "other bags: wam-power learn --session ... --bags ..."
            )
        used = [number for group in candidates for number in group]
        named = [bags[number - 1] for number in used]
        return named, [read[number] for number in used], list(candidates.values())

    def read(self, path: str) -> Demonstration:
        """Read the movement in a bag; if there is none, a ValueError names the bag and reason."""
        identity = self._arm.identity
        try:
            bag = Bag(path)
            states = read_states(bag, self._joint_names, arm=identity)
            for found in states.remarks:
                self._log.info(f"{path}: {found.text}")
            if note := remark(bag.arm, identity):
                self._log.info(f"{path} {note}")
            read = self._kind.demonstration_of(self._arm.kinematics, states.stamps, states.q)
            for left_out in read.left_out:
                self._log.warning(
                    f"{path}: {quality.left_out_remark(*left_out).text}; to keep them, move "
                    "without stopping, or teach them as a demonstration of their own"
                )
            return read
        except (ValueError, OSError) as error:
            raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error

    def fit(self, demonstration: Demonstration, bag: str, policy_id: str, springs: int) -> Policy:
        """Fit a policy to a demonstration; on failure, a ValueError names the bag and reason."""
        try:
            policy = self._kind.policy_of([demonstration], policy_id, springs)
            return replace(policy, arm=self._arm.identity)
        except ValueError as error:
            raise ValueError(f"{bag}: {error}") from error
