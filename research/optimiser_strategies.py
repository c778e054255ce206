"""Optimisers behind one face for ``optimiser_comparison.py``.

A strategy is made for one problem and seed, asked for the next mission, told how it ended, and may recommend.
To add one (another library, say) write a class with ``ask``, ``tell`` and ``recommend`` and enter a factory::

    STRATEGIES["mine"] = lambda problem, seed: MyStrategy(problem, seed)

``AllRocks`` turns anything that proposes configurations and learns one number each into a strategy that flies
every configuration on all rocks.
"""

from __future__ import annotations

import dataclasses
import logging
import unittest.mock
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from research.optimiser_problems import Problem
from research.peers.sampler import PEER_NAMES, available_peers, make_peer_sampler
from tuner.campaign.rock_choice import procedural_rocks
from tuner.campaign.shipped import shipped_missions
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation, next_block
from tuner.problem.search_space import Values
from tuner.problem.standardise import RockStandardiser
from tuner.samplers import base
from tuner.samplers.base import Sampler, SamplerSettings, derived_seed
from tuner.samplers.design import initial_design_size
from tuner.samplers.earlier_missions import EarlierMissions
from tuner.samplers.gp import GPSampler
from tuner.samplers.optuna import distributions
from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.settings import SurrogateSettings, surrogate_settings


def make_sampler(name: str, settings: SamplerSettings) -> Sampler:
    """A sampler of the product, or a peer."""
    return make_peer_sampler(name, settings) if name in PEER_NAMES else base.make_sampler(name, settings)


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

    def recommend(self) -> Values | None:
        """The configuration to use now; None leaves it to our GP's posterior mean over what was flown."""
        ...


Factory = Callable[[Problem, int], Strategy]


def settings_of(
    problem: Problem,
    seed: int,
    *,
    configurations: bool = False,
    ours: bool = False,
    earlier: EarlierMissions | None = None,
) -> SamplerSettings:
    """What a campaign on ``problem`` would give its sampler.

    ``configurations``: for samplers that see configurations, each flown on all rocks, as single results.
    ``ours``: for our sampler, whose design trusts a default that was chosen by hand. ``earlier``: of another campaign.
    """
    rocks = ("mean",) if configurations else problem.rocks
    budget = problem.budget // len(problem.rocks) if configurations else problem.budget
    trusted = ours and problem.trusted_default
    initial = initial_design_size(
        problem.space.dimension, budget, trusted_default=trusted, earlier=earlier is not None
    )
    replicates = 1 if configurations else problem.replicates
    return SamplerSettings(
        problem.space,
        problem.default,
        rocks,
        seed,
        initial,
        replicates,
        budget=budget,
        trusted_default=trusted,
        earlier=earlier,
    )


class OneRock:
    """A campaign's sampler: one mission per configuration, rocks in turn."""

    def __init__(self, sampler: Sampler, model: SurrogateSettings | None = None) -> None:
        self.sampler = sampler
        self.model = model  # of the recommendation
        self.history: list[Observation] = []

    def ask(self) -> Request:
        """The sampler's proposal."""
        p = self.sampler.ask(self.history, [])
        return Request(p.values, p.instance.rock if p.instance else None, p.replicate, p.metadata)

    def tell(self, observation: Observation) -> None:
        """Into the history."""
        self.history.append(observation)

    def recommend(self) -> Values | None:
        """By the common rule."""
        return None


class Careless(OneRock):
    """Ours as it was before failed missions told it where not to search."""

    def ask(self) -> Request:
        """Without the model of failures."""
        with unittest.mock.patch.object(InstanceMeanGP, "feasibility", None):
            return super().ask()


