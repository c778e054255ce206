"""Our optimiser and the baselines propose missions through one interface.

A sampler is a function of the history, the missions in flight and a seed; it keeps no state of its own, so a
campaign that is resumed proposes what it would have proposed. Every sampler starts with the default configuration and the plain
plans, which a campaign runs with all replicates on every training rock first: each optimiser may know where they stand.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
import scipy

from nbv.config import IDEAL
from nbv.plugins import Registry
from nbv.safe_files import parse_json
from nbv.types import Floats
from tuner.problem.goal import Goal
from tuner.problem.instances import conditions_of, instances_over
from tuner.problem.observations import Observation, Proposal, distinct_configurations, next_block
from tuner.problem.search_space import MANY_PARAMETERS, Problem, SearchSpace, Values

if TYPE_CHECKING:
    from tuner.surrogate.model import InstanceMeanGP


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
    engine = scipy.stats.qmc.Sobol(space.dimension, scramble=True, rng=seed)
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


# Missions run before a campaign, elsewhere: on other rocks or with a cheaper fidelity (``tuner.campaign.begin``).
#
# Their best configurations, by a surrogate of those missions, take places of the campaign's initial design. The campaign's own
# surrogate knows its own missions only: the landscape of the earlier ones as a feature of it gained nothing
# (docs/results/index.md).


# Root mean square distance in the unit cube between their configurations in an initial design.
_APART = 0.15


@dataclass(frozen=True)
class EarlierMissions:
    """Missions run before a campaign, which its sampler learns from; some of them succeeded."""

    space: SearchSpace
    rocks: tuple[str, ...]
    observations: tuple[Observation, ...]
    # Besides: rocks drawn of families, and those that their campaigns learned from.
    seen: frozenset[str] = frozenset()

    @functools.cached_property
    def _model(self) -> InstanceMeanGP:
        from tuner.surrogate.model import InstanceMeanGP  # noqa: PLC0415  a campaign is looked at without torch

        instances = instances_over(self.rocks, conditions_of(o.instance for o in self.observations))
        return InstanceMeanGP(self.space, self.observations, instances)

    def best(self, count: int) -> list[Values]:
        """Return the configurations run with the best posterior means that are apart from each other; at most ``count``."""
        gp = self._model
        seen = distinct_configurations(self.space, gp.observations)
        chosen: list[tuple[Values, Floats]] = []
        for index in np.argsort(-gp.posterior(seen).mean, kind="stable"):
            unit = self.space.to_unit(seen[index])
            if all(np.sqrt(np.mean((unit - other) ** 2)) > _APART for _, other in chosen):
                chosen.append((seen[index], unit))
            if len(chosen) == count:
                break
        return [values for values, _ in chosen]

    def to_json(self) -> str:
        """Return the text of a file beside the ledger."""
        rows = [
            [dict(o.values), o.rock, o.outcome, o.replicate, *([o.condition] if o.condition != IDEAL else [])]
            for o in self.observations
        ]
        return json.dumps({"rocks": list(self.rocks), "missions": rows, "seen": sorted(self.seen)})

    @staticmethod
    def from_json(text: str, space: SearchSpace) -> EarlierMissions:
        """Return the inverse of ``to_json``; ``UserError``, ``ValueError``, ``TypeError`` or ``KeyError`` where it is not."""
        tree = parse_json(text, "the missions learned from")
        observations = [
            Observation(i, v, r, k, y, y, condition=condition[0] if condition else IDEAL)
            for i, (v, r, y, k, *condition) in enumerate(tree["missions"])
        ]
        seen = frozenset(tree.get("seen", ()))  # files of earlier versions have none
        return EarlierMissions(space, tuple(tree["rocks"]), tuple(observations), seen)


class Sampler(Protocol):
    """Proposes the next mission."""

    @property
    def name(self) -> str:
        """Its name in `SAMPLERS`."""

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        """Return the next configuration, given all finished missions and those in flight."""


@dataclass(frozen=True)
class SamplerSettings:
    """What every sampler is built from."""

    problem: Problem
    seed: int
    initial: int  # size of the initial design, the default configuration included
    goal: Goal = field(default_factory=Goal)
    # Missions of the search; under a constraint sampler gp verifies its favourite near their end.
    budget: int | None = None
    arms: tuple[Proposal, ...] = ()  # missions of the plain plans, which come first; none: one of the default
    earlier: EarlierMissions | None = None  # missions run before the campaign, for sampler gp
    trusted_default: bool = False  # sampler gp: chosen by hand, so its design may stay near it

    @property
    def first(self) -> int:
        """How many missions come before the design."""
        return max(1, len(self.arms))


def derived_seed(seed: int, number: int) -> int:
    """Return the seed of the proposal for trial ``number``, mixed from both."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0]) % (2**31)


