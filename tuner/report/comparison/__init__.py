"""The page of an evaluation or a reproduction: Table I, paired differences, figures."""

from tuner.report.comparison.page import write_comparison_report

__all__ = ["write_comparison_report"]
