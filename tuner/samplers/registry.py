"""One ask face for our optimiser and for the baselines.

A sampler is a function of the history, the missions in flight and a seed; it keeps no state of its own, so a
campaign that is resumed proposes what it would have proposed. What a library needs to remember between asks
travels in ``Proposal.memory`` through the ledger and back in the history.

Every sampler starts at the default configuration: each optimiser may know where the paper stands.
"""

from __future__ import annotations

import dataclasses
import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from nbv.errors import UserError
from tuner.problem.objective import RockStandardiser
from tuner.problem.observations import Observation, Pending, Proposal
from tuner.problem.options import Risk
from tuner.problem.search_space import SearchSpace, Values
from tuner.samplers.design import (
    MANY_PARAMETERS,
    near_default,
    places_for_earlier,
    sobol_point,
    stays_near_default,
)
from tuner.samplers.peers import PEER_NAMES, make_peer_sampler, peer_command

if TYPE_CHECKING:
    import optuna

    from tuner.acquisition.propose import SearchSettings
    from tuner.samplers.earlier_missions import EarlierMissions
    from tuner.surrogate.model import SurrogateSettings

MIN_FEASIBLE_FOR_MODEL = 2


class Sampler(Protocol):
    """Proposes the next mission."""

    @property
    def name(self) -> str:
        """As in ``ALL_SAMPLER_NAMES``."""
        ...

    def ask(self, history: Sequence[Observation], pending: Sequence[Pending]) -> Proposal:
        """The next configuration, given all finished missions and those in flight."""
        ...


@dataclass(frozen=True)
class SamplerSettings:
    """What every sampler is built from."""

    space: SearchSpace
    default: Values  # the configuration everything starts from: the paper's
    rocks: tuple[str, ...]  # training rocks
    seed: int
    initial: int  # size of the initial design, the default configuration included
    replicates: int = 1  # per rock, for samplers that choose them
    risk: Risk = "mean"  # of sampler gp
    earlier: EarlierMissions | None = None  # missions flown before the campaign, for sampler gp
    two_objectives: bool = False  # sampler gp: search the front between the objective and the second one
    budget: int | None = None  # missions of the search; sampler gp verifies its favourite near their end
    trusted_default: bool = False  # sampler gp: chosen by hand, so its design may stay near it

    def surrogate(self) -> SurrogateSettings:
        """What sampler gp and the recommendation model."""
        return surrogate_settings(self.space, self.risk)


def surrogate_settings(space: SearchSpace, risk: Risk = "mean") -> SurrogateSettings:
    """The surrogate that goes with a search space and what is tuned over the rocks."""
    from tuner.surrogate.model import SurrogateSettings

    many = space.dimension >= MANY_PARAMETERS
    if risk != "mean":  # about what rocks do not share
        return SurrogateSettings(deviations=True, sparse=many, trend=many)
    return SurrogateSettings(sparse=many, trend=many)


