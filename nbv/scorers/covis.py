"""Co-visibility (Covis): how much of the existing sparse model a candidate would see again."""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.scorers.scorer import Scorer, SharedTerms
from nbv.types import CandidatePool, Floats


def co_visibility(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """Eq. 5: (C,) fraction of the P > 0 tracked points in the box that each candidate sees."""
    return np.count_nonzero(terms.visible, axis=0) / len(terms.visible)


COVIS = Scorer("covis", co_visibility, weights=lambda config: config.covis.weights)
