"""Optimisers behind one face for ``optimiser_comparison.py``.

A strategy is made for one problem and seed, asked for the next mission, and told how it ended. Our GP's posterior mean over
what was flown recommends. To add one (another library, say) write a class with ``ask`` and ``tell`` and enter a factory::

    STRATEGIES["mine"] = lambda problem, seed: MyStrategy(problem, seed)

``AllRocks`` turns anything that proposes configurations and learns one number each into a strategy that flies
every configuration on all rocks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

import tuner.problem.problem
from research.optimiser_problems import Problem
from research.peers.sampler import PEER_NAMES, available_peers, make_peer_sampler
from tuner.problem.instances import Instance
from tuner.problem.observations import Observation
from tuner.problem.search_space import Values
from tuner.samplers import registry
from tuner.samplers.base import Sampler, SamplerSettings
from tuner.samplers.design import initial_design_size


def make_sampler(name: str, settings: SamplerSettings) -> Sampler:
    """A sampler of the product, or a peer."""
    return make_peer_sampler(name, settings) if name in PEER_NAMES else registry.make_sampler(name, settings)


@dataclass(frozen=True)
class Request:
    """The mission a strategy wants; rock and replicate by the campaign's schedule where None."""

    values: Values
    rock: str | None = None
    replicate: int | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)


class Strategy(Protocol):
    """One optimiser at work on one problem."""

    def ask(self) -> Request:
        """The next mission."""
        ...

    def tell(self, observation: Observation) -> None:
        """The mission asked for last has ended (``outcome`` None: it failed)."""
        ...


Factory = Callable[[Problem, int], Strategy]


def settings_of(
    problem: Problem, seed: int, *, configurations: bool = False, ours: bool = False
) -> SamplerSettings:
    """What a campaign on ``problem`` would give its sampler.

    ``configurations``: for samplers that see configurations, each flown on all rocks, as single results.
    ``ours``: for our sampler, whose design trusts a default that was chosen by hand.
    """
    rocks = ("mean",) if configurations else problem.rocks
    budget = problem.budget // len(problem.rocks) if configurations else problem.budget
    trusted = ours and problem.trusted_default
    initial = initial_design_size(problem.space.dimension, budget, trusted_default=trusted)
    replicates = 1 if configurations else problem.replicates
    asked = tuner.problem.problem.Problem(
        problem.space, tuple(map(Instance, rocks)), problem.default, replicates
    )
    return SamplerSettings(asked, seed, initial, budget=budget, trusted_default=trusted)


class OneRock:
    """A campaign's sampler: one mission per configuration, rocks in turn."""

    def __init__(self, sampler: Sampler) -> None:
        self.sampler = sampler
        self.history: list[Observation] = []

    def ask(self) -> Request:
        """The sampler's proposal."""
        p = self.sampler.ask(self.history, [])
        return Request(p.values, p.instance.rock if p.instance else None, p.replicate, p.metadata)

    def tell(self, observation: Observation) -> None:
        """Into the history."""
        self.history.append(observation)


class AllRocks:
    """Every configuration on all rocks with one replicate number; the sampler learns the mean."""

    def __init__(self, problem: Problem, sampler: Sampler) -> None:
        self.problem = problem
        self.sampler = sampler
        self.means: list[Observation] = []
        self._now: Request | None = None
        self._outcomes: list[float | None] = []

    def ask(self) -> Request:
        """The configuration at hand on its next rock."""
        if self._now is None:
            p = self.sampler.ask(self.means, [])
            self._now = Request(p.values, metadata=p.metadata)
        replicate = len(self.means) % self.problem.replicates
        rock = self.problem.rocks[len(self._outcomes)]
        return Request(self._now.values, rock, replicate, self._now.metadata)

    def tell(self, observation: Observation) -> None:
        """One number per configuration; a failure on any rock is a failed configuration."""
        self._outcomes.append(observation.outcome)
        if len(self._outcomes) < len(self.problem.rocks):
            return
        assert self._now is not None
        good = [y for y in self._outcomes if y is not None]
        mean = float(np.mean(good)) if len(good) == len(self._outcomes) else None
        number = len(self.means)
        self.means.append(Observation(number, self._now.values, "mean", number, mean, mean))
        self._now, self._outcomes = None, []


def one_rock(name: str) -> Factory:
    """A campaign with sampler ``name``."""
    return lambda problem, seed: OneRock(make_sampler(name, settings_of(problem, seed, ours=name == "gp")))


def all_rocks(name: str) -> Factory:
    """The sampler on configurations that fly all rocks."""
    return lambda problem, seed: AllRocks(
        problem, make_sampler(name, settings_of(problem, seed, configurations=True, ours=name == "gp"))
    )


PEERS = ("sobol", "random", "tpe", "optuna-gp", *available_peers())
STRATEGIES: dict[str, Factory] = {
    "gp": one_rock("gp"),
    **{name: one_rock(name) for name in PEERS},
    **{f"{name}/all": all_rocks(name) for name in (*PEERS, "gp")},
}


def applicable(name: str, problem: str) -> bool:
    """Whether a strategy is another one than its plain variant on a problem: there are several rocks."""
    return "/" not in name or problem.startswith(("four-rocks", "geometric"))
