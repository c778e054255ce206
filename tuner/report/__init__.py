"""What comes out for people: the campaign's page, comparison tables, mission figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tuner.campaign import Campaign
    from tuner.evaluation import EvaluationRun


def write_campaign_report(campaign: Campaign, evaluation: EvaluationRun | None = None) -> Path:
    """``report.html`` in the campaign's run directory; see ``tuner.report.campaign_report``."""
    from tuner.report.campaign_report import write_campaign_report as write  # matplotlib only when needed

    return write(campaign, evaluation)
