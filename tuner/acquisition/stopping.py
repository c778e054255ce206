"""When a campaign may stop: what is left to gain cannot be told apart by the final comparison.

The expected gain left is E[max f - f(recommended)] under the posterior of the mean over rocks, by joint draws at
many configurations (an expected simple regret over a finite set: a little too small). The noise of the comparison is
the standard deviation of the difference of two configurations that have flown every rock with every replicate.
Each proposal of the GP carries both figures; the rule reads them from the ledger, so that a resumed campaign
decides alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from botorch.utils.sampling import draw_sobol_samples

from tuner.problem.options import Risk
from tuner.surrogate.model import RockMeanGP, numerics

CONSECUTIVE = 3
_GLOBAL, _NEAR, _DRAWS = 192, 64, 512
_NEAR_SD = 0.1


def expected_gain_left(model: RockMeanGP, seed: int, risk: Risk = "mean") -> float:
    """E[max f - f(recommended)], objective's unit; the recommended one is the best posterior mean flown."""
    d = model.space.dimension
    with numerics(seed):
        cube = torch.stack([torch.zeros(d), torch.ones(d)]).to(torch.float64)
        spread = draw_sobol_samples(cube, _GLOBAL, 1, seed=seed).squeeze(1).numpy()
    seen = np.unique(model.unit, axis=0)
    belief = model.posterior([model.space.from_unit(u) for u in seen], risk)
    best = int(belief.mean.argmax())
    rng = np.random.default_rng(seed)
    near = np.clip(seen[best] + _NEAR_SD * rng.standard_normal((_NEAR, d)), 0.0, 1.0)
    everywhere = np.concatenate([seen[best : best + 1], seen, spread, near])
    joint = model.posterior([model.space.from_unit(u) for u in everywhere], risk)
    draws = rng.multivariate_normal(joint.mean, joint.covariance, _DRAWS, check_valid="ignore", method="eigh")
    return float((draws.max(axis=1) - draws[:, 0]).mean())


def comparison_noise(model: RockMeanGP, replicates: int) -> float:
    """Standard deviation of the difference of two configurations over all rocks and replicates, paired by slot."""
    return model.noise_sd * math.sqrt(2 / (len(model.rocks) * replicates))


def settled(why: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the last proposals, in order, each found less left to gain than the comparison's noise."""
    last = list(why)[-CONSECUTIVE:]
    return len(last) == CONSECUTIVE and all(
        w.get("gain_left") is not None and w["gain_left"] < w["comparison_noise"] for w in last
    )
