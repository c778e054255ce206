"""What the surrogate makes of missions under several conditions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import synthetic

from tuner.problem.instances import Instance, instances_over
from tuner.problem.observations import Observation
from tuner.surrogate.model import InstanceMeanGP

CONDITIONS = ("ideal", "field", "harsh")
WORLDS = instances_over(synthetic.ROCKS, CONDITIONS)
ROCK = dict(zip(synthetic.ROCKS, (0.0, 3.0, -2.0, 1.0)))
LEVEL = dict(zip(CONDITIONS, (0.0, -4.0, -8.0)))
TILT = dict(zip(CONDITIONS, (0.0, 1.5, 3.0)))  # a condition moves the best configuration


def truth(unit: np.ndarray, instance: Instance) -> float:
    tilted = TILT[instance.condition] * (unit[0] - 0.5)
    interaction = 0.5 * np.sin(7 * ROCK[instance.rock] + LEVEL[instance.condition])
    return float(ROCK[instance.rock] + LEVEL[instance.condition] + np.sin(3 * unit[1]) + tilted + interaction)


def missions(count: int, seed: int, instances: Sequence[Instance] = WORLDS) -> list[Observation]:
    rng = np.random.default_rng(seed)
    found = []
    for i in range(count):
        unit, instance = rng.random(2), instances[i % len(instances)]
        y = truth(unit, instance) + 0.2 * rng.normal()
        values = synthetic.SPACE.from_unit(unit)
        found.append(Observation(i, values, instance.rock, 0, y, y, condition=instance.condition))
    return found


def test_the_mean_over_instances_is_that_of_its_worlds() -> None:
    model = InstanceMeanGP(synthetic.SPACE, missions(36, 1), WORLDS)
    values = synthetic.SPACE.from_unit([0.8, 0.4])
    by_world = [model.predict_mission(values, instance)[0] for instance in WORLDS]
    assert model.posterior([values]).mean[0] == pytest.approx(np.mean(by_world))
