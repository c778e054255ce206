"""The dense stage: depth maps from posed photographs, checked against each other and fused."""

from nbv.dense.reconstruct import make_backend, patchmatch_runs, with_best_dense_stage
from nbv.dense.stereo import PosedViews

__all__ = ["PosedViews", "make_backend", "patchmatch_runs", "with_best_dense_stage"]
