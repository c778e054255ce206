"""Missions of a campaign that can be walked around in: the default beside the recommended one, and all that were kept."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from nbv.errors import UserError
from nbv.mission.result import MissionResult
from tuner.campaign.campaign import Campaign
from tuner.missions.executors import Executor
from tuner.missions.job import MissionJob
from tuner.missions.registry import DEFAULT_FIDELITY, is_geometric
from tuner.report.mission.walk import write_mission_view

SHOWN, PAGE, REPORT_FILE = "shown", "view.html", "report.html"
_WAIT_S = 1.0


@dataclass(frozen=True)
class MissionPage:
    """One page to walk around in."""

    label: str  # "default beside recommended", or a trial's directory
    path: Path


def shown_jobs(campaign: Campaign) -> list[MissionJob]:
    """The default's and the recommended mission on the campaign's first rock, everything kept, in ``RUN/shown/``.

    None without a recommendation, and none of missions that are not ours. One where both are the same.
    """
    s, best = campaign.settings, campaign.recommendation(save=False)
    if best is None or not (s.fidelity == DEFAULT_FIDELITY or is_geometric(s.fidelity)):
        return []
    world = s.worlds[0]
    jobs: dict[str, MissionJob] = {}
    for name, values in (("default", best.default_values), ("recommended", best.values)):
        config = s.config(values, world.condition)
        folder = campaign.directory / SHOWN / name
        job = MissionJob(f"{SHOWN}-{name}", config, world.rock, 0, folder, "all", s.fidelity)
        jobs.setdefault(config.digest(), job)
    return list(jobs.values())


def fly_shown_missions(campaign: Campaign, executor: Executor) -> None:
    """Fly those of `shown_jobs` that are not there yet; one that fails is left out of the pages."""
    waiting = [job for job in shown_jobs(campaign) if not was_flown(job)]
    for job in waiting:
        job.directory.mkdir(parents=True, exist_ok=True)
        (job.directory / "mission.json").unlink(missing_ok=True)
        executor.submit(job)
    while executor.in_flight:
        executor.wait_any(_WAIT_S)


def write_mission_pages(campaign: Campaign) -> list[MissionPage]:
    """Write the pages that are missing: of `shown_jobs`, and of every mission that was flown with ``keep: all``."""
    pages: list[MissionPage] = []
    shown = [job for job in shown_jobs(campaign) if was_flown(job)]
    if shown:
        page = campaign.directory / SHOWN / PAGE
        made_from = [job.directory / "mission.json" for job in shown]
        made = page.is_file() and all(page.stat().st_mtime >= file.stat().st_mtime for file in made_from)
        if made or _written([job.directory for job in shown], page, shown[0].rock):
            label = " beside ".join(job.directory.name for job in shown)
            pages.append(MissionPage(f"{label}, on {Path(shown[0].rock).stem}", page))
    for trial in campaign.trials():
        run = campaign.directory / trial.directory
        if not (run / "flight.json").is_file():
            continue
        page = run / PAGE
        if page.is_file() or _written([run], page, trial.rock):
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


def _written(runs: list[Path], page: Path, rock: str) -> bool:
    """Whether there is a page now: a mission that ended before its first photograph has none."""
    try:
        write_mission_view(runs, page, rock)
    except UserError:
        return False
    return True


def was_flown(job: MissionJob) -> bool:
    """Whether the mission is there, whole, as the campaign would fly it now."""
    try:
        result = MissionResult.load(job.directory)
    except UserError:
        return False
    return result.config_digest == job.config.digest() and result.status != "failed"
