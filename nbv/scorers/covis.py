"""Co-visibility (Covis): how much of the existing sparse model a candidate would see again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.config import MissionConfig
from nbv.scorers.scorer import Scorer
from nbv.scorers.shared import SharedTerms
from nbv.types import CandidatePool, Floats


def co_visibility(visible: NDArray[np.bool_]) -> Floats:
    """Eq. 5: (C,) fraction of the P > 0 tracked points in the box that each candidate sees.

    ``visible`` is (P, C).
    """
    n_points, n_candidates = visible.shape
    as_bytes = np.ascontiguousarray(visible).view(np.uint8)
    # 255 ones fit into a byte, and bytes add up fastest, in long rows.
    together = -(-n_points // 255)
    whole = n_points // together * together
    counts = np.add.reduce(as_bytes[:whole].reshape(-1, together * n_candidates), axis=0, dtype=np.uint8)
    total = np.add.reduce(counts.reshape(together, n_candidates), axis=0, dtype=np.int64)
    total += np.add.reduce(as_bytes[whole:], axis=0, dtype=np.int64)
    return total / n_points


def share_seen(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """Eq. 5 of a state."""
    return co_visibility(terms.visible)


COVIS = Scorer("covis", share_seen, weights=lambda config: config.covis.weights)
