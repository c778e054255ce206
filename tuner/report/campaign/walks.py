"""Pages of a campaign's missions to walk around in: the default beside the recommended one, and all that were kept."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.campaign.showcase import SHOWN, showcase_jobs, was_flown
from tuner.report.mission.walk import write_mission_view

PAGE, REPORT_FILE = "view.html", "report.html"


@dataclass(frozen=True)
class MissionPage:
    """One page to walk around in."""

    label: str  # "default beside recommended", or a trial's directory
    path: Path


def write_showcase_page(campaign: Campaign) -> MissionPage | None:
    """Write the page of `showcase_jobs`, unless it is there; None where none of them has flown."""
    shown = [job for job in showcase_jobs(campaign) if was_flown(job)]
    if not shown:
        return None
    page = campaign.directory / SHOWN / PAGE
    made_from = [job.directory / "mission.json" for job in shown]
    made = page.is_file() and all(page.stat().st_mtime >= file.stat().st_mtime for file in made_from)
    if not (made or _written([job.directory for job in shown], page, shown[0].rock)):
        return None
    label = " beside ".join(job.directory.name for job in shown)
    return MissionPage(f"{label}, on {Path(shown[0].rock).stem}", page)


def write_mission_pages(campaign: Campaign) -> list[MissionPage]:
    """Write the pages that are missing: that one, and of every mission that was flown with ``keep: all``."""
    shown = write_showcase_page(campaign)
    pages = [shown] if shown else []
    for trial in campaign.trials():
        run = campaign.directory / trial.directory
        if not (run / "flight.json").is_file():
            continue
        page = run / PAGE
        if page.is_file() or _written([run], page, campaign.settings.rock_flown(trial.rock, trial.replicate)):
            pages.append(MissionPage(run.name, page))
    return pages


def linked_pages(campaign: Campaign) -> list[tuple[str, str]]:
    """Label and address, relative to the campaign's own page, of the pages that are there."""
    found = [(campaign.directory / SHOWN / PAGE, "the default beside the recommended mission")]
    found += [(campaign.directory / t.directory / PAGE, Path(t.directory).name) for t in campaign.trials()]
    return [
        (label, os.path.relpath(page, campaign.directory).replace(os.sep, "/"))
        for page, label in found
        if page.is_file()
    ]


def linked_comparisons(campaign: Campaign) -> list[tuple[str, str]]:
    """Name and address, relative to the campaign's own page, of the evaluations and confirmations beside it."""
    found = [
        p
        for what in ("evaluation*", "confirmation*")
        for p in campaign.directory.glob(f"{what}/{REPORT_FILE}")
    ]
    return [(page.parent.name, f"{page.parent.name}/{REPORT_FILE}") for page in sorted(found)]


def _written(runs: list[Path], page: Path, rock: str) -> bool:
    """Whether there is a page now: a mission that ended before its first photograph has none."""
    try:
        write_mission_view(runs, page, rock)
    except UserError:
        return False
    return True
