# SPDX-License-Identifier: Apache-2.0
"""Equal knowledge: rows differ only in the information of the learner."""

import numpy as np
import pytest

from reproduction.rivals.learners import RandomSearch
from reproduction.studies import equal_knowledge
from reproduction.studies.equal_knowledge import InformedLearner, Planner, runs


def searching(seed: int = 0) -> RandomSearch:
    return RandomSearch(2, RandomSearch.Settings(), np.random.default_rng(seed))


class Hill:
    """A model that knows the optimum and records the returns it gets."""

    def __init__(self) -> None:
        self.returns: list[float] = []

    def predict(self, z: np.ndarray) -> np.ndarray:
        """See `Model`."""
        return -((z - 1.0) ** 2).sum(axis=1)

    def learn(self, z: np.ndarray, ret: float) -> None:
        """See `Model`."""
        self.returns.append(ret)


def test_with_a_model_the_best_of_its_own_draws_is_tried() -> None:
    drawn = searching()
    expected = np.stack([drawn.ask() for _ in range(equal_knowledge.CANDIDATES)])
    z = InformedLearner(searching(), Hill(), 0.0, np.random.default_rng(9)).ask()
    assert z.tolist() == expected[np.argmin(((expected - 1.0) ** 2).sum(axis=1))].tolist()


def test_noise_reaches_learner_and_model_alike_and_no_return_is_negative() -> None:
    learner, model = searching(), Hill()
    informed = InformedLearner(learner, model, 0.5, np.random.default_rng(9))
    for _ in range(50):
        informed.tell(np.zeros(2), 0.1)
    assert learner._rollouts.returns.tolist() == model.returns
    assert min(model.returns) == 0.0 and np.std(model.returns) > 0.1


def test_the_planner_tries_what_the_model_says_is_best() -> None:
    planner = Planner(2, np.random.default_rng(0), Hill())
    assert planner.ask() == pytest.approx([1.0, 1.0], abs=0.1)


@pytest.mark.parametrize("row", ["nothing", "power+model"])
def test_a_row_is_a_function_of_its_seeds(row: str) -> None:
    (one, again), other = (runs(row, 0.02, [1], 3) for _ in range(2)), runs(row, 0.02, [2], 3)
    assert one == again
    assert (one == other) == (row == "nothing")
