"""What to fly next: log noisy expected improvement of the mean over rocks (Ament et al., NeurIPS 2023)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.optim import optimize_acqf, optimize_acqf_mixed
from botorch.sampling import SobolQMCNormalSampler
from botorch.utils.sampling import draw_sobol_samples

from nbv.types import Floats
from tuner.search_space import Values
from tuner.surrogate import RockMeanGP, numerics

RESTARTS = 6
RAW_SAMPLES = 128
MONTE_CARLO_SAMPLES = 128
MAX_ITERATIONS = 100
# Mixed spaces: the continuous part is optimised under this many of the best discrete combinations.
DISCRETE_COMBINATIONS = 8


def propose(
    model: RockMeanGP, pending: Sequence[Mapping[str, Any]], seed: int
) -> tuple[Values, dict[str, float]]:
    """The configuration with the largest acquisition value.

    Missions in flight (``pending`` configurations) count as points whose outcome is not known yet, so that
    simultaneous proposals differ. Returns the values and figures that explain them: the acquisition value and
    the model's mean and standard deviation there (objective's unit, larger is better).
    """
    with numerics(seed):
        acquisition = _acquisition(model, pending, seed)
        position, score = _maximise(model, acquisition, seed)
    values = model.space.from_unit(position)
    belief = model.posterior([values])
    return values, {
        "log_nei": score,
        "predicted_mean": float(belief.mean[0]),
        "predicted_sd": float(belief.sd[0]),
    }


def _acquisition(
    model: RockMeanGP, pending: Sequence[Mapping[str, Any]], seed: int
) -> qLogNoisyExpectedImprovement:
    x_pending = model.inputs(np.array([model.space.to_unit(v) for v in pending])) if pending else None
    return qLogNoisyExpectedImprovement(
        model.model,
        X_baseline=model.inputs(np.unique(model.unit, axis=0)),
        sampler=SobolQMCNormalSampler(torch.Size([MONTE_CARLO_SAMPLES]), seed=seed),
        X_pending=x_pending,
        prune_baseline=True,
    )


def _maximise(
    model: RockMeanGP, acquisition: qLogNoisyExpectedImprovement, seed: int
) -> tuple[Floats, float]:
    """Best (d,) unit position, exactly a configuration, and its acquisition value."""
    d = model.space.dimension
    # The last two columns are rock and slot: everything is compared without their offsets.
    nowhere = dict(enumerate(model.inputs(np.zeros((1, d)))[0, d:].tolist(), start=d))
    bounds = torch.zeros(2, d + len(nowhere), dtype=torch.float64)
    bounds[1, :d] = 1.0
    bounds[:, d:] = torch.tensor(list(nowhere.values()), dtype=torch.float64)
    options = {"seed": seed, "maxiter": MAX_ITERATIONS}
    discrete = model.space.discrete_dimensions
    if not discrete:
        best, score = optimize_acqf(
            acquisition, bounds, 1, RESTARTS, RAW_SAMPLES, options=options, fixed_features=nowhere
        )
        return best[0, :d].numpy(), float(score)
    raw = draw_sobol_samples(bounds[:, :d], RAW_SAMPLES * 4, 1, seed=seed).squeeze(1).numpy()
    snapped = model.inputs(np.array([model.space.snap(x) for x in raw])).unsqueeze(1)
    with torch.no_grad():
        scores = acquisition(snapped)
    if len(discrete) == d:
        index = int(scores.argmax())
        return snapped[index, 0, :d].numpy(), float(scores[index])
    combinations: list[dict[int, float]] = []
    for index in scores.argsort(descending=True).tolist():
        fixed = {**{i: float(snapped[index, 0, i]) for i in discrete}, **nowhere}
        if fixed not in combinations:
            combinations.append(fixed)
        if len(combinations) == DISCRETE_COMBINATIONS:
            break
    best, score = optimize_acqf_mixed(
        acquisition, bounds, 1, fixed_features_list=combinations, num_restarts=2,
        raw_samples=RAW_SAMPLES // 4, options=options,
    )  # fmt: skip
    return best[0, :d].numpy(), float(score)
