"""What the surrogate makes of missions under several conditions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
import synthetic

from tuner.acquisition.propose import propose
from tuner.problem.observations import Observation
from tuner.problem.worlds import World, worlds_over
from tuner.surrogate.model import RockMeanGP

CONDITIONS = ("ideal", "field", "harsh")
WORLDS = worlds_over(synthetic.ROCKS, CONDITIONS)
ROCK = dict(zip(synthetic.ROCKS, (0.0, 3.0, -2.0, 1.0)))
LEVEL = dict(zip(CONDITIONS, (0.0, -4.0, -8.0)))
TILT = dict(zip(CONDITIONS, (0.0, 1.5, 3.0)))  # a condition moves the best configuration


def truth(unit: np.ndarray, world: World) -> float:
    tilted = TILT[world.condition] * (unit[0] - 0.5)
    interaction = 0.5 * np.sin(7 * ROCK[world.rock] + LEVEL[world.condition])
    return float(ROCK[world.rock] + LEVEL[world.condition] + np.sin(3 * unit[1]) + tilted + interaction)


def missions(count: int, seed: int, worlds: Sequence[World] = WORLDS) -> list[Observation]:
    rng = np.random.default_rng(seed)
    found = []
    for i in range(count):
        unit, world = rng.random(2), worlds[i % len(worlds)]
        y = truth(unit, world) + 0.2 * rng.normal()
        values = synthetic.SPACE.from_unit(unit)
        found.append(Observation(i, values, world.rock, 0, y, y, condition=world.condition))
    return found


def test_one_condition_is_the_model_without_any() -> None:
    history = missions(16, 0, [World(rock) for rock in synthetic.ROCKS])
    named = [dataclasses.replace(o, condition="field") for o in history]
    plain = RockMeanGP(synthetic.SPACE, history, synthetic.ROCKS)
    other = RockMeanGP(synthetic.SPACE, named, [World(rock, "field") for rock in synthetic.ROCKS])
    where = [o.values for o in history[:4]]
    assert plain.posterior(where).mean.tolist() == other.posterior(where).mean.tolist()
    assert propose(plain, [], 3) == propose(other, [], 3)


def test_the_mean_over_worlds_is_that_of_its_worlds() -> None:
    model = RockMeanGP(synthetic.SPACE, missions(36, 1), WORLDS)
    values = synthetic.SPACE.from_unit([0.8, 0.4])
    by_world = [model.predict_mission(values, world)[0] for world in WORLDS]
    assert model.posterior([values]).mean[0] == pytest.approx(np.mean(by_world))
