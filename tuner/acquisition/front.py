"""Two objectives at once: what to fly next, and the configurations between which one has to choose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from botorch.acquisition.multi_objective import logei
from botorch.acquisition.multi_objective.objective import MCMultiOutputObjective
from botorch.models import ModelListGP
from botorch.sampling import SobolQMCNormalSampler
from botorch.utils.multi_objective.hypervolume import infer_reference_point
from botorch.utils.multi_objective.pareto import is_non_dominated

from tuner.acquisition.pareto import FrontPoint
from tuner.acquisition.propose import BASELINE, maximise
from tuner.problem.configurations import distinct_configurations
from tuner.problem.exact_costs import Exact, modelled
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace, Values
from tuner.problem.worlds import Place
from tuner.surrogate.known import KnownOutcome
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.numerics import numerics
from tuner.surrogate.settings import SurrogateSettings

MONTE_CARLO_SAMPLES = 64
Outcome = RockMeanGP | KnownOutcome
AT_ONCE = 500  # configurations, of which nothing is asked jointly
# BoTorch would compile a C++ kernel in the middle of a campaign: minutes without a word on a slow machine, and for
# ever where an earlier compilation was killed and left its lock. Its Python path gives the same numbers.
logei._load_attempted = True


def two_models(
    space: SearchSpace,
    observations: Sequence[Observation],
    places: Sequence[Place],
    seed: int,
    settings: SurrogateSettings | None = None,
    exact: Exact | None = None,
) -> tuple[Outcome, Outcome]:
    """Return a model of each objective, on the missions that have both outcomes or failed.

    An objective that the configuration decides is computed, but one of the two is always a surrogate: where both are decided,
    the second one. ``ValueError`` means that there are no such missions.

    Parameters
    ----------
    space
        The search space.
    observations
        Finished missions.
    places
        The training worlds.
    seed
        The seed of the fits.
    settings
        What the surrogates are made of; None: by the search space.
    exact
        What of the objectives the configuration decides.
    """
    both = [o for o in observations if o.outcome is None or o.second is not None]
    exact = exact or Exact()
    if exact.first is not None:
        second = RockMeanGP(space, modelled(both), places, seed, settings)
        return KnownOutcome(space, exact.first), second
    first = RockMeanGP(space, both, places, seed, settings)
    if exact.second is not None:
        return first, KnownOutcome(space, exact.second)
    return first, RockMeanGP(space, modelled(both), places, seed, settings)


def propose_for_front(
    models: tuple[Outcome, Outcome], pending: Sequence[Mapping[str, Any]], seed: int
) -> tuple[Values, dict[str, float]]:
    """The configuration with the largest log noisy expected hypervolume improvement (Ament et al., NeurIPS 2023).

    What the configuration decides is computed at every point.
    """
    own = [model for model in models if isinstance(model, RockMeanGP)]
    carrier = own[0]
    with numerics(seed):
        baseline = carrier.inputs(np.unique(np.concatenate([m.promising(BASELINE) for m in own]), axis=0))
        joint = own[0].model if len(own) == 1 else ModelListGP(*(m.model for m in own))
        objective = _Both(models, baseline)
        with torch.no_grad():
            level = objective(joint.posterior(baseline).mean, baseline)
        acquisition = logei.qLogNoisyExpectedHypervolumeImprovement(
            joint,
            ref_point=infer_reference_point(level[is_non_dominated(level)]),
            X_baseline=baseline,
            sampler=SobolQMCNormalSampler(torch.Size([MONTE_CARLO_SAMPLES]), seed=seed),
            objective=objective,
            prune_baseline=True,
            X_pending=carrier.inputs(np.array([carrier.space.to_unit(v) for v in pending]))
            if pending
            else None,
        )
        position, score = maximise(carrier, acquisition, seed)
    return carrier.space.from_unit(position), {"log_nehvi": score}


class _Both(MCMultiOutputObjective):
    """Both objectives, each on a standardised scale: drawn where there is a surrogate, else computed."""

    def __init__(self, models: tuple[Outcome, Outcome], baseline: torch.Tensor) -> None:
        super().__init__()
        self._models = models
        self._scales = []
        for model in models:
            spread = float(model.at(baseline).std(correction=0)) if isinstance(model, KnownOutcome) else 1.0
            self._scales.append(spread if spread > 0.0 else 1.0)

    def forward(self, samples: torch.Tensor, X: torch.Tensor | None = None) -> torch.Tensor:
        """(..., q, 2) of (..., q, surrogates) draws at (..., q, inputs)."""
        columns, drawn = [], iter(samples.unbind(-1))
        for model, scale in zip(self._models, self._scales):
            if isinstance(model, KnownOutcome):
                assert X is not None
                columns.append((model.at(X) / scale).expand(samples.shape[:-1]))
            else:
                columns.append(next(drawn))
        return torch.stack(columns, dim=-1)


def flown_in_both(
    models: tuple[Outcome, Outcome],
    objectives: tuple[Objective, Objective],
    space: SearchSpace,
    missions: Sequence[Observation],
) -> list[FrontPoint]:
    """Return what is believed, or known, of every configuration flown, the best in the first objective first.

    Parameters
    ----------
    models
        A model of each objective.
    objectives
        Their metrics and directions.
    space
        The search space.
    missions
        The missions that flew the configurations.
    """
    configurations = distinct_configurations(space, missions)
    signs = objectives[0].sign, objectives[1].sign
    points = []
    for begin in range(0, len(configurations), AT_ONCE):
        some = configurations[begin : begin + AT_ONCE]
        one, two = (model.posterior(some) for model in models)
        points += [
            FrontPoint(values, signs[0] * float(m), float(s), signs[1] * float(n), float(t))
            for values, m, s, n, t in zip(some, one.mean, one.sd, two.mean, two.sd)
        ]
    return sorted(points, key=lambda point: -signs[0] * point.first)
