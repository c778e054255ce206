"""The scorers: arrays in, rankings out. `rank_candidates` is what the mission calls."""

from nbv.scorers.scorer import (
    SharedTerms,
    box_points,
    rank_b_aware,
    rank_candidates,
    rank_covis,
    shared_terms,
)

__all__ = ["SharedTerms", "box_points", "rank_b_aware", "rank_candidates", "rank_covis", "shared_terms"]
