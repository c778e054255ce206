"""Predicted: how much of what the dense cloud will lack a candidate reconstructs, for each photograph. It is not in the paper."""

from __future__ import annotations

from nbv.config import MissionConfig
from nbv.scorers.prediction import predict
from nbv.scorers.scorer import Scorer, SharedTerms
from nbv.types import CandidatePool, Floats


def expected_gain_share(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """(C,) share of what will be missing that a photograph from each candidate reconstructs."""
    prediction = terms.prediction or predict(terms.model, config)
    return prediction.expected_gain(pool.positions_m, terms.left)


PREDICTED = Scorer("predicted", expected_gain_share, weights=lambda config: config.predicted.weights)
