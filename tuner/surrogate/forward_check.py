"""How well missions were predicted before they were flown, and how wide calibrated intervals are.

Leaving one out is kind to a model: its neighbours stay. A search goes where the model hopes for something that it has
not seen, and there its intervals are too narrow wherever the landscape is rougher than where it came from. No prior
mends that for every landscape; the missions themselves tell. The next standardised residual is taken for normal with a
variance that nobody knows, whose prior is a scaled inverse chi-square one worth ``PRIOR_COUNT`` residuals of mean square
1. Given n residuals, its prediction is Student's t with ``PRIOR_COUNT`` + n degrees of freedom, its scale the root mean
square of those and the prior's (Gelman et al., Bayesian Data Analysis, 3rd ed., sections 2.6 and 3.2).

Sampler gp keeps what it predicted of a mission with the mission, so the check fits nothing again. Missions of other
samplers say nothing; then the prior decides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from nbv.errors import UserError
from nbv.types import Floats
from tuner.problem.observations import PREDICTED, Observation
from tuner.surrogate.numerics import NORMAL_95

PRIOR_COUNT = 5.0
# A count of photographs is the same in the first missions and then is not: what was certain is wrong by any number of
# standard deviations, and no later interval would say anything again.
LARGEST_Z = 8.0


def widening(z: Floats) -> Floats:
    """Return (n + 1,) factors of the standard deviations before each of (n,) standardised residuals, and after the last."""
    squares = np.concatenate([[0.0], np.cumsum(np.asarray(z, dtype=float) ** 2)])
    factors: Floats = np.sqrt((PRIOR_COUNT + squares) / (PRIOR_COUNT + np.arange(len(squares))))
    return factors


def half_widths_95(z: Floats) -> Floats:
    """Return (n + 1,) half-widths of calibrated 95 % intervals, in standard deviations of the model.

    Before each of (n,) standardised residuals, by those before it, and after the last.
    """
    factors = widening(z)
    widths: Floats = special.stdtrit(PRIOR_COUNT + np.arange(len(factors)), 0.975) * factors
    return widths


@dataclass(frozen=True)
class Calibration:
    """What the missions so far say about the model's intervals."""

    z: Floats  # (n,) standardised residuals of the predictions, in the order of the missions; n may be 0

    @property
    def half_width_95(self) -> float:
        """Half-width of a calibrated 95 % interval, in the model's standard deviations."""
        return float(half_widths_95(self.z)[-1])

    def interval_95(self, mean: float, sd: float) -> tuple[float, float]:
        """Return the calibrated 95 % interval of a quantity with posterior ``mean`` and ``sd``."""
        return mean - self.half_width_95 * sd, mean + self.half_width_95 * sd

    def probability_positive(self, mean: float, sd: float) -> float:
        """Return the calibrated probability that the quantity is above 0; a half where the model knows it to be 0."""
        if sd <= 1e-12:
            return 0.5
        factor = float(widening(self.z)[-1])
        return float(special.stdtr(PRIOR_COUNT + len(self.z), mean / (factor * sd)))

    def to_dict(self) -> dict[str, float | None]:
        """Return the figures for a report; shares are None before the first prediction."""
        share = float(np.mean(np.abs(self.z) <= NORMAL_95)) if len(self.z) else None
        calibrated = float(np.mean(np.abs(self.z) <= half_widths_95(self.z)[:-1])) if len(self.z) else None
        return {
            "missions": len(self.z),
            "coverage_95": share,
            "coverage_95_calibrated": calibrated,
            "factor": float(widening(self.z)[-1]),
            "half_width_95": self.half_width_95,
        }


def calibration(history: Sequence[Observation]) -> Calibration:
    """Return the calibration after ``history``. ``UserError`` where the ledger has something else than a prediction."""
    predicted = [
        (o.outcome, *_prediction(o))
        for o in history
        if o.outcome is not None and PREDICTED in o.sampler_state
    ]
    z = np.array([(outcome - mean) / sd for outcome, mean, sd in predicted])
    return Calibration(np.clip(z, -LARGEST_Z, LARGEST_Z))


def _prediction(mission: Observation) -> tuple[float, float]:
    value = mission.sampler_state[PREDICTED]
    try:
        mean, sd = (float(part) for part in value)
    except (TypeError, ValueError):
        mean = sd = math.nan
    if math.isfinite(mean) and math.isfinite(sd) and sd > 0:
        return mean, sd
    raise UserError(
        f"the ledger says {value!r} was predicted for trial {mission.number}, which is no mean and standard deviation; "
        "restore the ledger"
    )
