"""Observations of the fake mission without running any mission."""

from collections.abc import Mapping, Sequence
from typing import Any

import fake_missions
import numpy as np

from nbv.config import MissionConfig
from tuner.problem.instances import Instance
from tuner.problem.observations import Observation
from tuner.problem.search_space import Problem
from tuner.problem.space_files import space_from_dict
from tuner.samplers.base import Sampler, SamplerSettings

# The range on which ``fake_missions.truth`` has its maximum inside; not the shipped space "gate".
SPACE = space_from_dict(
    {
        "name": "gate",
        "base": {"gate.kind": "hyb-h"},
        "parameters": {
            "gate.budget_fraction": {"low": 0.0, "high": 1.0},
            "gate.d95_m": {"low": 0.01, "high": 1.0, "scale": "log"},
        },
    },
    "synthetic.py",
)
ROCKS = ("r0", "r1", "r2", "r3")
INSTANCES = tuple(map(Instance, ROCKS))
BASE = MissionConfig().with_values(SPACE.base)
DEFAULT = SPACE.default(MissionConfig())
PROBLEM = Problem(SPACE, INSTANCES, DEFAULT)


def true_value(values: Mapping[str, Any]) -> float:
    return fake_missions.truth(BASE.with_values(dict(values)))


def true_rock_mean(values: Mapping[str, Any], rocks: Sequence[str] = ROCKS) -> float:
    return float(np.mean([o + s * true_value(values) for o, s in map(fake_missions.rock_shift, rocks)]))


def block_offset(rock: str, replicate: int, seed: int) -> float:
    """Standard normal offset of one (rock, replicate) block, the same for all configurations."""
    return float(fake_missions.draw("slot", rock, replicate, seed).normal())


def observe(
    number: int,
    values: Mapping[str, Any],
    rock: str,
    noise_sd: float,
    rng: np.random.Generator,
    replicate: int = 0,
    block_sd: float = 0.0,
    block_seed: int = 0,
) -> Observation:
    offset, scale = fake_missions.rock_shift(rock)
    shared = block_sd * block_offset(rock, replicate, block_seed) if block_sd else 0.0
    y = offset + scale * (true_value(values) + shared + noise_sd * rng.normal())
    return Observation(number, dict(values), rock, replicate, y, y)


def random_design(
    count: int, noise_sd: float, seed: int, replicates: int = 1, block_sd: float = 0.0
) -> list[Observation]:
    """Rocks in turn, then replicates in turn."""
    rng = np.random.default_rng(seed)
    found = []
    for i in range(count):
        values, replicate = SPACE.from_unit(rng.random(2)), (i // len(ROCKS)) % replicates
        found.append(observe(i, values, ROCKS[i % len(ROCKS)], noise_sd, rng, replicate, block_sd, seed))
    return found


def sampler_settings(seed: int, initial: int = 6) -> SamplerSettings:
    return SamplerSettings(PROBLEM, seed, initial)


def play(sampler: Sampler, budget: int, noise_sd: float, seed: int) -> list[Observation]:
    """A whole campaign, one mission at a time."""
    rng = np.random.default_rng(seed)
    history: list[Observation] = []
    for i in range(budget):
        proposal = sampler.ask(history, [])
        history.append(observe(i, proposal.values, ROCKS[i % len(ROCKS)], noise_sd, rng))
    return history
