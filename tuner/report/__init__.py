"""What comes out for people: the campaign's page, comparison tables, mission figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.campaign.campaign import Campaign
    from tuner.evaluation.evaluation import EvaluationRun


def write_campaign_report(campaign: Campaign, evaluation: EvaluationRun | None = None) -> Path:
    """``report.html`` in the campaign's run directory; see ``tuner.report.campaign_report``."""
    from tuner.report.campaign_report import write_campaign_report as write  # matplotlib only when needed

    return write(campaign, evaluation)


def write_comparison_report(run: EvaluationRun, directory: Path, **options: Any) -> Path:
    """``report.html`` and ``table.md`` of an evaluation; see ``tuner.report.comparison_report``."""
    from tuner.report.comparison_report import write_comparison_report as write

    return write(run, directory, **options)
