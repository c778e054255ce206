"""The page of a campaign: facts, figures, rows, provenance."""

from tuner.report.campaign.page import write_campaign_report

__all__ = ["write_campaign_report"]
