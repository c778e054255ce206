"""Configurations against baselines on common rocks, with paired statistics."""

from tuner.evaluation.baselines import baseline_configs, tuned_configs
from tuner.evaluation.comparison import ComparisonTable, comparison_table
from tuner.evaluation.flying import EvaluationEvent, EvaluationRun, run_evaluation
from tuner.evaluation.plan import EvaluationPlan

__all__ = [
    "ComparisonTable",
    "EvaluationEvent",
    "EvaluationPlan",
    "EvaluationRun",
    "baseline_configs",
    "comparison_table",
    "run_evaluation",
    "tuned_configs",
]
