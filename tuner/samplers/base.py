"""Our optimiser and the baselines propose missions through one interface.

A sampler is a function of the history, the missions in flight and a seed; it keeps no state of its own, so a
campaign that is resumed proposes what it would have proposed. Every sampler starts with the default configuration and the plain
plans, which a campaign runs with all replicates on every training rock first: each optimiser may know where they stand.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from tuner.problem.goal import Goal
from tuner.problem.observations import Block, Observation, Proposal, configuration_key, next_block
from tuner.problem.problem import Problem
from tuner.samplers.design import sobol_point

if TYPE_CHECKING:
    from tuner.samplers.earlier_missions import EarlierMissions

VERIFICATION_BEGINS = 2 / 3  # of the budget


class Sampler(Protocol):
    """Proposes the next mission."""

    @property
    def name(self) -> str:
        """Its name in `tuner.samplers.registry`."""

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        """Return the next configuration, given all finished missions and those in flight."""


@dataclass(frozen=True)
class SamplerSettings:
    """What every sampler is built from."""

    problem: Problem
    seed: int
    initial: int  # size of the initial design, the default configuration included
    goal: Goal = field(default_factory=Goal)
    budget: int | None = None  # missions of the search; sampler gp verifies its favourite near their end
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
    """Return ``count`` proposals, each knowing those before.

    Where rocks are drawn the default is proposed on every one that it has not run: a gain is not taken for an easy rock.
    """
    at_once, proposals, running = getattr(sampler, "ask_many", None), list[Proposal](), list(pending)
    while (left := count - len(proposals)) > 0:
        if settings.problem.draws_rocks and (block := _without_default(settings, [*history, *running])):
            metadata = {"sampler": sampler.name, "phase": "beside the default"}
            proposed = [Proposal(dict(settings.problem.default), metadata, *block)]
        elif at_once is not None:
            proposed = at_once(history, running, (left + 1) // 2 if settings.problem.draws_rocks else left)
        else:
            proposed = [sampler.ask(history, running)]
        for proposal in proposed:
            running.append(in_flight(settings, history, running, proposal))
        proposals += proposed
    return proposals


def _without_default(settings: SamplerSettings, missions: Sequence[Observation]) -> Block | None:
    """Return the first block on which the default is missing; None after verification has begun."""
    if settings.budget is not None and len(missions) >= VERIFICATION_BEGINS * settings.budget:
        return None
    space, evaluated = settings.problem.space, dict[Block, bool]()
    default = configuration_key(space, settings.problem.default)
    for m in missions:
        block = (m.instance, m.replicate)
        has_default = configuration_key(space, m.values) == default
        evaluated[block] = evaluated.get(block, False) or has_default
    return next((block for block, has_default in evaluated.items() if not has_default), None)
