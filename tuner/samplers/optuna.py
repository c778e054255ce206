"""Samplers of Optuna, and search spaces as Optuna knows them."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.trial import FrozenTrial, TrialState, create_trial

from tuner.problem.observations import Observation, Proposal
from tuner.problem.search_space import Parameter, SearchSpace
from tuner.problem.standardise import RockStandardiser, winsorised
from tuner.samplers.base import SamplerSettings, derived_seed, initial_proposal, missions_asked


@dataclass(frozen=True)
class OptunaSampler:
    """An Optuna sampler fed with the whole history, outcomes standardised per instance."""

    settings: SamplerSettings
    name: str  # tpe or optuna-gp

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        number = missions_asked(history, pending)
        if number < self.settings.initial:
            return initial_proposal(self.settings, number, self.name)
        verbosity = optuna.logging.get_verbosity()
        optuna.logging.set_verbosity(logging.ERROR)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                study = optuna.create_study(direction="maximize", sampler=self._sampler(number))
                study.add_trials(self._replay(history, pending))
                space = self.settings.problem.space
                values = space.settled(study.ask(distributions(space)).params)
        finally:
            optuna.logging.set_verbosity(verbosity)
        return Proposal(values, {"sampler": self.name, "phase": "model"})

    def _sampler(self, number: int) -> optuna.samplers.BaseSampler:
        seed, initial = derived_seed(self.settings.seed, number), self.settings.initial
        if self.name == "tpe":
            return optuna.samplers.TPESampler(
                seed=seed, n_startup_trials=initial, multivariate=True, constant_liar=True
            )
        return optuna.samplers.GPSampler(seed=seed, n_startup_trials=initial)

    def _replay(self, history: Sequence[Observation], pending: Sequence[Observation]) -> list[FrozenTrial]:
        feasible = [o for o in history if o.outcome is not None]
        instances = [o.instance for o in feasible]
        outcomes = winsorised(instances, [o.outcome or 0.0 for o in feasible])
        standard = RockStandardiser.fit(instances, outcomes).standardise(instances, outcomes)
        value_of = {o.number: float(z) for o, z in zip(feasible, standard)}
        known, running = distributions(self.settings.problem.space), {p.number for p in pending}

        def replayed(mission: Observation) -> FrozenTrial:
            value = value_of.get(mission.number)
            state = TrialState.FAIL if value is None else TrialState.COMPLETE
            if mission.number in running:
                state = TrialState.RUNNING
            return create_trial(state=state, value=value, params=dict(mission.values), distributions=known)

        missions: list[Observation] = [*history, *pending]
        return [replayed(mission) for mission in sorted(missions, key=lambda m: m.number)]


def distributions(space: SearchSpace) -> dict[str, BaseDistribution]:
    """Return Optuna distributions by path, of the same sets as the parameters."""
    return {parameter.path: _distribution(parameter) for parameter in space.parameters}


def _distribution(parameter: Parameter) -> BaseDistribution:
    if parameter.kind == "categorical":
        return CategoricalDistribution(parameter.choices)
    log = parameter.scale == "log"
    if parameter.kind == "int":
        return IntDistribution(int(parameter.low), int(parameter.high), log=log)
    return FloatDistribution(parameter.low, parameter.high, log=log)
