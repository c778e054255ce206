"""Cleaning, ground truth and metrics. Only this room and the oracle gates see the true mesh."""

from nbv.evaluation.evaluate import Evaluation, evaluate_cloud
from nbv.evaluation.ground_truth import camera_shell, ground_truth

__all__ = ["Evaluation", "camera_shell", "evaluate_cloud", "ground_truth"]
