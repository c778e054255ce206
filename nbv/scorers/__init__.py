"""The scorers: arrays in, rankings out. `rank_candidates` is what the mission calls.

A scorer is a main term with weights (`Scorer`); Eq. 1 and the terms that all share are written once. Those that a
configuration may name stand in ``registry``.
"""

from nbv.scorers.b_aware import B_AWARE
from nbv.scorers.covis import COVIS
from nbv.scorers.registry import PAPER_SCORERS, rank_candidates
from nbv.scorers.scorer import Scorer, SharedTerms, box_points

__all__ = [
    "B_AWARE",
    "COVIS",
    "PAPER_SCORERS",
    "Scorer",
    "SharedTerms",
    "box_points",
    "rank_candidates",
]
