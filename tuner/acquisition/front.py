"""Two objectives at once: what to fly next, and the configurations between which one has to choose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch
from botorch.acquisition.multi_objective import logei
from botorch.models import ModelListGP
from botorch.sampling import SobolQMCNormalSampler
from botorch.utils.multi_objective.hypervolume import infer_reference_point
from botorch.utils.multi_objective.pareto import is_non_dominated

from nbv.types import Floats
from tuner.acquisition.propose import maximise
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace, Values
from tuner.problem.worlds import Place
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.numerics import numerics
from tuner.surrogate.settings import SurrogateSettings

MONTE_CARLO_SAMPLES = 64
# BoTorch would compile a C++ kernel in the middle of a campaign: minutes without a word on a slow machine, and for
# ever where an earlier compilation was killed and left its lock. Its Python path gives the same numbers.
logei._load_attempted = True


@dataclass(frozen=True)
class FrontPoint:
    """A configuration that no other flown one beats in both objectives, by posterior means over the rocks."""

    values: dict[str, Any]
    first: float  # metrics' units, as measured
    first_sd: float
    second: float
    second_sd: float

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return asdict(self)


def two_models(
    space: SearchSpace,
    observations: Sequence[Observation],
    places: Sequence[Place],
    seed: int,
    settings: SurrogateSettings | None = None,
) -> tuple[RockMeanGP, RockMeanGP]:
    """One surrogate per objective, on the missions that have both. ``ValueError`` where there are none."""
    both = [o for o in observations if o.outcome is not None and o.second is not None]
    first = RockMeanGP(space, both, places, seed, settings)
    second = RockMeanGP(space, [replace(o, outcome=o.second) for o in both], places, seed, settings)
    return first, second


def propose_for_front(
    models: tuple[RockMeanGP, RockMeanGP], pending: Sequence[Mapping[str, Any]], seed: int
) -> tuple[Values, dict[str, float]]:
    """The configuration with the largest log noisy expected hypervolume improvement (Ament et al., NeurIPS 2023)."""
    first, second = models
    with numerics(seed):
        baseline = first.inputs(np.unique(first.unit, axis=0))
        joint = ModelListGP(first.model, second.model)
        with torch.no_grad():
            level = joint.posterior(baseline).mean
        acquisition = logei.qLogNoisyExpectedHypervolumeImprovement(
            joint,
            ref_point=infer_reference_point(level[is_non_dominated(level)]),
            X_baseline=baseline,
            sampler=SobolQMCNormalSampler(torch.Size([MONTE_CARLO_SAMPLES]), seed=seed),
            prune_baseline=True,
            X_pending=first.inputs(np.array([first.space.to_unit(v) for v in pending])) if pending else None,
        )
        position, score = maximise(first, acquisition, seed)
    return first.space.from_unit(position), {"log_nehvi": score}


def flown_in_both(
    models: tuple[RockMeanGP, RockMeanGP], objectives: tuple[Objective, Objective]
) -> list[FrontPoint]:
    """What the models believe of every configuration flown, best first objective first."""
    first = models[0]
    configurations = [first.space.from_unit(u) for u in np.unique(first.unit, axis=0)]
    one, two = (model.posterior(configurations) for model in models)
    signs = objectives[0].sign, objectives[1].sign
    return [
        FrontPoint(
            configurations[i],
            signs[0] * float(one.mean[i]),
            float(one.sd[i]),
            signs[1] * float(two.mean[i]),
            float(two.sd[i]),
        )
        for i in np.argsort(-one.mean, kind="stable")
    ]


def pareto_front(points: Sequence[FrontPoint], objectives: tuple[Objective, Objective]) -> list[FrontPoint]:
    """Those that no other one dominates, in the same order."""
    level: Floats = np.array([[p.first, p.second] for p in points]) * [o.sign for o in objectives]
    return [p for p, own in zip(points, level) if not ((level >= own).all(1) & (level > own).any(1)).any()]
