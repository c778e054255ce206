"""The page to walk around in the default beside the recommended mission, and what lies beside a campaign's page."""

from __future__ import annotations

from pathlib import Path

from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.campaign.showcase import SHOWN, showcase_jobs, was_flown
from tuner.report.mission.walk import write_mission_view

PAGE, REPORT_FILE = "view.html", "report.html"


def write_showcase_page(campaign: Campaign) -> Path | None:
    """Write the page of `showcase_jobs`, unless it is there; None where none of them took a photograph."""
    shown = [job for job in showcase_jobs(campaign) if was_flown(job)]
    if not shown:
        return None
    page = campaign.directory / SHOWN / PAGE
    made_from = [job.directory / "mission.json" for job in shown]
    if not page.is_file() or any(page.stat().st_mtime < file.stat().st_mtime for file in made_from):
        try:
            write_mission_view([job.directory for job in shown], page, shown[0].rock)
        except UserError:  # a mission that ended before its first photograph has no page
            return None
    return page


def linked_comparisons(campaign: Campaign) -> list[tuple[str, str]]:
    """Name and address, relative to the campaign's own page, of the evaluations and confirmations beside it."""
    found = [
        p
        for what in ("evaluation*", "confirmation*")
        for p in campaign.directory.glob(f"{what}/{REPORT_FILE}")
    ]
    return [(page.parent.name, f"{page.parent.name}/{REPORT_FILE}") for page in sorted(found)]
