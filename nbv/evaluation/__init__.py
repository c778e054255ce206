"""Cleaning, ground truth and metrics. Only this room and the oracle gates see the true mesh."""

from nbv.evaluation.evaluate import Evaluation, evaluate_cloud
from nbv.evaluation.ground_truth import ground_truth

__all__ = ["Evaluation", "evaluate_cloud", "ground_truth"]
