"""Baseline-aware repair (B-aware): weak points, seen from angles that are new to them."""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.scorers.repair import repair
from nbv.scorers.repair_single import precision, repair_single
from nbv.scorers.scorer import Scorer, eq_1, falling
from nbv.scorers.shared import SharedTerms
from nbv.scorers.weakness import weakness
from nbv.types import CandidatePool, Floats, Ints

MIN_POINTS_SINGLE = 300  # rounding errors of fewer points do not cancel well, and there is little to gain


def repair_share(terms: SharedTerms, pool: CandidatePool, config: MissionConfig) -> Floats:
    """Eq. 6 to 8: (C,) share of all weakness in the box that each candidate would repair.

    Worked out in single precision first, and in double precision for the candidates that this cannot put in
    order: the order is that of double precision throughout.
    """
    box, b_aware = terms.box, config.b_aware
    weak = weakness(box.points_m, box.track_lengths, box.reprojection_error_px, b_aware)[terms.order]
    angles = (b_aware.theta_low_deg, b_aware.theta_saturation_deg)

    def exactly(columns: slice | Ints) -> Floats:
        return repair(terms.visible[:, columns], weak, pool.positions_m[columns], terms.ordered, *angles)

    error = precision(*angles)
    if len(box.points_m) < MIN_POINTS_SINGLE or not np.isfinite(error):
        return exactly(slice(None))
    main = repair_single(terms.visible, weak, pool.positions_m, box, terms.order, *angles)
    scores = eq_1(main, terms, b_aware.weights)
    order = falling(scores)
    close = np.abs(np.diff(scores[order])) <= 2.0 * error * b_aware.weights.main + 1e-11
    unsettled = order[np.append(close, False) | np.append(False, close)]
    if len(unsettled):
        main[unsettled] = exactly(unsettled)
    return main


B_AWARE = Scorer("b-aware", repair_share, weights=lambda config: config.b_aware.weights)
