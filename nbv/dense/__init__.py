"""The dense stage: depth maps from posed photographs, checked against each other and fused."""

from nbv.dense.cuda import best_dense_stage, patchmatch_runs
from nbv.dense.interface import DepthBackend
from nbv.dense.reconstruct import CheckedDepths, check_depths, make_backend

__all__ = [
    "CheckedDepths",
    "DepthBackend",
    "best_dense_stage",
    "check_depths",
    "make_backend",
    "patchmatch_runs",
]
