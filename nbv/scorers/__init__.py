"""The scorers: arrays in, rankings out. `score_pool` is what the mission calls."""

from nbv.scorers.scorer import SharedTerms, box_points, rank_b_aware, rank_covis, score_pool, shared_terms

__all__ = ["SharedTerms", "box_points", "rank_b_aware", "rank_covis", "score_pool", "shared_terms"]
