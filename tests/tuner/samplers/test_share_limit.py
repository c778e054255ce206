"""A constraint on a share: what the surrogate believes is worth as many rocks as were flown."""

from __future__ import annotations

import numpy as np

from tuner.acquisition.constrained import Constraint
from tuner.problem.observations import Observation
from tuner.problem.search_space import Parameter, SearchSpace
from tuner.surrogate.model import RockMeanGP

SPACE = SearchSpace("one", (Parameter("seed.count", "int", 8, 40, "linear", (), 24),), {})


def flown(counts_and_shares: dict[int, float], rocks: int, seed: int) -> list[Observation]:
    """``rocks`` fresh rocks at each number of photographs; each succeeds with the share as its probability."""
    rng, found = np.random.default_rng(seed), []
    for count, share in counts_and_shares.items():
        for _ in range(rocks):
            number = len(found)
            outcome = 100.0 * (rng.random() < share)
            found.append(Observation(number, {"seed.count": count}, "any-slab", number, outcome, outcome))
    return found


def test_where_all_succeed_many_rocks_are_believed_and_few_are_not() -> None:
    for rocks, kept in ((4, False), (60, True)):
        missions = flown({12: 0.2, 36: 1.0}, rocks, 0)
        constraint = Constraint(RockMeanGP(SPACE, missions, ["any-slab"]), 95.0, is_share=True)
        assert constraint.keeps([{"seed.count": 36}]) == [kept]
        assert constraint.keeps([{"seed.count": 12}]) == [False]