class OurDesign(OneRock):
    """A peer after our sampler's initial design: what of a difference is the design's.

    ``earlier``: the missions of another campaign, which lead the design, are in the peer's study with outcomes
    standardised per rock, and count in the recommendation.
    """

    def __init__(
        self, problem: Problem, seed: int, name: str, earlier: EarlierMissions | None = None
    ) -> None:
        settings = settings_of(problem, seed, ours=True, earlier=earlier)
        self.earlier = earlier
        self._initial = settings.initial
        self._design = GPSampler(settings)
        self._before = () if earlier is None else earlier.observations
        super().__init__(make_sampler(name, settings))

    def ask(self) -> Request:
        """A point of our design, then the peer's proposal."""
        if len(self.history) < self._initial:
            return Request(self._design.ask(self.history, []).values)
        mine = [dataclasses.replace(o, number=o.number + len(self._before)) for o in self.history]
        p = self.sampler.ask([*self._before, *mine], [])
        return Request(p.values, metadata=p.metadata)


def earlier_campaign(problem: Any, seed: int) -> EarlierMissions:
    """What a campaign like ours on other rocks has flown: 96 missions on the procedural training rocks not in ``problem``."""
    rocks = tuple(rock for rock in procedural_rocks("train") if rock not in problem.rocks)
    elsewhere = dataclasses.replace(problem, rocks=rocks)
    size, replicates = 96, 2
    initial = initial_design_size(problem.space.dimension, size, trusted_default=problem.trusted_default)
    # Other Sobol points than those of the campaign that learns from it.
    sampler = GPSampler(
        SamplerSettings(
            problem.space,
            problem.default,
            rocks,
            derived_seed(seed, size),
            initial,
            replicates,
            budget=size,
            trusted_default=problem.trusted_default,
        )
    )
    history: list[Observation] = []
    while len(history) < size:
        proposal = sampler.ask(history, [])
        (rock, _), replicate = next_block(rocks, replicates, history, proposal)
        y = elsewhere.run(proposal.values, rock, replicate).value
        history.append(Observation(len(history), proposal.values, rock, replicate, y, y))
    return EarlierMissions(problem.space, rocks, tuple(history))


def shipped_campaign(problem: Any, seed: int) -> EarlierMissions:
    """What comes with the program, the same for every seed."""
    return shipped_missions(problem.space, Objective())


class SecondCampaign(OneRock):
    """Our sampler where there was a campaign on other rocks before (``--learn-from``), which costs nothing here."""

    def __init__(self, problem: Problem, seed: int, earlier: EarlierMissions) -> None:
        self.earlier = earlier  # of the recommendation, too
        super().__init__(GPSampler(settings_of(problem, seed, ours=True, earlier=earlier)))


def second_campaign(name: str, before: Callable[[Any, int], EarlierMissions]) -> Factory:
    """Ours, or a peer that is told the same."""
    if name == "gp":
        return lambda problem, seed: SecondCampaign(problem, seed, before(problem, seed))
    return lambda problem, seed: OurDesign(problem, seed, name, before(problem, seed))


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

    def recommend(self) -> Values | None:
        """By the common rule."""
        return None


