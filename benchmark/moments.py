# SPDX-License-Identifier: Apache-2.0
"""False joint states that begin at random moments, and end: controller and arm in one process.

    python -m benchmark.moments [--repeats 12] [--kinds frozen ...]

The false states of `benchmark.false_states` are passed to a controller that is connected by calls
to the simulated arm, which keeps the last torque. They begin at a random moment of a rollout, a
move or a demonstration. The arm is observed until 0.5 s after the fault and for 2 s more. Then true
states return: they must not move the arm, and the fault must be resettable.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmark.false_states import ALL_FALSE_STATES
from benchmark.hidden_arm import held
from benchmark.loop import SPEED_MARGIN, Loop, Outcome
from benchmark.terminal import options, table_head, table_row
from wam_power_ros.control.safety import REST_SPEED

WATCH_TICKS = 600  # [periods] of observation after false states began
PHASES = ("rollout", "move", "teaching")


def begin(loop: Loop, phase: str, rng: np.random.Generator) -> None:
    """Bring a held arm to a random moment of a phase."""
    core = loop.controller
    if phase == "rollout":
        core.execute()
        loop.play(rng.uniform(0.02, 0.95 * loop.policy.basis.duration))
        return
    core.set_gravity_compensation(True)
    loop.plant.guide(int(rng.integers(100)))
    loop.play(rng.uniform(0.2, 1.2))
    if phase == "move":
        loop.plant.let_go()
        core.set_gravity_compensation(False)
        loop.play(1.0)
        core.move_to_start()
        loop.play(rng.uniform(0.05, 0.4))


def inject(name: str, phase: str, rng: np.random.Generator) -> Outcome:
    """Let false states begin at a random moment of a phase, and end.

    Returns:
        Outcome, whose peak is that of the first 1.2 s; `rest` is 0 without a fault.
    """
    loop = held()
    begin(loop, phase, rng)
    loop.falsify = ALL_FALSE_STATES[name]()
    found = loop.observe(3.2, lambda at: at is None and len(loop.speeds) > WATCH_TICKS)
    peak = max(loop.speeds[1 : WATCH_TICKS + 1])
    loop.plant.let_go()
    loop.falsify = lambda state: state
    loop.play(3.0)
    rest = 0.0 if found.noticed is None else found.rest
    return found._replace(peak=peak, rest=rest, after=max(loop.speeds[1:]), reset=loop.reset())


def main() -> int:
    """Print a row for each kind of false state and phase; return 1 if the arm was not stopped."""
    given = options(__doc__, repeats=12, kinds=[*ALL_FALSE_STATES])
    loop = held()
    loop.controller.execute()
    most = loop.observe(1.2).peak + SPEED_MARGIN
    titles = ("false state", "phase", "faults", "within [ms]", "peak [m/s]", "rest", "after")
    print(table_head(*titles, "reset", ""))
    failed = 0
    for name in given.kinds:
        for phase in PHASES:
            seeds = range(7000, 7000 + given.repeats)
            found = [inject(name, phase, np.random.default_rng(k)) for k in seeds]
            late = [each.noticed for each in found if each.noticed is not None]
            guided = phase == "teaching"  # as fast as the demonstrator guides it
            good = [
                (guided or e.peak <= most) and e.rest < REST_SPEED and e.after < SPEED_MARGIN
                for e in found
            ]
            failed += len(found) - sum(good)
            counted = f"{len(late)} of {len(found)}", 2 * max(late, default=0)
            peak, rest, after = (
                max(each) for each in zip(*((e.peak, e.rest, e.after) for e in found), strict=True)
            )
            speeds = f"{peak:.2f}", f"{rest:.3f}", f"{after:.2f}"
            resets = sum(e.reset for e in found), f"{sum(good)} good"
            print(table_row(name, phase, *counted, *speeds, *resets), flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
