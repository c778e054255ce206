"""Co-visibility (Covis): how much of the existing sparse model a candidate would see again."""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.scorers.scorer import Scorer
from nbv.scorers.shared import SharedTerms
from nbv.types import Bools, CandidatePool, Floats


def co_visibility(visible: Bools) -> Floats:
    """Eq. 5: (C,) fraction of the P > 0 tracked points in the box that each candidate sees.

    ``visible`` is (P, C).
    """
    return np.count_nonzero(visible, axis=0) / len(visible)


def share_seen(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """Eq. 5 of a state."""
    return co_visibility(terms.visible)


COVIS = Scorer("covis", share_seen, weights=lambda config: config.covis.weights)