class PrunedTPE:
    """Optuna as its documentation would have it for many instances: TPE, and ``WilcoxonPruner`` over rocks.

    With four rocks the signed-rank test can reach p = 0.25 after two rocks and 0.125 after three: the threshold of
    0.26 stops a configuration that is worse than the best one on its first two. A stopped configuration counts
    with the mean of its rock-standardised outcomes.
    """

    def __init__(self, problem: Problem, seed: int) -> None:
        import optuna

        optuna.logging.set_verbosity(logging.ERROR)
        self.problem = problem
        startup = initial_design_size(problem.space.dimension, problem.budget // len(problem.rocks))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=startup, multivariate=True)
            pruner = optuna.pruners.WilcoxonPruner(p_threshold=0.26, n_startup_steps=2)
        self.study = optuna.create_study(direction="maximize", sampler=sampler, pruner=pruner)
        self.study.enqueue_trial(dict(problem.default))
        self._distributions = distributions(problem.space)
        self._trial: Any = None
        self._mine: list[Observation] = []
        self._all: list[Observation] = []

    def ask(self) -> Request:
        """The configuration at hand on its next rock."""
        if self._trial is None:
            self._trial = self.study.ask(self._distributions)
        replicate = self._trial.number % self.problem.replicates
        return Request(dict(self._trial.params), self.problem.rocks[len(self._mine)], replicate)

    def tell(self, observation: Observation) -> None:
        """Report, and stop or go on."""
        import optuna

        self._mine.append(observation)
        self._all.append(observation)
        trial = self._trial
        if observation.outcome is None:
            self.study.tell(trial, state=optuna.trial.TrialState.FAIL)
        else:
            trial.report(observation.outcome, len(self._mine) - 1)
            complete = len(self._mine) == len(self.problem.rocks)
            if not complete and not trial.should_prune():
                return
            good = [o for o in self._all if o.outcome is not None]
            outcomes = np.array([o.outcome for o in good], dtype=float)
            standard = RockStandardiser.fit([o.rock for o in good], outcomes)
            own = standard.standardise([o.rock for o in self._mine], [o.outcome or 0.0 for o in self._mine])
            self.study.tell(trial, float(np.mean(own)))
        self._trial, self._mine = None, []

    def recommend(self) -> Values | None:
        """By the common rule."""
        return None


def one_rock(name: str) -> Factory:
    """A campaign with sampler ``name``."""
    return lambda problem, seed: OneRock(make_sampler(name, settings_of(problem, seed, ours=name == "gp")))


def all_rocks(name: str) -> Factory:
    """The sampler on configurations that fly all rocks."""
    return lambda problem, seed: AllRocks(
        problem, make_sampler(name, settings_of(problem, seed, configurations=True, ours=name == "gp"))
    )


def gp_variant(*, initial: int | None = None, **options: Any) -> Factory:
    """Our sampler with other settings of its surrogate or of its initial design; the rest as in ``gp``."""

    def make(problem: Problem, seed: int) -> Strategy:
        model = dataclasses.replace(surrogate_settings(problem.space), **options)
        settings = settings_of(problem, seed, ours=True)
        if initial is not None:
            settings = dataclasses.replace(settings, initial=initial)
        return OneRock(GPSampler(settings, model=model), model)

    return make


PEERS = ("sobol", "random", "tpe", "optuna-gp", *available_peers())
STRATEGIES: dict[str, Factory] = {
    "gp": one_rock("gp"),
    **{name: one_rock(name) for name in PEERS},
    **{f"{name}/all": all_rocks(name) for name in (*PEERS, "gp")},
    "tpe/pruned": PrunedTPE,
    **{
        f"{name}+{suffix}": second_campaign(name, before)
        for suffix, before in (("earlier", earlier_campaign), ("shipped", shipped_campaign))
        for name in ("gp", *PEERS)
        if name not in ("sobol", "random")
    },
    "gp+trusting": lambda problem, seed: OneRock(
        GPSampler(settings_of(problem, seed, ours=True), verify=False)
    ),
    "gp+careless": lambda problem, seed: Careless(make_sampler("gp", settings_of(problem, seed, ours=True))),
    "gp+sobol": lambda problem, seed: OneRock(GPSampler(settings_of(problem, seed))),  # its design before
    "optuna-gp+near": lambda problem, seed: OurDesign(problem, seed, "optuna-gp"),
    "gp+short": gp_variant(initial=8),
    "gp+short12": gp_variant(initial=12),
    "gp+dense": gp_variant(sparse=False, trend=False),  # as gp on fewer than 13 parameters
    # as gp from 13 parameters on, without its linear trend
    "gp+sparse": gp_variant(sparse=True, trend=False),
    "gp+unblocked": gp_variant(blocks=False),
}


_MANY_ROCKS = ("gp+unblocked", "gp+trusting")
_TRUSTED_DEFAULT = (
    "gp+sobol",
    "optuna-gp+near",
    *(name for name in STRATEGIES if name.endswith(("+earlier", "+shipped"))),
)


def applicable(name: str, problem: str) -> bool:
    """Whether a strategy makes sense, and is another one than its plain variant, on a problem."""
    if name == "gp+careless":
        return problem in ("failing", "geometric:few_photographs")
    if name in _TRUSTED_DEFAULT:
        return problem.startswith("geometric")
    one_rock = not problem.startswith(("four-rocks", "geometric"))
    return not (one_rock and ("/" in name or name in _MANY_ROCKS))
