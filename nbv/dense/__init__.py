"""The dense stage: depth maps from posed photographs, checked against each other and fused."""

from nbv.dense.reconstruct import dense_cloud, make_backend, patchmatch_runs, with_best_dense_stage
from nbv.dense.views import DenseBackend, PosedViews

__all__ = [
    "DenseBackend",
    "PosedViews",
    "dense_cloud",
    "make_backend",
    "patchmatch_runs",
    "with_best_dense_stage",
]
