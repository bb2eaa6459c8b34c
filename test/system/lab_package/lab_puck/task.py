# SPDX-License-Identifier: Apache-2.0
from wam_power_ros import plotting
from wam_power_ros.tasks.errors import Effect, Error
from wam_power_ros.tasks.task import Goal, Task


class Puck(Task):
    """Push a puck over a table: it slides on and is to stop at a mark."""

    name, body = "puck", "puck"
    presets = {"puck": {"budget": 20, "retests": 1}}
    goal = Goal(achieved="stopped the puck at the mark")
    errors = (Error("beside", "m", 0.01, limit=0.03), Error("beyond", "m", 0.01, limit=0.03))
    effects = (Effect("shift_x", 0.05, {"beside": 1.0}), Effect("amplitude", 0.2, {"beyond": 0.5}))

    def observe(self, rollout):
        x, y, _ = rollout.body.position[-1]
        return {"beside": x - 0.8, "beyond": y - 0.3}

    def figure(self, rollout):
        figure, (axes,) = plotting.side_by_side(7.2, 3.0, 1.0)
        axes.plot(rollout.body.t, rollout.body.position[:, 1])
        return figure, "The puck slides on."
