"""When Phase 2 ends before its budget is used: what ``stop.criterion`` names."""

from __future__ import annotations

from nbv.config import MissionConfig
from nbv.scorers.prediction import predict
from nbv.types import SparseModel


def suffices(model: SparseModel, d95_m: float, config: MissionConfig) -> bool:
    """Whether the photographs so far will do.

    ``knn`` and ``both``: the sparse cloud is dense enough (the paper's). ``predicted``: the dense cloud is predicted to
    reach ``stop.predicted_percent``.
    """
    stop = config.stop
    if stop.criterion in ("both", "knn"):
        return d95_m <= stop.knn_threshold_m
    if stop.criterion == "predicted":
        prediction = predict(model.points_m, model.camera_centers_m, config)
        return prediction.f_score_percent >= stop.predicted_percent
    return False
