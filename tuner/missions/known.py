"""What a mission would photograph, where the store holds all of it already: a tenth of a second, and nothing is computed."""

from __future__ import annotations

from nbv.cache import KnownOnly
from nbv.errors import MissionFailure
from tuner.missions.job import MissionJob
from tuner.missions.registry import fidelity_on, mission_function, runs_on_rocks
from tuner.problem.observations import photographs_key


def known_photographs(job: MissionJob) -> str:
    """Return the `photographs_key` of a mission that repeats an earlier one, in this process.

    The text is empty where a model or a photograph of it has never been made here, or where the mission fails.
    """
    if not runs_on_rocks(job.fidelity):
        return ""
    run = mission_function(fidelity_on(job.rock, job.fidelity))
    try:
        result = run(job.config, job.rock, job.replicate, None, keep="summary", cache=KnownOnly())
    except MissionFailure:
        return ""
    chosen = [step.chosen for step in result.trace]
    return "" if result.status == "failed" else photographs_key(job.config, chosen)