def derived_seed(seed: int, number: int) -> int:
    """Seed of the ask for trial ``number``: a function of both, well mixed."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0]) % (2**31)


def _asks(history: Sequence[Observation], pending: Sequence[Pending]) -> int:
    return len(history) + len(pending)


def _initial_proposal(settings: SamplerSettings, number: int, sampler: str) -> Proposal:
    if number == 0:
        return Proposal(dict(settings.default), {"sampler": sampler, "phase": "default"})
    why = {"sampler": sampler, "phase": "initial design", "point": number - 1}
    return Proposal(sobol_point(settings.space, settings.seed, number - 1), why)


@dataclass(frozen=True)
class SobolSampler:
    """Scrambled Sobol sequence."""

    settings: SamplerSettings
    name: str = "sobol"

    def ask(self, history: Sequence[Observation], pending: Sequence[Pending]) -> Proposal:
        """The next point of the sequence."""
        return _initial_proposal(self.settings, _asks(history, pending), self.name)


@dataclass(frozen=True)
class RandomSampler:
    """Uniform in the unit cube."""

    settings: SamplerSettings
    name: str = "random"

    def ask(self, history: Sequence[Observation], pending: Sequence[Pending]) -> Proposal:
        """A fresh uniform draw."""
        number = _asks(history, pending)
        if number == 0:
            return _initial_proposal(self.settings, 0, self.name)
        rng = np.random.default_rng(derived_seed(self.settings.seed, number))
        values = self.settings.space.from_unit(rng.random(self.settings.space.dimension))
        return Proposal(values, {"sampler": self.name, "phase": "random"})


@dataclass(frozen=True)
class GPSampler:
    """Default configuration, initial design, then log noisy expected improvement on the rock-mean GP.

    The design is a Sobol sequence; unless parameters are many every second point stays near a trusted default. Where
    missions were flown before the campaign, the best of them take places of it. Near the end of the budget the favourite
    is flown on slots it has not seen, where that is worth more (``tuner.samplers.verification``).
    """

    settings: SamplerSettings
    name: str = "gp"
    model: SurrogateSettings | None = None  # of the surrogate; None: by the settings' options
    search: SearchSettings | None = None  # of the acquisition's maximum; None: the defaults
    verify: bool = True

    def ask(self, history: Sequence[Observation], pending: Sequence[Pending]) -> Proposal:
        """The maximiser of the acquisition, or the next point of the initial design."""
        s, number = self.settings, _asks(history, pending)
        feasible = [o for o in history if o.feasible]
        if number < s.initial or len(feasible) < MIN_FEASIBLE_FOR_MODEL:
            return self._design(number)
        from tuner.acquisition.propose import propose
        from tuner.samplers.verification import BEGINS, verification
        from tuner.surrogate.model import RockMeanGP

        seed = derived_seed(s.seed, number)
        flying = [p.values for p in pending]
        if s.two_objectives and sum(o.second is not None for o in feasible) >= MIN_FEASIBLE_FOR_MODEL:
            from tuner.acquisition.front import propose_for_front, two_models

            models = two_models(s.space, feasible, s.rocks, seed, self.model or s.surrogate())
            values, figures = propose_for_front(models, flying, seed)
            return Proposal(values, {"sampler": self.name, "phase": "front", **figures})
        own = self.model or s.surrogate()
        model = RockMeanGP(s.space, feasible, s.rocks, seed, own, s.earlier)
        values, figures = propose(model, flying, seed, s.risk, self.search)
        if self.verify and s.budget is not None and number >= BEGINS * s.budget:
            gain, last = figures["expected_gain"], number >= s.budget - len(s.rocks) * s.replicates
            again = verification(
                model, history, pending, s.replicates, gain, s.risk, last=last, default=s.default
            )
            if again is not None:
                return dataclasses.replace(again, why={**figures, **again.why})
        return Proposal(values, {"sampler": self.name, "phase": "model", **figures})

    def _design(self, number: int) -> Proposal:
        s, rank = self.settings, number // 2 - 1
        if number == 0:
            return _initial_proposal(s, 0, self.name)
        places = places_for_earlier(s.initial)
        if number in places and s.earlier is not None and s.earlier.usable:
            place = places.index(number)
            best = s.earlier.best(place + 1)
            if len(best) > place:
                return Proposal(
                    best[place], {"sampler": self.name, "phase": "earlier missions", "rank": place}
                )
        if not stays_near_default(s.space.dimension, s.trusted_default):
            return _initial_proposal(s, number, self.name)
        why: dict[str, Any] = {"sampler": self.name, "phase": "initial design"}
        if number % 2 == 1:
            values = near_default(s.space, s.default, s.seed, number // 2)
            return Proposal(values, {**why, "near": "default", "point": number // 2})
        return Proposal(sobol_point(s.space, s.seed, rank), {**why, "point": rank})


@dataclass(frozen=True)
class OptunaSampler:
    """An Optuna sampler fed with the whole history, outcomes standardised per rock as for our own GP."""

    settings: SamplerSettings
    name: str
    build: Callable[[SamplerSettings, int], optuna.samplers.BaseSampler] = field(repr=False)

    def ask(self, history: Sequence[Observation], pending: Sequence[Pending]) -> Proposal:
        """Optuna's suggestion."""
        number = _asks(history, pending)
        # CMA-ES starts from the default configuration and adapts from there; a space-filling design is no use.
        if number < (1 if self.name == "cmaes" else self.settings.initial):
            return _initial_proposal(self.settings, number, self.name)
        import optuna

        verbosity = optuna.logging.get_verbosity()
        optuna.logging.set_verbosity(logging.ERROR)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                sampler = self.build(self.settings, derived_seed(self.settings.seed, number))
                study = optuna.create_study(direction="maximize", sampler=sampler)
                study.add_trials(self._replay(history, pending))
                trial = study.ask(self.settings.space.distributions())
        finally:
            optuna.logging.set_verbosity(verbosity)
        memory = dict(study.get_trials(deepcopy=False)[trial.number].system_attrs)
        why = {"sampler": self.name, "phase": "model"}
        return Proposal(dict(trial.params), why, memory=memory)

    def _replay(
        self, history: Sequence[Observation], pending: Sequence[Pending]
    ) -> list[optuna.trial.FrozenTrial]:
        from optuna.trial import TrialState, create_trial

        feasible = [o for o in history if o.outcome is not None]
        rocks = [o.rock for o in feasible]
        outcomes = np.array([o.outcome for o in feasible], dtype=float)
        standard = RockStandardiser.fit(rocks, outcomes).standardise(rocks, outcomes)
        value_of = {o.number: float(z) for o, z in zip(feasible, standard)}
        distributions = self.settings.space.distributions()

        def replay(values: Mapping[str, Any], state: TrialState, value: float | None, memory: Any) -> Any:
            return create_trial(
                state=state, value=value, params=dict(values), distributions=distributions,
                system_attrs=dict(memory),
            )  # fmt: skip

        trials: list[tuple[int, optuna.trial.FrozenTrial]] = []
        for o in history:
            value = value_of.get(o.number)
            state = TrialState.FAIL if value is None else TrialState.COMPLETE
            trials.append((o.number, replay(o.values, state, value, o.memory)))
        for p in pending:
            trials.append((p.number, replay(p.values, TrialState.RUNNING, None, p.memory)))
        return [trial for _, trial in sorted(trials, key=lambda pair: pair[0])]


