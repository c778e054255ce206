"""Predicted repair: the view that most helps where the dense cloud is predicted to stay incomplete. Ours, not the paper's."""

from __future__ import annotations

from nbv.config import MissionConfig
from nbv.scorers.prediction import predict
from nbv.scorers.scorer import Scorer
from nbv.scorers.shared import SharedTerms
from nbv.types import CandidatePool, Floats


def mended_share(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """(C,) share of what will be missing that each candidate helps to mend (`nbv.scorers.prediction`)."""
    return predict(terms.box.points_m, terms.box.camera_centers_m, config).mends(pool.positions_m)


# Its other weights are those of the other scorer of ours.
PREDICTED = Scorer("predicted", mended_share, weights=lambda config: config.matchable.weights)
