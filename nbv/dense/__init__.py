"""The dense stage: depth maps from posed photographs, checked against each other and fused."""

from nbv.dense.cuda import best_dense_stage, patchmatch_runs
from nbv.dense.interface import DepthBackend
from nbv.dense.reconstruct import dense_cloud, make_backend

__all__ = [
    "DepthBackend",
    "best_dense_stage",
    "dense_cloud",
    "make_backend",
    "patchmatch_runs",
]
