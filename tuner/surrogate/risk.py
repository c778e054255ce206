"""What is tuned over worlds: the mean outcome, or that of the worst world.

Risk is over the training worlds' own landscapes, so it needs a surrogate with ``own_landscapes``: where rocks differ by
an offset and a scale alone, every measure has its optimum at the same configuration. Outcomes enter in the
objective's unit: a rock that is hard for every configuration counts as it would for a user.
"""

from __future__ import annotations

import torch

from tuner.problem.options import Risk


def risk_of(outcomes: torch.Tensor, risk: Risk) -> torch.Tensor:
    """(...,) measure of (..., worlds) outcomes, larger is better."""
    return outcomes.mean(-1) if risk == "mean" else outcomes.amin(-1)
