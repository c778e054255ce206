"""Observations of the fake mission without any mission being flown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import fake_missions
import numpy as np

from nbv.config import MissionConfig
from tuner.history import Observation
from tuner.samplers import Sampler, SamplerSettings
from tuner.search_space import load_search_space

SPACE = load_search_space("gate")
ROCKS = ("r0", "r1", "r2", "r3")
BASE = SPACE.base_config(MissionConfig())
DEFAULT = SPACE.default(MissionConfig())


def true_value(values: Mapping[str, Any]) -> float:
    return fake_missions.truth(BASE.with_values(dict(values)))


def true_rock_mean(values: Mapping[str, Any], rocks: Sequence[str] = ROCKS) -> float:
    return float(np.mean([o + s * true_value(values) for o, s in map(fake_missions.rock_shift, rocks)]))


def observe(
    number: int, values: Mapping[str, Any], rock: str, noise_sd: float, rng: np.random.Generator
) -> Observation:
    offset, scale = fake_missions.rock_shift(rock)
    y = offset + scale * (true_value(values) + noise_sd * rng.normal())
    return Observation(number, dict(values), rock, 0, y, y)


def random_design(count: int, noise_sd: float, seed: int) -> list[Observation]:
    rng = np.random.default_rng(seed)
    return [
        observe(i, SPACE.from_unit(rng.random(2)), ROCKS[i % len(ROCKS)], noise_sd, rng) for i in range(count)
    ]


def sampler_settings(seed: int, initial: int = 6) -> SamplerSettings:
    return SamplerSettings(SPACE, DEFAULT, ROCKS, seed, initial)


def play(sampler: Sampler, budget: int, noise_sd: float, seed: int) -> list[Observation]:
    """A whole campaign, one mission at a time."""
    rng = np.random.default_rng(seed)
    history: list[Observation] = []
    for i in range(budget):
        proposal = sampler.ask(history, [])
        history.append(observe(i, proposal.values, ROCKS[i % len(ROCKS)], noise_sd, rng))
    return history
