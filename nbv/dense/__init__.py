"""The dense stage: depth maps from posed photographs, checked against each other and fused."""

from nbv.dense.reconstruct import best_dense_stage, dense_cloud, make_backend, patchmatch_runs
from nbv.dense.views import DenseBackend, PosedViews

__all__ = [
    "DenseBackend",
    "PosedViews",
    "best_dense_stage",
    "dense_cloud",
    "make_backend",
    "patchmatch_runs",
]
