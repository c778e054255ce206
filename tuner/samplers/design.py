"""What is run before a model can say anything: the default configuration, then points that need no outcomes."""

from __future__ import annotations

import math
import warnings

import numpy as np

from tuner.problem.search_space import MANY_PARAMETERS, SearchSpace, Values

# Where missions were run before a campaign, elsewhere, a design this short has so many of the best of them right after
# the default (docs/results/index.md).
WITH_EARLIER, FROM_EARLIER = 6, 4

# Standard deviation of a point near a trusted default, per parameter, of the unit cube: smallest and largest,
# evenly spread logarithms (docs/results/index.md).
NEAR_SD = (0.075, 0.3)


def stays_near_default(dimension: int, trusted_default: bool) -> bool:
    """Return whether half of the design stays near the default: one that can be trusted, in not too many dimensions."""
    return trusted_default and dimension < MANY_PARAMETERS


def initial_design_size(
    dimension: int, budget: int, *, trusted_default: bool = False, earlier: bool = False
) -> int:
    """Return how many missions come before the model leads: 2 (d + 1), at most a third of the budget, at least 1.

    ``trusted_default``: whether the default can be trusted: then d + 2, at most a sixth of the budget, where half
    of the design stays near it, and at most a fifth of the budget where parameters are many. ``earlier``: whether the
    best of missions run before take most places: then at most ``WITH_EARLIER``, and at most a third of the budget.
    """
    if earlier:
        return max(1, min(WITH_EARLIER, 2 * (dimension + 1), budget // 3))
    if stays_near_default(dimension, trusted_default):
        return max(1, min(dimension + 2, budget // 6))
    return max(1, min(2 * (dimension + 1), budget // (5 if trusted_default else 3)))


def places_for_earlier(initial: int, begun: int) -> range:
    """Return which places of a design of ``initial`` missions go to the best missions run before the campaign, best first.

    The first after the default and ``begun`` others in a short design, every second one in a longer one.
    """
    if initial <= WITH_EARLIER:
        return range(begun + 1, begun + 1 + FROM_EARLIER)
    return range(min(2 + begun // 2 * 2, initial - 1), initial, 2)


def sobol_point(space: SearchSpace, seed: int, index: int) -> Values:
    """Return point ``index`` of the seed's scrambled Sobol sequence over the space."""
    from scipy.stats import qmc  # noqa: PLC0415  a second to load

    engine = qmc.Sobol(space.dimension, scramble=True, rng=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # balance needs powers of two; a sequence is wanted here
        if index:
            engine.fast_forward(index)
        return space.from_unit(engine.random(1)[0])


def near_default(space: SearchSpace, default: Values, seed: int, index: int) -> Values:
    """Return one of the seed's random points around ``default``, near ones and less near ones.

    A default that somebody chose by hand is better than most of the space: where its neighbourhood is better still
    a handful of such points show it, before a space-filling design has found anything as good as the default.
    """
    rng = np.random.default_rng([seed, index, 77])
    smallest, largest = NEAR_SD
    sd = math.exp(rng.uniform(math.log(smallest), math.log(largest)))
    centre = space.to_unit(default)
    moved = np.clip(centre + sd * rng.standard_normal(space.dimension), 0.0, 1.0)
    return space.from_unit(space.redraw_choices(moved, centre, rng))
