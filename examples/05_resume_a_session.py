# SPDX-License-Identifier: Apache-2.0
"""Keep a session on disk, stop it anywhere, resume it, and write its report."""

from itertools import islice
from pathlib import Path

from hardware_sim.scenes import scene_type
from hardware_sim.wam import JOINTS
from hardware_sim.world import World
from wam_power_ros.bags import layout, reader
from wam_power_ros.in_process.environment import Environment
from wam_power_ros.params.resources import share
from wam_power_ros.practice.session import Session
from wam_power_ros.practice.settings import preset
from wam_power_ros.reporting import session_report
from wam_power_ros.tasks.flip.task import Flip

folder = layout.free_path(Path(), "session")  # must be new
environment = Environment(World(scene_type("flip"), seed=5))
bag = min(share("bags").glob("demo_*"))
demonstration = Flip.demonstration_of(environment.arm, *reader.read_demonstration(bag, JOINTS))
policy = Flip.policy_of([demonstration], "demonstration-1")

settings = preset("flip", budget=3, retests=1)
with Session.begin(folder, settings, seed=5, candidates=[policy]) as session:
    for record in islice(environment.practise(session.practice(environment)), 2):
        session.append(record)  # a rollout counts once it is on disk

with Session.open(folder) as session:  # goes on with the policy that would have come next
    print(f"resumed after {len(session.records)} rollouts")
    practice = session.practice(environment)
    for record in environment.practise(practice):
        session.append(record)
    session.save_policy(practice.best.policy)
print(f"ended after {len(practice.records)} rollouts; {session_report.write(folder)}")
