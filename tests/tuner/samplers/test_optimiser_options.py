"""Options of our optimiser: sparsity, a cheaper fidelity."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import synthetic

from tuner.problem.observations import Observation
from tuner.problem.search_space import Values
from tuner.samplers.earlier_missions import EarlierMissions
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.settings import SurrogateSettings

# -- sparsity ------------------------------------------------------------------------------------------------


def test_sparse_model_switches_parameters_off() -> None:
    """Only the first parameter matters; the sparse prior knows it from fewer missions."""
    rng = np.random.default_rng(1)
    history = []
    for i in range(24):
        u = rng.random(2)
        y = math.sin(6 * u[0]) + 0.05 * rng.normal()
        history.append(Observation(i, synthetic.SPACE.from_unit(u), "r0", 0, y, y))
    ratio = {}
    for sparse in (False, True):
        model = RockMeanGP(synthetic.SPACE, history, ("r0",), settings=SurrogateSettings(sparse=sparse))
        first, second = model.lengthscales.values()
        ratio[sparse] = second / first
    assert ratio[True] > 10 and ratio[True] > ratio[False]


# -- a cheaper fidelity -----------------------------------------------------------------------------------------------


def cheap(values: Values, rock: str) -> float | None:
    return 3 * synthetic.true_value(values) + (1.0 if rock == "r1" else 0.0)


def flown_before(fly: Callable[[Values, str], float | None], missions: int = 96) -> EarlierMissions:
    """Anywhere in the space, rocks and two replicates in turn."""
    rng, rocks = np.random.default_rng(3), synthetic.ROCKS
    history = []
    for i, u in enumerate(rng.random((missions, 2))):
        values, rock = synthetic.SPACE.from_unit(u), rocks[i % len(rocks)]
        y = fly(values, rock)
        history.append(Observation(i, values, rock, i // len(rocks) % 2, y, y))
    return EarlierMissions(synthetic.SPACE, rocks, tuple(history))


def test_the_best_before_are_apart_and_failures_do_no_harm() -> None:
    flown = flown_before(
        lambda values, rock: None if values["gate.budget_fraction"] < 0.2 else cheap(values, rock)
    )
    best = flown.best(4)
    unit = np.array([synthetic.SPACE.to_unit(v) for v in best])
    assert len(best) == 4 and synthetic.true_value(best[0]) > 0.95
    assert {o.replicate for o in flown.observations} >= {0, 1}
    assert min(np.linalg.norm(unit[i] - unit[j]) for i in range(4) for j in range(i)) > 0.15
    assert not flown_before(lambda values, rock: None).usable
    read = EarlierMissions.from_json(flown.to_json(), synthetic.SPACE)
    assert read.best(4) == best
