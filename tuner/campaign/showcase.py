"""The showcase runs the default and the tuned mission once more and keeps all their files, for pages and pictures."""

from __future__ import annotations

import contextlib

from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.missions.job import MissionJob, load_trial
from tuner.missions.pool import Executor
from tuner.missions.registry import mission_kind
from tuner.missions.run_jobs import JobList, Stop, run_jobs

SHOWN = "shown"  # in a campaign's directory


def showcase_jobs(campaign: Campaign) -> list[MissionJob]:
    """Return both missions on the campaign's first rock, in ``RUN/shown/``; one where both are the same.

    The list is empty without a recommendation, and where missions leave nothing that a page shows.
    """
    s, best = campaign.settings, campaign.recommendation(save=False)
    if best is None or not mission_kind(s.fidelity).uses_catalogue:
        return []
    problem = s.problem
    instance = problem.instances[0]
    jobs: dict[str, MissionJob] = {}
    for name, values in (("default", best.default_values), (best.name, best.values)):
        config = problem.config(values, instance.condition)
        folder = campaign.directory / SHOWN / name
        job = MissionJob(f"{SHOWN}-{name}", config, instance.rock, 0, folder, "all", s.fidelity)
        jobs.setdefault(config.digest(), job)
    return list(jobs.values())


def run_showcase(campaign: Campaign, executor: Executor) -> None:
    """Run those of `showcase_jobs` that have not run yet; one that fails is left out of the pages."""
    with contextlib.suppress(UserError):
        run_jobs(JobList(showcase_jobs(campaign)), executor, Stop())


def was_run(job: MissionJob) -> bool:
    """Return whether the job's directory holds a finished mission of the job's configuration."""
    trial = load_trial(job)
    return trial is not None and trial.record.status != "failed"