def missions_asked(history: Sequence[Observation], pending: Sequence[Observation]) -> int:
    """Return how many missions have been asked for: the number of the next one."""
    return len(history) + len(pending)


def initial_proposal(settings: SamplerSettings, number: int, sampler: str) -> Proposal:
    """Return mission ``number`` of a design that needs no outcomes: the plain plans', then a Sobol sequence."""
    if number < len(settings.arms):
        arm = settings.arms[number]
        return dataclasses.replace(arm, metadata={"sampler": sampler, **arm.metadata})
    if number == 0:
        return Proposal(dict(settings.problem.default), {"sampler": sampler, "phase": "default"})
    point = number - settings.first
    metadata = {"sampler": sampler, "phase": "initial design", "point": point}
    return Proposal(sobol_point(settings.problem.space, settings.seed, point), metadata)


@dataclass(frozen=True)
class PlainSampler:
    """A scrambled Sobol sequence, or uniform draws from the unit cube: it learns nothing."""

    settings: SamplerSettings
    name: str  # sobol or random

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        s, number = self.settings, missions_asked(history, pending)
        if self.name == "sobol" or number < s.first:
            return initial_proposal(s, number, self.name)
        rng = np.random.default_rng(derived_seed(s.seed, number))
        space = s.problem.space
        values = space.from_unit(rng.random(space.dimension))
        return Proposal(values, {"sampler": self.name, "phase": "random"})


def in_flight(
    settings: SamplerSettings,
    history: Sequence[Observation],
    running: Sequence[Observation],
    proposal: Proposal,
) -> Observation:
    """Return a proposal as a pending mission, for the proposal after it."""
    number = missions_asked(history, running)
    problem = settings.problem
    instance, replicate = next_block(problem.instances, problem.replicates, [*history, *running], proposal)
    return Observation(number, proposal.values, instance.rock, replicate, condition=instance.condition)


def ask_many(
    sampler: Sampler,
    settings: SamplerSettings,
    history: Sequence[Observation],
    pending: Sequence[Observation],
    count: int,
) -> list[Proposal]:
    """Return ``count`` proposals, each knowing those before."""
    if (at_once := getattr(sampler, "ask_many", None)) is not None:
        return list(at_once(history, pending, count))
    proposals, running = list[Proposal](), list(pending)
    for _ in range(count):
        proposals.append(sampler.ask(history, running))
        running.append(in_flight(settings, history, running, proposals[-1]))
    return proposals


# A class each, made of its settings and its name.
BUILT_IN = {
    "gp": "tuner.samplers.gp:GPSampler",
    "sobol": "tuner.samplers.base:PlainSampler",
    "random": "tuner.samplers.base:PlainSampler",
}
SAMPLERS = Registry("samplers", BUILT_IN)


def make_sampler(name: str, settings: SamplerSettings) -> Sampler:
    """Return the sampler called ``name``.

    Raises `UserError`: no such sampler, or one (of a plug-in) that cannot handle the search space.
    """
    sampler: Sampler = SAMPLERS.load(name, BUILT_IN)(settings, name)
    return sampler