def _tpe(settings: SamplerSettings, seed: int) -> optuna.samplers.BaseSampler:
    import optuna

    return optuna.samplers.TPESampler(seed=seed, n_startup_trials=settings.initial, multivariate=True,
                                      constant_liar=True)  # fmt: skip


def _cmaes(settings: SamplerSettings, seed: int) -> optuna.samplers.BaseSampler:
    import optuna

    return optuna.samplers.CmaEsSampler(x0=dict(settings.default), seed=seed, n_startup_trials=1,
                                        warn_independent_sampling=False)  # fmt: skip


def _optuna_gp(settings: SamplerSettings, seed: int) -> optuna.samplers.BaseSampler:
    import optuna

    return optuna.samplers.GPSampler(seed=seed, n_startup_trials=settings.initial)


_OPTUNA_BUILDERS = {"tpe": _tpe, "cmaes": _cmaes, "optuna-gp": _optuna_gp}
SAMPLER_NAMES = ("gp", "sobol", "random", *_OPTUNA_BUILDERS)  # these are always there
ALL_SAMPLER_NAMES = (*SAMPLER_NAMES, *PEER_NAMES)


def require_sampler(name: str) -> None:
    """Check that what sampler ``name`` needs is installed.

    Raises
    ------
    UserError
        The environment of a peer has not been set up.
    """
    if name in PEER_NAMES:
        peer_command(name)


def make_sampler(name: str, settings: SamplerSettings) -> Sampler:
    """The sampler called ``name``.

    Raises
    ------
    UserError
        No such sampler, or one that cannot handle the search space.
    """
    if name == "gp":
        return GPSampler(settings)
    if name == "sobol":
        return SobolSampler(settings)
    if name == "random":
        return RandomSampler(settings)
    if name in PEER_NAMES:
        return make_peer_sampler(name, settings)
    if name not in _OPTUNA_BUILDERS:
        raise UserError(f"unknown sampler {name!r}; there are {', '.join(ALL_SAMPLER_NAMES)}")
    if name == "cmaes":
        if settings.space.categorical_dimensions:
            raise UserError("sampler cmaes cannot handle categorical parameters; choose gp or tpe")
        if settings.space.dimension < 2:
            raise UserError("sampler cmaes needs at least two parameters; choose gp or tpe")
    return OptunaSampler(settings, name, _OPTUNA_BUILDERS[name])
