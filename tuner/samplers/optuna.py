"""Samplers of Optuna."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import optuna
from optuna.trial import TrialState, create_trial

from nbv.errors import UserError
from tuner.problem.observations import Observation, Pending, Proposal
from tuner.problem.standardise import RockStandardiser
from tuner.samplers.base import SamplerSettings, asks, derived_seed, initial_proposal
from tuner.samplers.distributions import distributions


@dataclass(frozen=True)
class OptunaSampler:
    """An Optuna sampler fed with the whole history, outcomes standardised per world."""

    settings: SamplerSettings
    name: str
    build: Callable[[SamplerSettings, int], optuna.samplers.BaseSampler] = field(repr=False)

    def ask(self, history: Sequence[Observation], pending: Sequence[Pending]) -> Proposal:
        """Return Optuna's suggestion."""
        number = asks(history, pending)
        # CMA-ES starts from the default configuration and adapts from there; a space-filling design is no use.
        if number < (1 if self.name == "cmaes" else self.settings.initial):
            return initial_proposal(self.settings, number, self.name)
        verbosity = optuna.logging.get_verbosity()
        optuna.logging.set_verbosity(logging.ERROR)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                sampler = self.build(self.settings, derived_seed(self.settings.seed, number))
                study = optuna.create_study(direction="maximize", sampler=sampler)
                study.add_trials(self._replay(history, pending))
                trial = study.ask(distributions(self.settings.space))
        finally:
            optuna.logging.set_verbosity(verbosity)
        sampler_state = dict(study.get_trials(deepcopy=False)[trial.number].system_attrs)
        why = {"sampler": self.name, "phase": "model"}
        return Proposal(dict(trial.params), why, sampler_state=sampler_state)

    def _replay(
        self, history: Sequence[Observation], pending: Sequence[Pending]
    ) -> list[optuna.trial.FrozenTrial]:
        feasible = [o for o in history if o.outcome is not None]
        worlds = [o.world for o in feasible]
        outcomes = np.array([o.outcome for o in feasible], dtype=float)
        standard = RockStandardiser.fit(worlds, outcomes).standardise(worlds, outcomes)
        value_of = {o.number: float(z) for o, z in zip(feasible, standard)}
        known = distributions(self.settings.space)

        def replay(
            values: Mapping[str, Any], state: TrialState, value: float | None, sampler_state: Any
        ) -> Any:
            return create_trial(
                state=state,
                value=value,
                params=dict(values),
                distributions=known,
                system_attrs=dict(sampler_state),
            )

        trials: list[tuple[int, optuna.trial.FrozenTrial]] = []
        for o in history:
            value = value_of.get(o.number)
            state = TrialState.FAIL if value is None else TrialState.COMPLETE
            trials.append((o.number, replay(o.values, state, value, o.sampler_state)))
        for p in pending:
            trials.append((p.number, replay(p.values, TrialState.RUNNING, None, p.sampler_state)))
        return [trial for _, trial in sorted(trials, key=lambda pair: pair[0])]


def _tpe(settings: SamplerSettings, seed: int) -> optuna.samplers.BaseSampler:
    return optuna.samplers.TPESampler(
        seed=seed, n_startup_trials=settings.initial, multivariate=True, constant_liar=True
    )


def _cmaes(settings: SamplerSettings, seed: int) -> optuna.samplers.BaseSampler:
    return optuna.samplers.CmaEsSampler(
        x0=dict(settings.default), seed=seed, n_startup_trials=1, warn_independent_sampling=False
    )


def _optuna_gp(settings: SamplerSettings, seed: int) -> optuna.samplers.BaseSampler:
    return optuna.samplers.GPSampler(seed=seed, n_startup_trials=settings.initial)


_BUILDERS = {"tpe": _tpe, "cmaes": _cmaes, "optuna-gp": _optuna_gp}


def make_optuna_sampler(name: str, settings: SamplerSettings) -> OptunaSampler:
    """Return Optuna's sampler called ``name``.

    Raises
    ------
    UserError
        It cannot handle the search space.
    """
    if name == "cmaes":
        if settings.space.categorical_dimensions:
            raise UserError("sampler cmaes cannot handle categorical parameters; choose gp or tpe")
        if settings.space.dimension < 2:
            raise UserError("sampler cmaes needs at least two parameters; choose gp or tpe")
    return OptunaSampler(settings, name, _BUILDERS[name])
